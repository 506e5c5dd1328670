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

_ROUNDS = 5
"""Of assigning faces to the closer one of two normals; they hardly move after two."""


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


def split_where_it_pays(mesh: Mesh, angle: float, vertices: int) -> Mesh:
    """
    Split vertices, whose faces then share two normals instead of one, until there are as many as asked for.

    A normal n of faces of areas A and normals m costs Σ A (1 - n·m), which is least for n along s = Σ A m. Splitting
    a vertex so that s = a + b then saves ‖a‖ + ‖b‖ - ‖s‖; those go first that save most. Path tracers cut light and
    view at the interpolated normal's horizon, so that large faces far from their normal come out dark, and no normal
    map mends that.

    Parameters
    ----------
    mesh : Mesh
    angle : float
        The two normals lie further apart than this [degrees]; at 180 nothing is split.
    vertices : int
        Of the result; a mesh that has more already is returned as it is.

    Returns
    -------
    Mesh
        The same faces and texture coordinates. The faces of a vertex that was not split keep their normal.
    """
    of = mesh.faces.ravel().copy()  # vertex of every corner
    vectors = np.repeat(area_vectors(mesh.positions[mesh.position_faces]), 3, axis=0)
    left, count = vertices - len(mesh.uvs), len(mesh.uvs)
    while left > 0:
        second, saved = _halves(of, vectors, count, np.cos(np.radians(angle)))
        # A few at a time: halves can be split again.
        best = np.argsort(-saved, kind="stable")[: max(1, left // 3)]
        best = best[saved[best] > 1e-9 * saved.sum()]
        if not len(best):
            break
        fresh = np.full(count, -1)
        fresh[best] = count + np.arange(len(best))
        moved = second & (fresh[of] >= 0)
        of[moved] = fresh[of[moved]]
        count, left = count + len(best), left - len(best)
    if count == len(mesh.uvs):
        return mesh

    def number(vertex: np.ndarray, part: np.ndarray) -> np.ndarray:
        split = np.bincount(vertex, minlength=len(mesh.uvs))[vertex] > 1
        rows = np.stack([mesh.normal_groups[vertex], np.where(split, part + 1, 0)], 1)
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)

    return _with_vertices(mesh, of, number)


def _halves(of: np.ndarray, vectors: np.ndarray, n: int, least: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Which corners are in the second of two parts of their vertex, shape (3 F,), bool, and what the parting saves, shape
    (n,): two means of directions, begun across the widest spread. 0 where the cosine between them is above ``least``.
    """
    length = np.linalg.norm(vectors, axis=1)
    unit = vectors / np.maximum(length, 1e-300)[:, None]
    weight = np.maximum(np.bincount(of, length, n), 1e-300)
    total = _sums(of, vectors, n)
    mean = total / weight[:, None]
    away = unit - mean[of]
    spread = _sums(of, (length[:, None, None] * away[:, :, None] * away[:, None, :]).reshape(-1, 9), n)
    axis = np.linalg.eigh((spread / weight[:, None]).reshape(-1, 3, 3))[1][..., 2]
    second = np.einsum("ci,ci->c", away, axis[of]) > 0
    for _ in range(_ROUNDS):
        b = _unit(_sums(of[second], vectors[second], n))
        a = _unit(_sums(of[~second], vectors[~second], n))
        second = np.einsum("ci,ci->c", unit, (b - a)[of]) > 0
    b, a = _sums(of[second], vectors[second], n), _sums(of[~second], vectors[~second], n)
    saved = np.linalg.norm(a, axis=1) + np.linalg.norm(b, axis=1) - np.linalg.norm(total, axis=1)
    return second, np.where(np.einsum("vi,vi->v", _unit(a), _unit(b)) < least, np.maximum(saved, 0), 0)


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
