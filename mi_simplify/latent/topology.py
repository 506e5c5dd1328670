"""
Mesh topology in vectorised NumPy, computed once per mesh: welding, normals, edges.
"""

from __future__ import annotations

import numpy as np


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
    Angle-weighted unit normals over welded positions (Thürmer and Wüthrich 1998).

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
        Indices into ``positions``.

    Returns
    -------
    ndarray, shape (P, 3), float64
        +Y for a position without a face of positive area.
    """
    p = np.asarray(positions, np.float64)[faces]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    length = np.linalg.norm(n, axis=1, keepdims=True)
    n = np.divide(n, length, out=np.zeros_like(n), where=length > 0)
    weighted = n[:, None, :] * corner_angles(np.asarray(positions, np.float64), faces)[..., None]
    out = np.zeros((len(positions), 3))
    for axis in range(3):
        out[:, axis] = np.bincount(faces.ravel(), weighted[..., axis].ravel(), len(positions))
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.where(length > 1e-12, out / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
