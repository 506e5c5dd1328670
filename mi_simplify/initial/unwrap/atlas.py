"""
Texels of a UV layout: which triangles cover them, how many at once, and what fills the space between.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from ...model.mesh import Mesh

_CHUNK = 4_000_000
"""Candidate texels looked at in one go; bounds the memory to some hundred megabytes."""


def texel_counts(mesh: Mesh, size: int) -> np.ndarray:
    """
    Number of triangles that hold each texel centre ``(k + .5) / size``, wrapped.

    Returns
    -------
    ndarray, shape (size, size), int64
        Row 0 is v = 0. A centre on a shared edge counts for neither.
    """
    q = mesh.uvs[mesh.faces].astype(np.float64) * size  # (F, 3, 2)
    low = np.ceil(q.min(1) - 0.5).astype(np.int64)
    high = np.floor(q.max(1) - 0.5).astype(np.int64)
    extent = np.maximum(high - low + 1, 0)  # texel centres in the box
    n = extent[:, 0] * extent[:, 1]
    counts = np.zeros(size * size, np.int64)
    ends = np.cumsum(n)
    start = done = 0
    while start < len(n):
        stop = max(int(np.searchsorted(ends, done + _CHUNK)), start + 1)
        f = np.repeat(np.arange(start, stop), n[start:stop])
        k = done + np.arange(len(f)) - np.repeat(ends[start:stop] - n[start:stop], n[start:stop])
        x, y = low[f, 0] + k % extent[f, 0], low[f, 1] + k // extent[f, 0]
        point = np.stack([x, y], 1) + 0.5
        inside = np.ones((2, len(f)), bool)
        for c in range(3):
            a, b = q[f, c], q[f, (c + 1) % 3]
            side = (b[:, 0] - a[:, 0]) * (point[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (point[:, 0] - a[:, 0])
            inside &= np.stack([side > 1e-4, side < -1e-4])  # texels², far above rounding
        hit = inside.any(0)
        counts += np.bincount((y[hit] % size) * size + x[hit] % size, minlength=size * size)
        start, done = stop, int(ends[stop - 1])
    return counts.reshape(size, size)


def overlap_fraction(mesh: Mesh, size: int = 512) -> float:
    """
    Share of the covered texels that two or more triangles claim; 0 for a layout that can be baked.
    """
    counts = texel_counts(mesh, size)
    return float((counts > 1).sum() / max((counts > 0).sum(), 1))


def dilate(images: list[np.ndarray], covered: np.ndarray) -> list[np.ndarray]:
    """
    Fill every uncovered texel from the nearest covered one, however far, so that no mip level sees a background.

    Parameters
    ----------
    images : list of ndarray, shape (H, W, C)
    covered : ndarray, shape (H, W), bool
        Returned unchanged where nothing is covered.
    """
    if covered.all() or not covered.any():
        return images
    y, x = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return [image[y, x] for image in images]
