"""
A surface in many poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import MeshError


@dataclass(frozen=True)
class Sequence:
    """
    Poses of one mesh.

    Parameters
    ----------
    name : str
    faces : ndarray, shape (F, 3), int64
        Over welded positions.
    frames : ndarray, shape (T, V, 3), float32
    rest : ndarray, shape (V, 3)
        The pose that the geometry image is made from.
    parameters : ndarray, shape (T, P), float32, optional
        What made the poses, such as blend weights; no model reads them yet.
    notes : tuple of str
    """

    name: str
    faces: np.ndarray
    frames: np.ndarray
    rest: np.ndarray
    parameters: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        bad = np.flatnonzero(~np.isfinite(self.frames).all((1, 2)))
        if len(bad):
            raise MeshError(f"{self.name}: finite positions expected, frame {bad[0]} has NaN or infinite ones; mend it")
        if len(self.frames) < 2:
            raise MeshError(f"{self.name}: at least two frames expected, got {len(self.frames)}; nothing deforms")


def smooth_weights(n_frames: int, n: int, rng: np.random.Generator, period: float) -> np.ndarray:
    """
    Curves in [0, 1], shape (n_frames, n), each a sum of three sines with periods around ``period`` frames.
    """
    t = np.arange(n_frames)[:, None]
    out = np.zeros((n_frames, n))
    for share in (1.0, 0.61, 0.37):
        out += share * np.sin(2 * np.pi * (t / (period * share * rng.uniform(0.7, 1.4, n)) + rng.random(n)))
    return np.clip(0.5 + 0.45 * out, 0, 1)
