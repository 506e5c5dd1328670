"""
Mesh topology in vectorised NumPy, computed once per mesh: welding, normals, edges.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def weld(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Merge vertices of equal coordinates.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)

    Returns
    -------
    positions : ndarray, shape (P, 3)
        Distinct coordinates, in order of first appearance.
    position_index : ndarray, shape (V,), int64
        ``positions[position_index] == vertices``.
    """
    key = np.ascontiguousarray(vertices) + 0.0  # -0.0 and 0.0 are the same place
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[inverse.reshape(-1)]


def area_vectors(corners: np.ndarray) -> np.ndarray:
    """
    Normals of triangles, each as long as twice its area, shape (F, 3).

    Parameters
    ----------
    corners : ndarray, shape (F, 3, 3)
    """
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def corner_angles(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """
    Inner angle at every corner [rad], shape (F, 3); 0 where an edge has no length.
    """
    p = positions[faces]  # (F, 3, 3)
    a = np.roll(p, -1, axis=1) - p
    b = np.roll(p, 1, axis=1) - p
    cross = np.linalg.norm(np.cross(a, b), axis=2)
    return np.arctan2(cross, np.einsum("fci,fci->fc", a, b))


def vertex_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """
    Angle-weighted unit normals (Thürmer and Wüthrich 1998).

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
        Indices into ``positions``.

    Returns
    -------
    ndarray, shape (P, 3), float64
        +Y where no face has area.
    """
    positions = np.asarray(positions, np.float64)
    n = area_vectors(positions[faces])
    length = np.linalg.norm(n, axis=1, keepdims=True)
    n = np.divide(n, length, out=np.zeros_like(n), where=length > 0)
    weighted = n[:, None, :] * corner_angles(positions, faces)[..., None]
    return _unit_or_up(_corner_sums(weighted, faces, len(positions)), 1e-12)


CORRECTION = 1.6
"""
Factor of the one step of :func:`fitted_normals`: best for the eigenvalues of a mass matrix over its row sums, which lie
between 1/4 and 1.
"""


def fitted_normals(positions: np.ndarray, faces: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """
    Unit normals whose linear interpolation is close to the normals of the faces, in the mean square over the surface.

    The means by area, corrected once by what their interpolation misses: a Richardson step on the mass matrix of
    linear elements. Further ones change the square by less than 1 %. A large flat face stays flat beside a narrow
    bevel, and path tracers, which cut light and view at the horizon of the interpolated normal, lose less of both.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
        Indices into ``positions``.
    groups : ndarray, shape (F, 3)
        Which corners share a normal.

    Returns
    -------
    ndarray, shape (number of groups, 3), float64
        +Y where no face has area.
    """
    n_groups = int(groups.max(initial=-1)) + 1
    n = area_vectors(np.asarray(positions, np.float64)[faces])[:, None, :]  # (F, 1, 3)
    area = np.linalg.norm(n, axis=2, keepdims=True)
    total = _corner_sums(np.broadcast_to(area, (*faces.shape, 1)), groups, n_groups)
    scale = np.divide(1, total, out=np.zeros_like(total), where=total > 1e-12 * area.max(initial=0))
    mean = _corner_sums(np.broadcast_to(n, (*faces.shape, 3)), groups, n_groups) * scale
    corner = mean[groups]
    missed = n - area / 4 * (corner + corner.sum(1, keepdims=True))
    return _unit_or_up(mean + CORRECTION * scale * _corner_sums(missed, groups, n_groups), 1e-6)


def _corner_sums(values: np.ndarray, groups: np.ndarray, n: int) -> np.ndarray:
    """Sums of (F, 3, K) over the corners of a group, shape (n, K)."""
    flat = values.reshape(-1, values.shape[2])
    return np.stack([np.bincount(groups.ravel(), column, n) for column in flat.T], 1)


def _unit_or_up(x: np.ndarray, least: float) -> np.ndarray:
    """Unit vectors; +Y where a length is not above ``least``."""
    length = np.linalg.norm(x, axis=1, keepdims=True)
    return np.where(length > least, x / np.maximum(length, 1e-300), [0.0, 1.0, 0.0])


def normal_groups(
    positions: np.ndarray, faces: np.ndarray, crease_angle: float, where: np.ndarray | None = None
) -> np.ndarray:
    """
    Which corners share a normal: those around a position that no crease separates.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
        Over welded positions.
    crease_angle : float
        Edges whose faces turn by more than this are creases [degrees]; 180 has none.
    where : ndarray, shape (F, 3), bool, optional
        Edges, from corner k to corner k + 1, that may be creases at all.

    Returns
    -------
    ndarray, shape (F, 3), int64
        Group of every corner, numbered from 0; a group lies at one position.
    """
    n_faces = len(faces)
    p = np.asarray(positions, np.float64)[faces]
    n = area_vectors(p)
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
    corner = np.arange(3 * n_faces).reshape(-1, 3)
    start, end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(a, b) * np.int64(len(positions)) + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][1:] == key[order][:-1])
    first, second = order[pair], order[pair + 1]
    smooth = np.einsum("ij,ij->i", n[first // 3], n[second // 3]) >= np.cos(np.radians(crease_angle)) - 1e-9
    if where is not None:
        smooth |= ~(where.ravel()[first] | where.ravel()[second])
    first, second = first[smooth], second[smooth]
    # Neighbours run along their edge in opposite directions, unless one is wound the wrong way.
    against = a[first] == b[second]
    links = np.concatenate(
        [
            np.stack([start[first], np.where(against, end[second], start[second])], axis=1),
            np.stack([end[first], np.where(against, start[second], end[second])], axis=1),
        ]
    )
    graph = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(3 * n_faces, 3 * n_faces))
    _, label = connected_components(graph, directed=False)
    return label.reshape(-1, 3).astype(np.int64)
