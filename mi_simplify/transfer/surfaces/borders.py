"""
The borders of a mesh and its genus.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...errors import MeshError


def half_edges(faces: np.ndarray) -> np.ndarray:
    """
    The directed edges of all faces, shape (3F, 2): first those from corner 0 to 1, then 1 to 2, then 2 to 0.
    """
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edge_keys(edges: np.ndarray, n: int) -> np.ndarray:
    """
    One number for each undirected edge (..., 2) between ``n`` vertices.
    """
    low, high = edges.min(-1).astype(np.int64), edges.max(-1).astype(np.int64)
    return low * n + high


def require_surface(faces: np.ndarray, what: str) -> None:
    """
    Raise :class:`MeshError` unless the faces are one orientable piece, every edge between at most two of them.
    """
    n = int(faces.max()) + 1
    edges = half_edges(faces)
    _, counts = np.unique(edge_keys(edges, n), return_counts=True)
    if counts.max() > 2:
        raise MeshError(
            f"{what}: a surface expected, {np.count_nonzero(counts > 2)} edges have more than two faces; mend it"
        )
    if len(np.unique(edges[:, 0] * n + edges[:, 1])) < len(edges):
        raise MeshError(
            f"{what}: an oriented surface expected, neighbouring faces are wound against each other; mend it"
        )
    pieces, labels = connected_components(coo_array((np.ones(len(edges)), edges.T), shape=(n, n)), directed=False)
    sizes = np.bincount(labels[faces[:, 0]], minlength=pieces)
    n_pieces = int(np.count_nonzero(sizes))
    if n_pieces > 1:
        raise MeshError(f"{what}: one connected surface expected, it has {n_pieces} pieces; choose one with 'part'")


def border_loops(faces: np.ndarray) -> list[np.ndarray]:
    """
    Vertices along each border, in the direction of the faces beside it, the longest first.

    Raises
    ------
    MeshError
        A border touches itself at a vertex.
    """
    n = int(faces.max()) + 1
    edges = half_edges(faces)
    forward, backward = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    border = edges[~np.isin(forward, backward)]
    if len(np.unique(border[:, 0])) < len(border):
        raise MeshError("a border touches itself at a vertex, which no map to a square can show; split the vertex")
    after = np.full(n, -1)
    after[border[:, 0]] = border[:, 1]
    loops, left = [], set(border[:, 0].tolist())
    while left:
        start = min(left)
        loop, v = [start], int(after[start])
        while v != start:
            loop.append(v)
            v = int(after[v])
        left.difference_update(loop)
        loops.append(np.array(loop))
    return sorted(loops, key=len, reverse=True)


def genus(faces: np.ndarray, n_borders: int) -> int:
    """
    Number of handles of a connected oriented surface, by Euler's formula.
    """
    edges = half_edges(faces)
    n = int(faces.max()) + 1
    euler = len(np.unique(faces)) - len(np.unique(edge_keys(edges, n))) + len(faces)
    return (2 - n_borders - euler) // 2
