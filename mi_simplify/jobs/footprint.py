"""
How much memory a job will take, reckoned from its settings before it starts and again once its asset is known.

The bytes per texel, sample and triangle were measured: peaks of whole runs, one setting changed at a time.
"""

from __future__ import annotations

from ..config import Config
from ..formats.headers import said_image_bytes, said_triangles
from ..machine import memory
from ..model.asset import Asset

#: Python, Mitsuba, LLVM and their kernels, with a job of next to nothing.
_BASE = 440 << 20

#: Texel of the atlas: as baked, as parameters with gradients and moments, as images of the report.
_PER_TEXEL = 830

#: Sample of the batch: rays, hits, shading and their adjoints.
_PER_SAMPLE = 100

#: Pixel of a view in the pool, half precision, and in the copy of a checkpoint.
_PER_POOLED = {"direct": 16, "baked": 16, "matched": 28}

#: Pixel of a held-out view of one candidate, with its pictures.
_PER_JUDGED = 50

#: Triangle of the asset while it is decimated and baked from.
_PER_TRIANGLE = 1200

#: How often the asset's textures are held: as read, by the renderers of fit and evaluation, packed for the report.
_COPIES = 8


def footprint(config: Config, asset: Asset | None = None) -> dict[str, int]:
    """
    Expected peak of the process [bytes], as a sum: what each setting adds by the key that lowers it.

    Parameters
    ----------
    config : Config
    asset : Asset, optional
        As loaded; without it, what its file says of its triangles and of its images counts.
    """
    fit, judged, pixels = config.optimizer, config.evaluation, max(config.optimizer.resolution) ** 2
    out = {
        "": _BASE,
        "initial.atlas_size": _PER_TEXEL * config.initial.atlas_side**2,
        "optimizer.batch": _PER_SAMPLE * fit.batch * fit.spp * pixels if fit.steps else 0,
        "reference.pool": _PER_POOLED[config.reference.transport] * config.reference.pool * pixels if fit.steps else 0,
        "evaluation.resolution": _PER_JUDGED * judged.views * (3 + judged.baseline) * judged.resolution**2,
    }
    if asset is None:
        out["asset"] = said_footprint(config.asset)
    else:
        materials = {id(part.material): part.material for part in asset.parts}.values()
        images = [image for m in materials for image in (m.base_color, m.specular, m.normal) if image is not None]
        out["asset"] = _PER_TRIANGLE * asset.n_triangles + _COPIES * sum(image.nbytes for image in images)
    return out


def said_footprint(path: str, unknown: int = 0) -> int:
    """
    Memory that a model takes by its file's headers [bytes].

    Parameters
    ----------
    path : str
    unknown : int
        Triangles of a file that does not say how many it has.
    """
    n_triangles = said_triangles(path)
    return _PER_TRIANGLE * (unknown if n_triangles is None else n_triangles) + _COPIES * said_image_bytes(path)


def check_footprint(config: Config, asset: Asset | None = None) -> None:
    """
    Refuse a job that will not fit into memory.

    Raises
    ------
    MemoryLimitError
        With the setting that takes most, and what it may be lowered to, or the asset.
    """
    parts = footprint(config, asset)
    largest = max(parts, key=lambda key: parts[key] if key else 0)
    way_out = f"lower {largest}"
    if largest == "asset":
        others = sum(parts.values()) - parts[largest]
        room = max((memory.left() or 0) + (memory.held() or 0) - others, 0) // _PER_TRIANGLE
        way_out = f"decimate the asset to {room - room % 10_000:,} triangles before, or simplify it in parts"
    way_out += f", which takes {memory.shown_size(parts[largest])} of it"
    memory.require(sum(parts.values()) - (memory.held() or 0), "this job", way_out)
