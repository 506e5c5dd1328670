"""
The project's own judge: renders reference and candidates from views that no fit has seen.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..config import Config
from ..config.schema import EvaluationSettings
from ..errors import AssetError, UserError
from ..machine.files import make_folder
from ..model.asset import Asset
from ..model.frame import Frame
from ..progress import Progress, ProgressCallback, silent
from .atlas_use import atlas_use
from .comparison import Comparison, save_comparison
from .kept_pictures import KeptPictures
from .metrics import COVERED, compare
from .normal_maps import normal_figure
from .renderers import SKY, opened

if TYPE_CHECKING:  # importing it would need a Mitsuba variant
    from ..scenes.references.reference import Reference
    from ..scenes.views import Views

log = logging.getLogger("mi_simplify")

#: What the configuration has where nothing is said.
_DEFAULTS = EvaluationSettings()


@dataclass(frozen=True)
class Judging:
    """
    How closely is looked.

    Parameters
    ----------
    n_views, resolution, spp : int
        How many square images of how many pixels and samples per pixel.
    seed : int
        Of views and noise, which depend on nothing else; only figures of one seed compare.
    renderer : str
        One of :data:`.renderers.RENDERERS`; only figures of one renderer compare.
    """

    n_views: int = _DEFAULTS.views
    resolution: int = _DEFAULTS.resolution
    spp: int = _DEFAULTS.spp
    seed: int = 0
    renderer: str = "mitsuba"

    @staticmethod
    def of(config: Config) -> Judging:
        """
        What a job's configuration asks for.
        """
        judged = config.evaluation
        return Judging(judged.views, judged.resolution, judged.spp, config.seed)

    def require_mitsuba(self) -> None:
        """
        Raise :class:`UserError` where another renderer is asked for something that only Mitsuba can show.
        """
        if self.renderer != "mitsuba":
            raise UserError(
                f"--renderer {self.renderer} shows model files in light that their fit has not seen; "
                "this reference is judged in a light of its own: leave the option out"
            )


def compare_assets(
    reference: Asset,
    candidates: Mapping[str, Asset],
    judging: Judging = Judging(),
    progress: ProgressCallback | None = None,
    kept: KeptPictures | None = None,
) -> Comparison:
    """
    Render all of them from the same held-out views under the same lights, and measure.

    A point light stands 5 to 75 degrees off the camera, beyond 30 degrees in every other view, under
    a dim constant sky. Candidates stand in the reference's frame.

    Parameters
    ----------
    reference : Asset
    candidates : mapping of str to Asset
    judging : Judging
    progress : callable, optional
        Told after every image, as stage "evaluate".
    kept : KeptPictures, optional
        Those of the reference, which are not rendered again.

    Returns
    -------
    Comparison

    Raises
    ------
    AssetError
        The reference is not to be seen in any of the views; or the renderer cannot show what an asset is made of.
    RuntimeUnavailable
        The renderer is not installed.
    """
    from ..scenes.views import held_out_views  # Mitsuba needs its variant by now, not on import

    frame = Frame.around(reference.bounds)  # any units, and coordinates far from the origin, fit into float32 there
    bounds = frame.normalised(reference).bounds
    views = held_out_views(bounds, judging.n_views, judging.resolution, judging.seed)
    with opened(judging.renderer, judging.spp) as (make, facts, n):
        target = Rendering(reference, make(reference, frame.matrix))
        others = {name: Rendering(asset, make(asset, frame.matrix)) for name, asset in candidates.items()}
        settings = {**facts, "spp": judging.spp, "seed": judging.seed, "sky": SKY}
        return compare_renderings(target, others, views, settings, progress, n, kept)


@dataclass(frozen=True)
class Rendering:
    """
    A model, and what its pictures are made with.

    Parameters
    ----------
    asset : Asset
        Its name, costs and file are told.
    renderer : Reference
    """

    asset: Asset
    renderer: Reference


def compare_renderings(
    reference: Rendering,
    candidates: Mapping[str, Rendering],
    views: Views,
    settings: dict,
    progress: ProgressCallback | None = None,
    n_renderings: int = 2,
    kept: KeptPictures | None = None,
) -> Comparison:
    """
    Render all of them from the same views, twice each with noise of its own where there is noise, and measure.

    Parameters
    ----------
    reference : Rendering
        Its renderer makes half of the samples of a picture, as those of all candidates do:
        :func:`.renderers.half`.
    candidates : mapping of str to Rendering
    views : Views
        In the frame of all renderers.
    settings : dict
        How it was rendered, for ``metrics.json``; ``seed`` is that of the renderers' noise.
    progress : callable, optional
        Told after every image, as stage "evaluate".
    n_renderings : int
        Of each picture: 2, or 1 where the renderers have no noise and make all samples at once.
    kept : KeptPictures, optional
        Those of the reference, which are not rendered again.

    Raises
    ------
    AssetError
        The reference is not to be seen in any of the views.
    """
    progress = progress or silent
    renderings, n_views, seed = {"": reference, **candidates}, len(views), settings["seed"]
    halves: dict[str, np.ndarray] = {}
    kept = KeptPictures() if kept is None else kept

    def rendered(rendering: Rendering, done: int) -> np.ndarray:
        pairs = np.empty((n_renderings, n_views, views.height, views.width, 4), np.float32)
        for k in range(n_views):
            for half in range(n_renderings):
                number = (2 * seed + half) * n_views + k
                pairs[half, k] = rendering.renderer.render(views.take(np.array([k])), number)[0]
            progress(Progress("evaluate", done + k + 1, len(renderings) * n_views))
        _finite(pairs, rendering.asset.name)
        return pairs

    halves[""] = kept.of(views, settings, lambda: rendered(reference, 0))
    for number, (name, rendering) in enumerate(candidates.items(), 1):
        halves[name] = rendered(rendering, number * n_views)
    images = {name: pairs.mean(0) for name, pairs in halves.items()}
    target = images.pop("")
    if not (target[..., 3] > COVERED).any():
        raise AssetError(
            f"{reference.asset.source or reference.asset.name}: no held-out view shows anything of it; "
            "check its scale, and that it is not fully transparent"
        )
    rows = {
        name: costs(other.asset) | _compared(halves[""], halves[name]) | normal_figure(reference.asset, other.asset)
        for name, other in candidates.items()
    }
    figures = {
        "generator": f"mi_simplify {__version__}",
        "settings": {"n_views": n_views, "resolution": views.width, **settings},
        "reference": {"name": reference.asset.name, **costs(reference.asset)},
        "candidates": rows,
    }
    return Comparison(target, images, figures)


def _compared(reference: np.ndarray, candidate: np.ndarray) -> dict:
    """Figures of pictures of one or two renderings, (N, B, H, W, 4)."""
    return compare(reference[0], candidate[0]) if len(reference) == 1 else compare(reference, candidate)


def _finite(images: np.ndarray, name: str) -> None:
    """Make all values finite: what is not counts as black, and that is told."""
    broken = ~np.isfinite(images)
    if broken.any():
        log.warning("%s: %d pixel values are not finite and count as black", name, np.count_nonzero(broken))
        images[broken] = 0.0


def costs(asset: Asset) -> dict:
    """What a model is made of; of its file, where there is one, the size without those that it names."""
    used = list({instance.part: asset.parts[instance.part] for instance in asset.instances}.values())
    materials = list({id(part.material): part.material for part in used}.values())
    textures = [[x for x in (m.base_color, m.specular, m.normal) if x is not None] for m in materials]
    file = Path(asset.source).absolute()
    is_file = bool(asset.source) and file.is_file()
    return {
        "triangles": asset.n_triangles,
        "vertices": sum(len(part.vertices) for part in used),
        "materials": len(materials),
        "texels": sum(max(x.shape[0] * x.shape[1] for x in images) for images in textures),
        **atlas_use(used),
        "file": str(file) if is_file else asset.source or None,
        "bytes": file.stat().st_size if is_file else None,
    }


def evaluate(
    reference: Asset,
    candidates: Mapping[str, Asset],
    *,
    n_views: int = 8,
    resolution: int = 256,
    spp: int = 64,
    seed: int = 0,
    renderer: str = "mitsuba",
    out: str | Path | None = None,
    progress: ProgressCallback | None = None,
) -> dict:
    """
    PSNR, FLIP and silhouette error of candidates against a reference: :func:`compare_assets`, and its files.

    Parameters
    ----------
    n_views, resolution, spp, seed, renderer
        As :class:`Judging` has them.
    out : str or Path, optional
        Folder for the files of :func:`save_comparison`; nothing is written without it.

    Returns
    -------
    dict
        ``Comparison.figures``.
    """
    if out is not None:
        out = make_folder(out)  # a folder that cannot be written is found out before minutes of rendering
    comparison = compare_assets(reference, candidates, Judging(n_views, resolution, spp, seed, renderer), progress)
    if out is not None:
        save_comparison(comparison, out)
    return comparison.figures
