"""
Subdivision surfaces: Catmull-Clark and Loop with semi-sharp creases, in plain NumPy.

Rules of Catmull and Clark 1978 and Loop 1987; creases, corners and their blending as DeRose et al. 1998 have them
(Sect. 3 and Appendix B), borders as USD's ``edgeAndCorner``. What lies on the corners of faces, texture coordinates
among it, is interpolated linearly (USD's ``all``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, vstack

#: Sharpness from which an edge or a corner stays sharp for ever.
INFINITE = 10.0


@dataclass(frozen=True)
class Cage:
    """
    A polygon mesh that stands for a smooth surface.

    Parameters
    ----------
    points : ndarray, shape (P, 3), float64
    index : ndarray, shape (C,), int64
        Point of every corner, face after face.
    counts : ndarray, shape (F,), int64
        Corners of every face; 3 each for Loop.
    creases : ndarray, shape (K, 2), int64
        Points at the ends of sharp edges.
    sharpness : ndarray, shape (K,), float64
        Of these edges: subdivisions for which they stay sharp.
    corners : ndarray, shape (P,), float64
        Sharpness of the points.
    """

    points: np.ndarray
    index: np.ndarray
    counts: np.ndarray
    creases: np.ndarray
    sharpness: np.ndarray
    corners: np.ndarray


def refined(cage: Cage, scheme: str, times: int) -> tuple[Cage, np.ndarray, csr_array]:
    """
    A cage split a number of times.

    Parameters
    ----------
    scheme : {'catmullClark', 'loop'}
    times : int

    Returns
    -------
    cage : Cage
    face : ndarray, shape (F',), int64
        Face of the first cage that each face lies in.
    corners : csr_array, shape (C', C)
        What takes values at the corners of the first cage to those of this one.
    """
    face, total = np.arange(len(cage.counts)), eye_array(len(cage.index), format="csr")
    for _ in range(times):
        cage, parent, step = _split(cage, scheme == "loop")
        face, total = face[parent], csr_array(step @ total)
    return cage, face, total


class _Edges:
    """The edges of a cage, and what of them begins at each corner."""

    def __init__(self, cage: Cage):
        n_corners, n_points = len(cage.index), len(cage.points)
        self.face = np.repeat(np.arange(len(cage.counts)), cage.counts)
        first = np.cumsum(cage.counts) - cage.counts
        corner = np.arange(n_corners)
        place = corner - first[self.face]
        self.next = first[self.face] + (place + 1) % cage.counts[self.face]
        self.previous = first[self.face] + (place - 1) % cage.counts[self.face]
        ends = np.sort(np.stack([cage.index, cage.index[self.next]], axis=1), axis=1)
        key, self.of_corner = np.unique(ends[:, 0] * n_points + ends[:, 1], return_inverse=True)
        self.ends = np.stack([key // n_points, key % n_points], axis=1)  # (E, 2)
        self.n_faces = np.bincount(self.of_corner, minlength=len(key))
        self.sharpness = np.where(self.n_faces == 2, 0.0, INFINITE)
        if len(cage.creases):
            sharp = np.sort(cage.creases, axis=1)
            wanted = sharp[:, 0] * n_points + sharp[:, 1]
            at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
            found = key[at] == wanted
            np.maximum.at(self.sharpness, at[found], cage.sharpness[found])


def _sums(where: np.ndarray, rows: np.ndarray, n: int) -> np.ndarray:
    """Sums of rows (N, 3) by an index, shape (n, 3)."""
    return np.stack([np.bincount(where, rows[:, k], n) for k in range(3)], axis=1)


def _split(cage: Cage, is_loop: bool) -> tuple[Cage, np.ndarray, csr_array]:
    """The cage split once, the parents of its faces, and the weights of its corners."""
    edges, p = _Edges(cage), cage.points
    n_points, n_edges, n_faces = len(p), len(edges.ends), len(cage.counts)
    a, b = edges.ends.T
    middle = (p[a] + p[b]) / 2
    centre = _sums(edges.face, p[cage.index], n_faces) / cage.counts[:, None]
    beside = np.maximum(edges.n_faces, 1)[:, None]
    if is_loop:
        across = _sums(edges.of_corner, p[cage.index[edges.previous]], n_edges) / beside
        smooth = 0.75 * middle + 0.25 * across
    else:
        smooth = (middle + _sums(edges.of_corner, centre[edges.face], n_edges) / beside) / 2
    blend = np.clip(edges.sharpness, 0, 1)[:, None]
    on_edges = (1 - blend) * smooth + blend * middle
    at_points = _moved(cage, edges, centre, middle, is_loop)

    corner, edge = cage.index, n_points + edges.of_corner
    before = edge[edges.previous]
    if is_loop:
        points = np.concatenate([at_points, on_edges])
        inner = edge.reshape(-1, 3)
        faces = np.concatenate([np.stack([corner, edge, before], axis=1), inner])
        parent, size = np.concatenate([edges.face, np.arange(n_faces)]), 3
    else:
        points = np.concatenate([at_points, on_edges, centre])
        faces = np.stack([corner, edge, n_points + n_edges + edges.face, before], axis=1)
        parent, size = edges.face, 4
    left = edges.sharpness - (edges.sharpness < INFINITE)
    stays = left > 0
    halves = np.concatenate([np.stack([end[stays], n_points + np.flatnonzero(stays)], axis=1) for end in (a, b)])
    corners = np.zeros(len(points))
    corners[:n_points] = np.maximum(cage.corners - (cage.corners < INFINITE), 0)
    cage = Cage(points, faces.ravel(), np.full(len(faces), size), halves, np.tile(left[stays], 2), corners)
    return cage, parent, _corner_weights(edges, is_loop)


def _moved(cage: Cage, edges: _Edges, centre: np.ndarray, middle: np.ndarray, is_loop: bool) -> np.ndarray:
    """Where the points of a cage go, shape (P, 3)."""
    p, n = cage.points, len(cage.points)
    a, b = edges.ends.T
    valence = np.maximum(np.bincount(edges.ends.ravel(), minlength=n), 1)[:, None].astype(float)
    around = _sums(a, p[b], n) + _sums(b, p[a], n)
    if is_loop:
        beta = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / valence) / 4) ** 2) / valence
        smooth = (1 - valence * beta) * p + beta * around
    else:
        n_faces = np.maximum(np.bincount(cage.index, minlength=n), 1)[:, None]
        q = _sums(cage.index, centre[edges.face], n) / n_faces
        r = (_sums(a, middle, n) + _sums(b, middle, n)) / valence
        smooth = (q + 2 * r + (valence - 3) * p) / valence
    sharp = edges.sharpness > 0
    n_sharp = np.bincount(edges.ends[sharp].ravel(), minlength=n)
    along = _sums(a[sharp], p[b[sharp]], n) + _sums(b[sharp], p[a[sharp]], n)
    rule = np.where((n_sharp == 2)[:, None], 0.75 * p + along / 8, p)
    weight = np.bincount(edges.ends[sharp].ravel(), np.repeat(edges.sharpness[sharp], 2), n) / np.maximum(n_sharp, 1)
    weight = np.where(n_sharp >= 2, np.clip(weight, 0, 1), 0)[:, None]
    out = (1 - weight) * smooth + weight * rule
    # A point of one face alone is a corner of the border; one of none, or of a dart's end, stays smooth.
    alone = (np.bincount(cage.index, minlength=n) == 1) & (n_sharp == 2)
    pin = np.where(alone, 1.0, np.clip(cage.corners, 0, 1))[:, None]
    return (1 - pin) * out + pin * p


def _corner_weights(edges: _Edges, is_loop: bool) -> csr_array:
    """Linear interpolation at the corners of the split faces, shape (C', C)."""
    n = len(edges.face)
    every = eye_array(n, format="csr")
    after = every[edges.next]
    middle = csr_array((every + after) / 2)
    before = middle[edges.previous]
    if is_loop:
        blocks, inner = [every, middle, before], middle
    else:
        count = np.bincount(edges.face)
        of_face = coo_array((1 / count[edges.face], (edges.face, np.arange(n))), shape=(len(count), n)).tocsr()
        blocks, inner = [every, middle, of_face[edges.face], before], None
    k = len(blocks)
    out = _interleaved(blocks, k * n)
    if inner is None:
        return out
    return csr_array(vstack([out, inner]))


def _interleaved(blocks: list[csr_array], n_rows: int) -> csr_array:
    """Row i of every block in turn, for all i."""
    rows, columns, values = [], [], []
    for k, block in enumerate(blocks):
        found = block.tocoo()
        rows.append(found.row.astype(np.int64) * len(blocks) + k)
        columns.append(found.col)
        values.append(found.data)
    where = np.concatenate(rows), np.concatenate(columns)
    return coo_array((np.concatenate(values), where), shape=(n_rows, blocks[0].shape[1])).tocsr()
