"""
A chain of levels of detail: each made from the one above, for the size on the screen at which it takes over.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..config import Config
from ..config.amounts import resolved
from ..errors import ConfigError
from ..initial.budget import budget, settled
from ..initial.nodes import require_no_nodes
from ..judging.metrics import flip, psnr
from ..judging.screen import Screen
from ..judging.switching import film_of, switching_size, views_of
from ..machine.files import make_folder, write_atomic
from ..machine.runtime import ensure_variant
from ..model.model import Model, tessellated
from ..progress import Progress, ProgressCallback, silent
from ..record.output import RunFolder
from ..scenes.references.reference import Reference
from ..scenes.views import held_out_views
from ..subjects import open_subject
from .budget_search import level_budgets
from .goals import LARGEST_FILM
from .job import run_job

log = logging.getLogger("mi_simplify")

_FALLING = (
    "--triangles, --vertices: a chain needs at least two budgets, each below the one before, such as 9000,3000,1000"
)


@dataclass(frozen=True)
class Level:
    """
    One level of a chain, as ``lod.json`` has it.

    Parameters
    ----------
    file : str
        GLB, relative to the chain's folder.
    triangles, texels, bytes : int
        Texels are the side of the textures.
    screen_size : float or None
        Diameter of the bounding sphere [pixels] from which on downwards the level is meant to be seen; None for the
        finest.
    screen_share : float
        Share of a 1920 x 1080 screen that such a sphere covers; 1 for the finest.
    target_resolution : int or None
        Side of the images that it was prefiltered for; None where it was not.
    flip_above : dict of str to float
        By size tried: FLIP between it and the level above, over what either covers, without aliasing.
    psnr, flip : float
        One sample in the middle of each pixel, against the asset without aliasing, at the switching size (of the finest
        level: of the one below).
    seconds : float
    """

    file: str
    triangles: int
    texels: int
    bytes: int
    screen_size: float | None
    screen_share: float
    target_resolution: int | None
    flip_above: dict[str, float]
    psnr: float
    flip: float
    seconds: float


@dataclass(frozen=True)
class Chain:
    """
    The levels, finest first, and where they are.
    """

    folder: Path
    levels: list[Level]
    seconds: float

    def summary(self) -> str:
        """
        A line a level for a person.
        """
        rows = [
            f"{level.file}  {level.triangles:6} triangles  {level.texels:4}² texels  {level.bytes / 1024:6.0f} kB  "
            + (f"below {level.screen_size:4.0f} px" if level.screen_size else "any size     ")
            + f"  PSNR {level.psnr:5.2f} dB  FLIP {level.flip:.4f}"
            for level in self.levels
        ]
        return "\n".join([*rows, f"{self.folder / 'lod.json'}: done in {self.seconds:.0f} s"])


def lod_job(
    configure: Callable[[Mapping[str, Any]], Config],
    budgets: Sequence[Mapping[str, Any]] | None,
    out: str | Path,
    progress: ProgressCallback = silent,
    *,
    finest: int | str | None = None,
    threshold: float = 0.04,
    extras: Sequence[str] = (),
    overwrite: bool = False,
) -> Chain:
    """
    Simplify an asset to several budgets and measure at which sizes they may follow each other.

    The finest level is an ordinary run. Every other one starts from the mesh and the textures of the level above, is
    prefiltered for the size at which that start already looks like it, and fitted to the asset; where the result looks
    like the level above is measured once more, and that is the size written down.

    Parameters
    ----------
    configure : callable
        ``configure(overrides) -> Config``: the user's configuration with a few more keys, as nested dicts.
    budgets : sequence of mapping
        Of every level ``triangles`` (a number, or a share of the asset's) or ``vertices``, as keys of ``initial``;
        falling. None: :func:`.budget_search.level_budgets` finds them.
    finest : int, optional
        Triangles of the finest level, where the others are to be found.
    out : str or Path
        Folder; level k is a run of its own in ``lod{k}``.
    progress : callable
    threshold : float
        FLIP between two levels, over what either covers, below which the switch is not seen.
    extras : sequence of {'msft_lod', 'usd'}
        Also write all levels into one GLB with MSFT_lod, or refer to them from one USD layer with UsdLod.
    overwrite : bool
        Replace the runs that ``out`` holds.

    Raises
    ------
    UserError
        As :func:`.job.run_job`; or the budgets do not fall.
    """
    if budgets is not None and len(budgets) < 2:
        raise ConfigError(_FALLING)
    start, out = time.perf_counter(), Path(out)
    for k in range(len(budgets or (None,))):
        RunFolder(out / f"lod{k}", overwrite=overwrite)  # what is in the way is said before anything is done
    formats = ["glb", *(["usd"] if "usd" in extras else [])]
    config = configure({"export": {"formats": formats}})
    require_no_nodes(config.initial)
    if "msft_lod" in extras and config.export.glb.compress == "meshopt":
        raise ConfigError(
            "--msft-lod joins files that are not compressed; leave it out, or set export.glb.compress to quantize"
        )
    ensure_variant(config.variant)
    subject = open_subject(config)
    if subject.geometry.rig is not None:
        raise ConfigError("levels of detail take no skeletons; run simplify on this character once for each budget")
    if budgets is None:
        most = None if finest is None else resolved(finest, subject.geometry.n_triangles)
        budgets = [{"triangles": n} for n in level_budgets(subject, most, progress)]
        for k in range(len(budgets)):
            RunFolder(out / f"lod{k}", overwrite=overwrite)
    sizes = [budget(settled(configure({"initial": b}).initial, subject.geometry)) for b in budgets]
    if any(a <= b for a, b in zip(sizes, sizes[1:], strict=False)):
        raise ConfigError(_FALLING)
    frame = subject.frame
    bounds = np.stack([(corner - frame.center) * frame.scale for corner in subject.geometry.bounds])
    make_folder(out)

    levels: list[Level] = []
    models: list[Model] = []
    for k, asked in enumerate(budgets):
        begun, folder = time.perf_counter(), out / f"lod{k}"

        def forward(event: Progress, k: int = k) -> None:
            progress(dataclasses.replace(event, stage=f"lod{k} {event.stage}"))

        keys: dict[str, Any] = {"initial": dict(asked), "export": {"formats": formats}}
        if k:
            keys["initial"] |= {"source": str(folder.with_name(f"lod{k - 1}") / "model.glb")}
            forward(Progress("size"))
            guess, _ = open_subject(configure(keys)).guess()
            largest = levels[-1].screen_size or np.inf
            size, _ = switching_size(models[-1], guess, bounds, threshold, largest=largest, form=config.latent.shading)
            film = film_of(size, bounds, config.views)
            if film <= LARGEST_FILM:
                keys["optimizer"] = {"target_resolution": film}
        settings = configure(keys)
        result = run_job(settings, folder, forward, overwrite=overwrite)
        models.append(result.model.transformed(frame.scale, -frame.scale * frame.center))
        takes_over: float | None = None
        measured: dict[int, float] = {}
        if k:
            forward(Progress("size"))
            takes_over, measured = switching_size(
                models[-2], models[-1], bounds, threshold, largest=largest, form=settings.latent.shading
            )
            _warn_unlike(k, measured, threshold)
        levels.append(_level(folder, result.model, settings, takes_over, measured, time.perf_counter() - begun))
    levels = _judged(levels, models, bounds, config)
    _write_extras(out, levels, bounds / frame.scale + frame.center, extras)
    seconds = time.perf_counter() - start
    document = {
        "generator": f"mi_simplify {__version__}", "asset": config.asset, "threshold": threshold,
        "seconds": round(seconds, 1), "levels": [dataclasses.asdict(level) for level in levels],
    }  # fmt: skip
    write_atomic(out / "lod.json", json.dumps(document, indent=2, allow_nan=False) + "\n")
    return Chain(out, levels, seconds)


def _warn_unlike(k: int, measured: Mapping[int, float], threshold: float) -> None:
    """Say so where a level does not look like the one above at any size."""
    size = min(measured)
    if measured[size] >= threshold:
        log.warning(
            "lod%d never looks like lod%d: their FLIP is %.3f even at %d px, which is written down; give it more "
            "triangles, or raise --threshold (%g)", k, k - 1, measured[size], size, threshold,
        )  # fmt: skip


def _level(
    folder: Path, model: Model, settings: Config, takes_over: float | None, flip_above: dict[int, float], seconds: float
) -> Level:
    """What is known of a level before :func:`_judged` looks at all of them."""
    file = folder / "model.glb"
    return Level(
        file=f"{folder.name}/{file.name}", triangles=tessellated(model).n_triangles, texels=model.base_color.shape[0],
        bytes=file.stat().st_size, screen_size=None if takes_over is None else round(takes_over, 1), screen_share=1.0,
        target_resolution=settings.optimizer.target_resolution,
        flip_above={str(size): round(x, 5) for size, x in flip_above.items()},
        psnr=0.0, flip=0.0, seconds=round(seconds, 1),
    )  # fmt: skip


def _judged(levels: Sequence[Level], models: Sequence[Model], bounds: np.ndarray, config: Config) -> list[Level]:
    """The levels with their figures at the switching sizes."""
    from ..export.lods import coverage

    reference = open_subject(config.model_copy(update={"reference": config.reference.supersampled()})).reference()
    out = []
    for k, (level, model) in enumerate(zip(levels, models, strict=True)):
        size = level.screen_size or (levels[k + 1].screen_size if k + 1 < len(levels) else None) or 256
        a, b = _strict(model, reference, bounds, int(round(size)), config)
        share = 1.0 if level.screen_size is None else coverage(level.screen_size)
        out.append(
            dataclasses.replace(
                level,
                screen_share=round(share, 6),
                psnr=round(float(psnr(a, b).mean()), 3),
                flip=round(float(flip(a, b).mean()), 5),
            )
        )
    return out


def _strict(
    model: Model, reference: Reference, bounds: np.ndarray, size: int, config: Config
) -> tuple[np.ndarray, np.ndarray]:
    """Images of the reference, and of a model with one sample in the middle of each pixel."""
    views = held_out_views(bounds, views_of(size, 8), size, config.seed)
    screen = Screen(model, form=config.latent.shading, shade="centre")
    return reference.render(views, config.seed), screen.images(views, spp=1)


def _write_extras(out: Path, levels: Sequence[Level], bounds: np.ndarray, extras: Sequence[str]) -> None:
    """One file with all levels, in the formats asked for."""
    sizes = [level.screen_size for level in levels if level.screen_size is not None]
    if "msft_lod" in extras:
        from ..export.lods import join_glb

        join_glb([out / level.file for level in levels], sizes, out / "lods.glb")
    if "usd" in extras:
        from ..export.lods import join_usd

        join_usd([level.file.replace(".glb", ".usdc") for level in levels], sizes, bounds, out / "lods.usda")
