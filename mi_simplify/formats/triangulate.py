"""
Polygons into triangles: fans where the first corner sees all others, ears clipped off the rest (Meisters 1975).

Every corner stays: collinear ones, too, since the polygon next door may turn there.
"""

from __future__ import annotations

import numpy as np

from ..errors import MeshError
from .polygons import fan

#: Share of a polygon's area by which a triangle of its fan may be turned over before the fan is given up: rounding.
_TURNED = 1e-6

#: Corners of concave polygons that are clipped at a time.
_CHUNK = 1 << 20

#: Corners of one concave polygon beyond which it is refused: ears take a time that grows with the square of it.
MAX_CORNERS = 10_000


def triangulate(points: np.ndarray, index: np.ndarray, counts: np.ndarray, model: str) -> tuple[np.ndarray, np.ndarray]:
    """
    Split polygons, convex or not, into triangles that do not overlap; a simple polygon is covered exactly.

    What is not planar is looked at along its area vector (Newell's); what intersects itself is cut somehow.

    Parameters
    ----------
    points : ndarray, shape (V, 3), float64
    index : ndarray, shape (C,), int64
        Vertices of the corners of all polygons, laid end to end.
    counts : ndarray, shape (N,), int64
        Corners of each polygon; those below 3 give nothing.
    model : str
        File name, for the message.

    Returns
    -------
    corners : ndarray, shape (F, 3), int64
        Indices into ``index``; those of one polygon together, in the order of the polygons.
    polygons : ndarray, shape (F,), int64
        The polygon that each triangle came from.

    Raises
    ------
    MeshError
        A concave polygon has more than ``MAX_CORNERS`` corners.
    """
    counts = np.asarray(counts, np.int64)
    corners, polygons = fan(counts)
    if counts.max(initial=0) <= 3:
        return corners, polygons
    many = np.flatnonzero(counts[polygons] > 3)
    p = points[index[corners[many]]]
    vectors = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    owner = polygons[many]
    normals = np.stack([np.bincount(owner, vectors[:, k], len(counts)) for k in range(3)], axis=1)
    areas = np.linalg.norm(normals, axis=1)
    signed = np.einsum("fi,fi->f", vectors, normals[owner])
    turned = np.zeros(len(counts), bool)
    turned[owner[signed < -_TURNED * areas[owner] ** 2]] = True  # never where anything is NaN
    turned &= areas > 0
    if not turned.any():
        return corners, polygons
    first = np.cumsum(counts) - counts
    row = np.cumsum(np.maximum(counts - 2, 0)) - np.maximum(counts - 2, 0)

    darts = np.flatnonzero(turned & (counts == 4))  # the other diagonal
    for k, order in enumerate(([1, 2, 3], [1, 3, 0])):
        corners[row[darts] + k] = first[darts, None] + order

    rest = np.flatnonzero(turned & (counts > 4))
    rest = rest[np.argsort(-counts[rest], kind="stable")]
    if len(rest) and counts[rest[0]] > MAX_CORNERS:
        raise MeshError(f"{model}: a concave polygon has {counts[rest[0]]:,} corners; triangulate it and export again")
    begin = 0
    while begin < len(rest):
        chunk = rest[begin : begin + max(_CHUNK // int(counts[rest[begin]]), 1)]
        flat = _flat(points, index, first[chunk], counts[chunk], normals[chunk])
        for of_polygons, k, triangles in _ears(flat, counts[chunk]):
            corners[row[chunk[of_polygons]] + k] = first[chunk[of_polygons], None] + triangles
        begin += len(chunk)
    return corners, polygons


def _flat(points: np.ndarray, index: np.ndarray, first: np.ndarray, counts: np.ndarray, normals: np.ndarray):
    """
    Corners of polygons seen against their normals, counter-clockwise, from their first corner; shape (M, K, 2).
    """
    k = np.arange(int(counts[0]))
    at = index[first[:, None] + np.minimum(k, counts[:, None] - 1)]
    p = points[at] - points[at[:, :1]]
    drop = np.abs(normals).argmax(1)
    axes = np.array([[1, 2], [2, 0], [0, 1]])[drop]
    backwards = np.take_along_axis(normals, drop[:, None], 1)[:, 0] < 0
    axes[backwards] = axes[backwards, ::-1]
    return np.take_along_axis(p, axes[:, None, :], 2)


def _ears(points: np.ndarray, counts: np.ndarray):
    """
    Ears of polygons, shape (M, K, 2), one of each at a time; with the most corners first.

    Yields
    ------
    which : ndarray, shape (m,)
        Polygons that lose an ear.
    k : ndarray, shape (m,)
        How many they have lost before.
    triangles : ndarray, shape (m, 3)
        Corners of the polygons.
    """
    m = len(counts)
    ring, x = np.zeros((0, int(counts[0])), np.int64), points[:0]
    scores = np.zeros(ring.shape)
    for left in range(int(counts[0]), 2, -1):
        n = int((counts >= left).sum())  # polygons of this many corners, by now or from the start
        new = slice(len(ring), n)
        ring = np.concatenate([ring, np.broadcast_to(np.arange(left), (n - len(ring), left))])
        x = np.concatenate([x, points[new, :left]])
        which, around = np.arange(n), np.arange(left)
        scores = np.concatenate([scores, _scores(x[new], around)])
        ears = np.ones(n, np.int64) if left == 3 else _chosen(x, scores)
        before, after = (ears - 1) % left, (ears + 1) % left
        yield which, counts[:n] - left, np.stack([ring[which, e] for e in (before, ears, after)], axis=1)
        if left == 3:
            return
        keep = around != ears[:, None]
        ring, scores = (a[keep].reshape(n, left - 1) for a in (ring, scores))
        x = x[keep].reshape(n, left - 1, 2)
        for beside in (before - (before > ears), after - (after > ears)):
            scores[which, beside] = _scores(x, beside[:, None])[:, 0]
    assert m == n


def _scores(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """
    How long the cut behind corners, shape (k,) or (M, k), would be, squared; infinite where the polygon turns in.
    """
    corners = np.broadcast_to(corners, (len(x), corners.shape[-1]))
    n = x.shape[1]
    a, b, c = (np.take_along_axis(x, (corners + s)[..., None] % n, 1) for s in (-1, 0, 1))
    turns = _cross(b - a, c - b)
    return np.where(turns > 0, ((c - a) ** 2).sum(2), np.inf)


def _chosen(x: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """
    An ear of each polygon, shape (M,): the shortest cut with no corner behind it. Refused ones get an infinite score.
    """
    n, around = x.shape[1], np.arange(x.shape[1])
    ears = np.full(len(x), -1)
    todo, again = np.arange(len(x)), False
    while len(todo):
        ear = scores[todo].argmin(1)
        out = ~np.isfinite(scores[todo, ear])
        if out.any():
            lost = todo[out]
            if again:  # it intersects itself: whichever corner turns most
                a, b, c = (np.roll(x[lost], s, axis=1) for s in (1, 0, -1))
                ears[lost] = _cross(b - a, c - b).argmax(1)
                todo, ear = todo[~out], ear[~out]
            else:  # what was refused long ago may be free by now
                scores[lost] = _scores(x[lost], around)
                again = True
                continue
        free = ~_blocked(x[todo], ear)
        ears[todo[free]] = ear[free]
        scores[todo[~free], ear[~free]] = np.inf
        todo = todo[~free]
    assert (ears >= 0).all() and n > 3
    return ears


def _blocked(x: np.ndarray, ear: np.ndarray) -> np.ndarray:
    """Whether any other corner lies in the triangle of an ear, or on its border but at none of its corners."""
    n, each = x.shape[1], np.arange(len(x))
    a, b, c = (x[each, (ear + s) % n][:, None] for s in (-1, 0, 1))
    inside = np.ones(x.shape[:2], bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= (_cross(q - p, x - p) >= 0) & (x != p).any(2)
    return np.asarray(inside.any(axis=1))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
