"""
How the characters of a report move: the matrices of their joints, frame by frame, and which of these pull at a vertex.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..model.asset import Asset, Part
from ..model.rig import Rig
from .embed import packed_array

MOST_FRAMES = 240
"""Longer clips are shown in fewer frames, evenly spaced."""

MOST_MATRICES = 20_000
"""Frames times joints that a page carries at most for each model; a matrix takes up to 48 bytes."""

PULLS = 8
"""Joints that pull at a vertex in the 3D view, the strongest ones."""


def clip_data(models: Mapping[str, Asset]) -> dict | None:
    """
    The clip of the last model, in which all others with a rig move at the same seconds, as JSON values.

    Parameters
    ----------
    models : mapping of str to Asset
        In the frame in which they are shown.

    Returns
    -------
    dict or None
        ``clips``: name, first frame, and the one after the last; ``seconds`` of all frames; ``joints``: for every model
        the matrices from the bind pose, float32 of shape (T, J, 3, 4), packed, or None where it has no rig. None where
        the last model does not move.
    """
    last = list(models.values())[-1].rig
    if last is None or last.n_frames < 2:
        return None
    most = max(len(m.rig.names) for m in models.values() if m.rig is not None)
    n = max(2, min(last.n_frames, MOST_FRAMES, MOST_MATRICES // most))
    frames = np.unique(np.linspace(0, last.n_frames - 1, n).astype(np.int64))
    clips = [(name, *np.searchsorted(frames, ends).tolist()) for name, *ends in last.clips or (("", 0, last.n_frames),)]
    seconds = last.times[frames]
    return {
        "clips": [clip for clip in clips if clip[2] > clip[1]],
        "seconds": np.round(seconds, 4).tolist(),
        "joints": [None if m.rig is None else packed_array(_matrices(m.rig, seconds)) for m in models.values()],
    }


def _matrices(rig: Rig, seconds: np.ndarray) -> np.ndarray:
    return np.stack([rig.matrices(rig.frame_at(t))[:, :3] for t in seconds]).astype(np.float32)


def pulls(part: Part, joint: int | None) -> dict[str, np.ndarray]:
    """
    Which joints pull at the vertices of a part, four to an array, as the device takes them.

    Parameters
    ----------
    part : Part
        Of an asset with a rig.
    joint : int or None
        That carries the whole part, where that has no skin.

    Returns
    -------
    dict of str to ndarray, shape (V, 4), uint16
        ``joints``, ``weights`` (fractions of 65535, of sum 1), ``joints2`` and ``weights2``, strongest first.
    """
    n = len(part.vertices)
    joints, weights = np.zeros((n, PULLS), np.uint16), np.zeros((n, PULLS))
    if part.skin is None:
        joints[:, 0], weights[:, 0] = joint or 0, 1
    else:
        order = np.argsort(-part.skin.weights, axis=1, kind="stable")[:, :PULLS]
        k = order.shape[1]
        joints[:, :k] = np.take_along_axis(part.skin.joints, order, axis=1)
        weights[:, :k] = np.take_along_axis(part.skin.weights, order, axis=1)
    weights /= np.maximum(weights.sum(1, keepdims=True), 1e-12)
    shares = np.rint(weights * 65535).astype(np.uint16)
    return {"joints": joints[:, :4], "weights": shares[:, :4], "joints2": joints[:, 4:], "weights2": shares[:, 4:]}


def reach(asset: Asset, n: int = 9) -> np.ndarray:
    """
    The box around a model, and around where it goes in a clip, looked at in ``n`` frames; shape (2, 3).
    """
    boxes = [asset.bounds]
    if asset.rig is not None:
        boxes += [asset.posed(float(f)).bounds for f in np.linspace(0, asset.rig.n_frames - 1, n)]
    lows, highs = zip(*boxes, strict=True)
    return np.stack([np.min(lows, axis=0), np.max(highs, axis=0)])
