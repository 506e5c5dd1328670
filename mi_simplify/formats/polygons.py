"""
From polygons with an index per attribute, as OBJ, PLY and USD store them, to triangles with one index per vertex.
"""

from __future__ import annotations

import numpy as np

from ..model.topology import vertex_normals, weld


def fan(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Split polygons into fans of triangles around their first corner.

    Parameters
    ----------
    counts : ndarray, shape (N,), int64
        Corners of each polygon; those below 3 give nothing.

    Returns
    -------
    corners : ndarray, shape (F, 3), int64
        Indices into the corners of all polygons, laid end to end.
    polygons : ndarray, shape (F,), int64
        The polygon that each triangle came from.
    """
    counts = np.asarray(counts, np.int64)
    first = np.cumsum(counts) - counts
    n = np.maximum(counts - 2, 0)
    polygons = np.repeat(np.arange(len(counts)), n)
    k = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    a = first[polygons]
    return np.stack([a, a + k + 1, a + k + 2], axis=1), polygons


def split_corners(*columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    One vertex for each distinct combination of attribute indices.

    Parameters
    ----------
    *columns : ndarray, shape (C,), int
        Position index of each corner first, then those of its other attributes.

    Returns
    -------
    first : ndarray, shape (V,), int64
        A corner that has each vertex's combination, sorted by position index.
    vertex : ndarray, shape (C,), int64
        Vertex of each corner.
    """
    order = np.lexsort(columns[::-1])
    new = np.zeros(len(order), bool)
    new[:1] = True
    for column in columns:
        ordered = column[order]
        new[1:] |= ordered[1:] != ordered[:-1]
    vertex = np.empty(len(order), np.int64)
    vertex[order] = np.cumsum(new) - 1
    return order[new], vertex


def unique_rows(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Distinct rows and the index of each row among them; NaN rows stay apart.
    """
    columns = [np.unique(values[:, i], return_inverse=True)[1] for i in range(values.shape[1])]
    first, index = split_corners(*columns)
    return values[first], index


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """
    Angle-weighted normals over welded positions, shape (V, 3).

    For meshes without normals that are about to be cut into parts, which would crease along the cut.
    """
    used, compact = np.unique(faces, return_inverse=True)
    positions, index = weld(vertices[used])
    out = np.zeros((len(vertices), 3))
    out[used] = vertex_normals(positions, index[compact.reshape(-1, 3)])[index]
    return out
