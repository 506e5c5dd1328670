"""
The project's own judge: path traces reference and candidates from views that no fit has seen.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..errors import AssetError
from ..export.files import make_folder, write_atomic
from ..export.textures import png
from ..progress import Progress, ProgressCallback, silent
from ..scenes.asset import Asset
from .metrics import COVERED, compare
from .pictures import contact_sheet

if TYPE_CHECKING:  # importing it would need a Mitsuba variant
    from ..scenes.views import Views

log = logging.getLogger("mi_simplify")

SKY = 0.1
"""Radiance of the constant sky beside the point light."""

MAX_DEPTH = 6
"""Longest light path [edges]."""


@dataclass(frozen=True)
class Comparison:
    """
    Images of a reference and its candidates, and what they measure.

    Parameters
    ----------
    reference : ndarray, shape (B, H, W, 4), float32
        Linear radiance on black, and coverage.
    candidates : dict of str to ndarray, shape (B, H, W, 4), float32
    figures : dict
        What ``metrics.json`` holds: ``settings``, ``reference`` and, by name, ``candidates`` with
        ``triangles``, ``psnr`` [dB], ``flip``, ``silhouette_error`` and ``per_view`` lists.
    """

    reference: np.ndarray
    candidates: dict[str, np.ndarray]
    figures: dict


def compare_assets(
    reference: Asset,
    candidates: Mapping[str, Asset],
    *,
    n_views: int = 8,
    resolution: int = 256,
    spp: int = 64,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> Comparison:
    """
    Path trace all of them from the same held-out views under the same lights, and measure.

    A point light stands 5 to 75 degrees off the camera, beyond 30 degrees in every other view, under
    a dim constant sky. Candidates stand in the reference's frame. Views and noise depend on ``seed``
    alone; only figures of one seed compare.

    Parameters
    ----------
    reference : Asset
    candidates : mapping of str to Asset
    n_views, resolution, spp : int
        How many square images of how many pixels and samples per pixel.
    seed : int
    progress : callable, optional
        Told after every image, as stage "evaluate".

    Returns
    -------
    Comparison

    Raises
    ------
    AssetError
        The reference is not to be seen in any of the views.
    """
    from ..scenes.views import held_out_views  # Mitsuba needs its variant by now, not on import

    progress = progress or silent
    views = held_out_views(reference.bounds, n_views, resolution, seed)
    assets = {"": reference, **candidates}
    images: dict[str, np.ndarray] = {}
    for name, asset in assets.items():

        def told(k: int, done: int = len(images) * n_views) -> None:
            progress(Progress("evaluate", done + k, len(assets) * n_views))

        images[name] = _path_traced(asset, views, spp, seed, told)
    target = images.pop("")
    if not (target[..., 3] > COVERED).any():
        raise AssetError(
            f"{reference.source or reference.name}: no held-out view shows anything of it; "
            "check its scale, and that it is not fully transparent"
        )
    figures = {
        "generator": f"mi_simplify {__version__}",
        "settings": {
            "n_views": n_views,
            "resolution": resolution,
            "spp": spp,
            "seed": seed,
            "max_depth": MAX_DEPTH,
            "sky": SKY,
        },
        "reference": {"name": reference.name, "triangles": reference.n_triangles},
        "candidates": {
            name: {"triangles": asset.n_triangles, **compare(target, images[name])}
            for name, asset in candidates.items()
        },
    }
    return Comparison(target, images, figures)


def _path_traced(asset: Asset, views: Views, spp: int, seed: int, told: Callable[[int], None]) -> np.ndarray:
    """
    Images of all views, shape (B, H, W, 4).

    Point light and sky are rendered apart and added: a path tracer that picks one of two lights at
    random is far noisier, and noise here is error that neither model has.
    """
    from ..scenes.reference import make_reference
    from ..scenes.views import Views

    lit = make_reference(asset, transport="baked", spp=spp, max_depth=MAX_DEPTH)
    sky = make_reference(asset, transport="baked", spp=spp, max_depth=MAX_DEPTH, sky=SKY)
    arrays = views.arrays()
    dark = Views.from_arrays(
        arrays | {"light_intensity": np.zeros_like(arrays["light_intensity"])}, views.width, views.height
    )
    images = []
    for k in range(len(views)):
        one = np.array([k])
        image = lit.render(views.take(one), seed=2 * (seed * len(views) + k))
        image[..., :3] += sky.render(dark.take(one), seed=2 * (seed * len(views) + k) + 1)[..., :3]
        images.append(image)
        told(k + 1)
    images = np.concatenate(images)
    broken = ~np.isfinite(images)
    if broken.any():
        log.warning("%s: %d pixel values are not finite and count as black", asset.name, np.count_nonzero(broken))
        images[broken] = 0.0
    return images


def save_comparison(comparison: Comparison, out: str | Path) -> dict[str, Path]:
    """
    Write ``metrics.json`` and ``contact_sheet.png`` into a folder, which is made where it is missing.

    Returns
    -------
    dict
        ``metrics`` and ``contact_sheet``: the paths.

    Raises
    ------
    OutputError
        The folder cannot be written.
    """
    out = make_folder(out)
    sheet = contact_sheet(comparison.reference, comparison.candidates)
    text = json.dumps(comparison.figures, indent=2, allow_nan=False) + "\n"
    return {
        "contact_sheet": write_atomic(out / "contact_sheet.png", png(np.asarray(sheet))),
        "metrics": write_atomic(out / "metrics.json", text),
    }


def evaluate(
    reference: Asset,
    candidates: Mapping[str, Asset],
    *,
    n_views: int = 8,
    resolution: int = 256,
    spp: int = 64,
    seed: int = 0,
    out: str | Path | None = None,
    progress: ProgressCallback | None = None,
) -> dict:
    """
    PSNR, FLIP and silhouette error of candidates against a reference: :func:`compare_assets`, and its files.

    Parameters
    ----------
    out : str or Path, optional
        Folder for ``metrics.json`` and ``contact_sheet.png``; nothing is written without it.

    Returns
    -------
    dict
        ``Comparison.figures``.
    """
    if out is not None:
        out = make_folder(out)  # a folder that cannot be written is found out before minutes of rendering
    comparison = compare_assets(
        reference, candidates, n_views=n_views, resolution=resolution, spp=spp, seed=seed, progress=progress
    )
    if out is not None:
        save_comparison(comparison, out)
    return comparison.figures
