"""
What it costs that exported files keep a few joints a vertex.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.model import Model
from ..model.rig import deform
from ..scenes.views import held_out_views
from .metrics import psnr
from .self_check import latent_images


def pruning_cost(model: Model, *, form: str = "gltf", n_views: int = 4, resolution: int = 256) -> dict:
    """
    A character with all its weights beside the same with those that its files keep.

    Parameters
    ----------
    model : Model
        With a skin.
    form : {'gltf', 'paper'}
        Mixing of the lobes.
    n_views, resolution : int
        Images of each of two frames, lit directly.

    Returns
    -------
    dict
        ``influences`` that are kept of at most ``before``, ``psnr`` [dB] between both, and how far a vertex ``moved``
        at most in any frame, as a share of the character's longest side.
    """
    rigging = model.skin
    assert rigging is not None
    pruned, rig = rigging.pruned(), rigging.rig
    frames = range(rig.n_frames)
    before, after = (
        np.stack([deform(model.mesh.positions, r.skin(), rig.matrices(f)) for f in frames]) for r in (rigging, pruned)
    )
    moved = float(np.linalg.norm(after - before, axis=-1).max())
    found = []
    for frame in sorted({rig.n_frames // 4, 3 * rig.n_frames // 4}):
        views = held_out_views(rigging.boxes[frame], n_views, resolution).at(frame)
        found.append(psnr(*(latent_images(replace(model, skin=r), views, form) for r in (rigging, pruned))).mean())
    return {
        "influences": rigging.influences,
        "before": int(rigging.skin().weights.shape[1]),
        "psnr": round(float(np.mean(found)), 2),
        "moved": moved / float(np.ptp(rigging.boxes[-1], axis=0).max()),
    }
