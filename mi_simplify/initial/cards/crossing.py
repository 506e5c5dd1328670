"""
Cards that cut through each other: where they do, their order changes along a line that is no edge of the mesh.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

#: Pairs tested in one go; bounds the memory to some hundred megabytes.
_CHUNK = 200_000


def crossing_cards(corners: np.ndarray) -> int:
    """
    How many pairs of quads intersect: an edge of one passes through the other.

    Parameters
    ----------
    corners : ndarray, shape (C, 4, 3)
        Flat convex quads, in order around them.
    """
    centre = corners.mean(1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(1)
    # Few are large: each looks for those that are not larger than itself.
    order = np.argsort(radius, kind="stable")
    tree, rank = cKDTree(centre), np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    near = tree.query_ball_point(centre, 2 * radius, return_sorted=False)
    first = np.repeat(np.arange(len(near)), [len(x) for x in near])
    second = np.concatenate([np.asarray(x, np.int64) for x in near]) if len(near) else np.zeros(0, np.int64)
    keep = rank[second] < rank[first]
    first, second = first[keep], second[keep]
    keep = np.linalg.norm(centre[first] - centre[second], axis=1) < radius[first] + radius[second]
    first, second = first[keep], second[keep]
    total = 0
    for k in range(0, len(first), _CHUNK):
        a, b = corners[first[k : k + _CHUNK]], corners[second[k : k + _CHUNK]]
        total += int((_pierced(a, b) | _pierced(b, a)).sum())
    return total


def _pierced(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether an edge of each quad in ``a`` passes through its counterpart in ``b``, shape (N,)."""
    start, end = a, np.roll(a, -1, axis=1)  # (N, 4, 3)
    out = np.zeros(len(a), bool)
    for corner in ((0, 1, 2), (0, 2, 3)):
        p, q, r = (b[:, None, k] for k in corner)
        e1, e2, d = q - p, r - p, end - start
        h = np.cross(d, e2)
        det = np.einsum("nki,nki->nk", e1 + 0 * d, h)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = start - p
            w = np.cross(s, e1 + 0 * d)
            u, v, t = (
                np.einsum("nki,nki->nk", x, y) / det for x, y in ((s, h), (d, w), (e2 + 0 * d, w))
            )  # fmt: skip
            inside = (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1)
        out |= inside.any(1)
    return out
