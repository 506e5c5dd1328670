"""
Characters judged in motion: reference and candidates posed in the same frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..model.asset import Asset, rig_of
from ..progress import ProgressCallback
from .comparison import Comparison
from .evaluate import Judging, Rendering, compare_renderings
from .kept_pictures import KeptPictures
from .renderers import SKY, opened

if TYPE_CHECKING:  # importing it would need a Mitsuba variant
    from ..scenes.references.reference import Reference
    from ..scenes.views import Views


def compare_characters(
    reference: Asset,
    candidates: Mapping[str, Asset],
    frames: np.ndarray,
    judging: Judging = Judging(),
    progress: ProgressCallback | None = None,
    kept: KeptPictures | None = None,
) -> Comparison:
    """
    :func:`.evaluate.compare_assets` over frames of a clip: each view shows one of them, in turn.

    Parameters
    ----------
    reference : Asset
        With a rig.
    candidates : mapping of str to Asset
        Those with a rig are posed at the same seconds of their clip, others stand as they are.
    frames : ndarray, shape (N,)
        Of the reference's clip; spread over the views where there are more of them.
    judging, progress, kept
        As for :func:`.evaluate.compare_assets`.

    Returns
    -------
    Comparison
        Its figures have ``per_frame`` lists besides, by the ``frames`` of the settings, and ``worst_frame`` [dB].
    """
    frames = np.asarray(frames)[np.linspace(0, len(frames) - 1, min(judging.n_views, len(frames))).astype(np.int64)]
    shown = np.resize(frames, judging.n_views)
    views = _views(reference, shown, judging.resolution, judging.seed)
    rig = rig_of(reference)
    codes = [float(rig.codes[int(f)]) for f in shown]
    with opened(judging.renderer, judging.spp) as (make, facts, n):
        others = {}
        for name, asset in candidates.items():
            renderer = make(asset, np.eye(4))
            if asset.rig is not None:
                renderer = _Retimed(renderer, {f: asset.rig.frame_at(rig.times[int(f)]) for f in frames})
            others[name] = Rendering(asset, renderer)
        settings = {**facts, "spp": judging.spp, "seed": judging.seed, "sky": SKY, "frames": codes}
        target = Rendering(reference, make(reference, np.eye(4)))
        comparison = compare_renderings(target, others, views, settings, progress, n, kept)
    rows = comparison.figures["candidates"]
    rows = {name: row | _per_frame(row["per_view"], shown, frames) for name, row in rows.items()}
    return replace(comparison, figures={**comparison.figures, "candidates": rows})


def _views(reference: Asset, shown: np.ndarray, resolution: int, seed: int) -> Views:
    """One held-out view for each of the frames, of where the character is then."""
    from ..scenes.views import Views, held_out_views

    views = []
    for k, frame in enumerate(shown):
        bounds = reference.posed(int(frame)).bounds
        arrays = held_out_views(bounds, len(shown), resolution, seed).take(np.array([k])).arrays()
        views.append(Views.from_arrays(arrays | {"frame": np.array([float(frame)])}, resolution, resolution))
    return Views.concatenate(views)


def _per_frame(per_view: Mapping[str, list[float]], shown: np.ndarray, frames: np.ndarray) -> dict:
    """Means over the views of each frame."""
    out = {key: [float(np.mean(np.array(v)[shown == f])) for f in frames] for key, v in per_view.items()}
    return {"per_frame": out, "worst_frame": min(out["psnr"])}


class _Retimed:
    """A renderer of a clip whose frames are numbered otherwise."""

    def __init__(self, renderer: Reference, frames: Mapping[float, float]):
        self.renderer, self.frames = renderer, frames

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        from ..scenes.views import Views

        arrays = views.arrays()
        arrays["frame"] = np.array([self.frames[f] for f in arrays["frame"]])
        return self.renderer.render(Views.from_arrays(arrays, views.width, views.height), seed)
