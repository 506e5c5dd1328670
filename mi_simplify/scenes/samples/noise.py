"""
Smooth noise from integer arithmetic: textures of the samples that are the same on every machine.
"""

from __future__ import annotations

import numpy as np


def lattice_hash(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """
    A number in [0, 1) for every pair of integers; integer arithmetic, so the same on every machine.
    """
    n = np.asarray(x).astype(np.int64) * 374_761_393 + np.asarray(y).astype(np.int64) * 668_265_263
    n = ((n ^ (n >> 13)) * 1_274_126_177) & 0xFFFFFFFF
    return (n ^ (n >> 16)) / 2.0**32


def smooth_noise(u: np.ndarray, v: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """
    Smooth noise in [0, 1] on a lattice that repeats in u; u and v in [0, 1].
    """
    lattice = lattice_hash(*np.meshgrid(np.arange(columns) + 7, np.arange(rows + 2) + 3, indexing="ij"))
    x, y = u * columns, v * rows
    x0, y0 = x.astype(np.int64), y.astype(np.int64)
    fx, fy = (f * f * (3 - 2 * f) for f in (x - x0, y - y0))
    x0, x1 = x0 % columns, (x0 + 1) % columns
    top = lattice[x0, y0] * (1 - fx) + lattice[x1, y0] * fx
    return top * (1 - fy) + (lattice[x0, y0 + 1] * (1 - fx) + lattice[x1, y0 + 1] * fx) * fy


def cloud_noise(u: np.ndarray, v: np.ndarray, columns: int, rows: int, octaves: int = 4) -> np.ndarray:
    """
    Octaves of :func:`smooth_noise`, each half as strong and twice as fine; in [0, 1].
    """
    return np.sum([smooth_noise(u, v, columns << k, rows << k) * 0.5 ** (k + 1) for k in range(octaves)], axis=0)
