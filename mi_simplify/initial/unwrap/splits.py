"""
Which vertices of a charted mesh have two normals: free ones along seams, hard edges, and those that pay most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...model.mesh import Mesh
from ...model.topology import area_vectors, normal_groups
from ..manifold import edge_pairs

_ROUNDS = 6
"""Of fitting normals, and of assigning corners to the closer one of two; both hardly move after three."""


def creased(mesh: Mesh, angle: float, hard: np.ndarray | None) -> Mesh:
    """
    Two normals along sharp edges that are hard or the border of a chart, where they cost no vertex.

    Parameters
    ----------
    mesh : Mesh
        One normal a position.
    angle : float
        Edges that turn by more are sharp [degrees].
    hard : ndarray, shape (F, 3), bool, optional
        Edges, from corner k to corner k + 1, that may be creases inside a chart; all if not given.
    """
    _, edge_of, counts = edge_pairs(mesh.faces)
    border = (counts[edge_of] == 1).T
    groups = normal_groups(mesh.positions, mesh.position_faces, angle, None if hard is None else hard | border)
    return _with_vertices(mesh, groups.ravel(), lambda of, group: group)


def split_where_it_pays(mesh: Mesh, angle: float, vertices: int, weights: np.ndarray | None = None) -> Mesh:
    """
    A normal for every vertex, also along seams, and vertices split in two until there are as many as asked for.

    Normals whose linear interpolation misses those of the faces least, in the mean square over the surface, are linear
    least squares (see :func:`...model.topology.fitted_normals`); in it each corner asks its vertex for one normal, with
    the others as they are, and two normals instead of one for a vertex save what its corners' wishes lie apart. Those
    are split first that save most. Path tracers cut light and view at the interpolated normal's horizon, so that large
    faces far from their normal come out dark, and no normal map mends that.

    Parameters
    ----------
    mesh : Mesh
    angle : float
        The two normals lie further apart than this [degrees]; at 180 the mesh is returned as it is.
    vertices : int
        Of the result; a mesh that has more already is not split.
    weights : ndarray, shape (F,), optional
        What a face counts beside its area, such as how much of it is seen.

    Returns
    -------
    Mesh
        The same faces and texture coordinates.
    """
    if angle >= 180:
        return mesh
    vectors = area_vectors(mesh.positions[mesh.position_faces])
    area = np.linalg.norm(vectors, axis=1)
    normal = vectors / np.maximum(area, 1e-300)[:, None]
    area = area if weights is None else area * weights
    weight, of, count = np.repeat(area, 3), mesh.faces.ravel().copy(), len(mesh.uvs)
    own = np.zeros((count, 3))
    while True:
        own, wish = _fitted(of, normal, area, own)
        left = vertices - count
        if left <= 0:
            break
        second, saved = _halves(of, wish, weight, count, np.cos(np.radians(angle)))
        # A few at a time: halves can be split again, and their neighbours wish for other normals then.
        best = np.argsort(-saved, kind="stable")[: max(1, left // 3)]
        best = best[saved[best] > 1e-9 * saved.sum()]
        if not len(best):
            break
        fresh = np.full(count, -1)
        fresh[best] = count + np.arange(len(best))
        moved = second & (fresh[of] >= 0)
        of[moved] = fresh[of[moved]]
        own, count = np.concatenate([own, own[best]]), count + len(best)
    return _with_vertices(mesh, of, lambda vertex, part: np.arange(len(part)))


def _fitted(of: np.ndarray, normal: np.ndarray, area: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Normals of the vertices, (n, 3), not of unit length, begun at ``own``, and what each corner wishes for, (3 F, 3):
    the mean square of m - Σ b_k n_k over a triangle is, up to a factor, Σ d_k² + (Σ d_k)² of d_k = m - n_k.
    """
    n = len(own)
    total = np.maximum(np.bincount(of, np.repeat(area, 3), n), 1e-300)[:, None]
    for _ in range(_ROUNDS):
        corner = own[of].reshape(-1, 3, 3)
        missed = normal[:, None] - (corner + corner.sum(1, keepdims=True)) / 4
        own = own + _sums(of, (area[:, None, None] * missed).reshape(-1, 3), n) / total
    short = normal[:, None] - own[of].reshape(-1, 3, 3)
    wish = normal[:, None] + (short.sum(1, keepdims=True) - short) / 2
    return own, wish.reshape(-1, 3)


def _halves(
    of: np.ndarray, wish: np.ndarray, weight: np.ndarray, n: int, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """
    Which corners are in the second of two parts of their vertex, shape (3 F,), bool, and what the parting saves, shape
    (n,): two means, begun across the widest spread. 0 where the cosine between them is above ``least``.
    """
    weights, middle = _mean(of, wish, weight, n)
    weights = np.maximum(weights, 1e-300)
    away = wish - middle[of]
    spread = _sums(of, (weight[:, None, None] * away[:, :, None] * away[:, None, :]).reshape(-1, 9), n)
    axis = np.linalg.eigh((spread / weights[:, None]).reshape(-1, 3, 3))[1][..., 2]
    second = np.einsum("ci,ci->c", away, axis[of]) > 0
    for _ in range(_ROUNDS):
        a, b = (_mean(of[part], wish[part], weight[part], n)[1] for part in (~second, second))
        second = np.sum((wish - b[of]) ** 2 - (wish - a[of]) ** 2, axis=1) < 0
    (in_a, a), (in_b, b) = (_mean(of[part], wish[part], weight[part], n) for part in (~second, second))
    saved = in_a * in_b / weights * np.sum((a - b) ** 2, axis=1)  # 0 where either part is empty
    return second, np.where(np.einsum("vi,vi->v", _unit(a), _unit(b)) < least, saved, 0)


def _mean(of: np.ndarray, values: np.ndarray, weight: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n,) and weighted means (n, K) of rows (C, K) that belong to one vertex each."""
    total = np.bincount(of, weight, n)
    return total, _sums(of, weight[:, None] * values, n) / np.maximum(total, 1e-300)[:, None]


def _sums(of: np.ndarray, values: np.ndarray, n: int) -> np.ndarray:
    """Sums of rows, (C, K), that belong to one vertex, (n, K)."""
    return np.stack([np.bincount(of, column, n) for column in values.T], 1)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300)


def _with_vertices(mesh: Mesh, part: np.ndarray, group: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Mesh:
    """
    The mesh with a vertex for every pair of its own and a part, one a corner (3 F,), which ``group`` gives its normal.
    """
    pairs = np.stack([mesh.faces.ravel(), part], 1)
    pairs, vertex = np.unique(pairs, axis=0, return_inverse=True)
    of = pairs[:, 0]
    return replace(
        mesh, position_index=mesh.position_index[of], uvs=mesh.uvs[of], faces=vertex.reshape(-1, 3),
        normal_index=group(of, pairs[:, 1]),
    )  # fmt: skip
