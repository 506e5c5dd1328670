"""
Where the asset's own normals jump, on the mesh that is made from it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..model.asset import Asset
from ..model.topology import area_vectors
from .manifold import manifold_neighbours
from .soup import merge

_JUMP = 20.0
"""Two normals of one place that lie further apart are a hard edge [degrees]."""
_ALONG = 0.8
"""Least cosine between an edge of the mesh and the hard edge that it stands for."""
_SAMPLES = 100_000
"""Points on all hard edges together."""


def hard_edges(asset: Asset, positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """
    Edges of a mesh that run along a hard edge of the asset: one where the normals of its file jump.

    Parameters
    ----------
    asset : Asset
        Scans, whose files have no normals or smooth ones, have no hard edges.
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
        Over welded positions, in the frame of the asset.

    Returns
    -------
    ndarray, shape (F, 3), bool
        Of the edge from corner k to corner k + 1.
    """
    ends = _hard_segments(asset)  # (H, 2, 3)
    if not len(ends):
        return np.zeros(faces.shape, bool)
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    n = np.ceil(length / max(length.sum() / _SAMPLES, 1e-300)).astype(np.int64)
    k = np.repeat(np.arange(len(ends)), n)
    t = (np.arange(len(k)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[k]
    tree = cKDTree(ends[k, 0] + t[:, None] * along[k])

    p = np.asarray(positions, np.float64)[faces]
    q = np.roll(p, -1, axis=1)
    edge = q - p
    long = np.linalg.norm(edge, axis=2)
    height = np.linalg.norm(area_vectors(p), axis=1)[:, None] / np.maximum(long, 1e-300)
    near = 0.3 * np.minimum(height, long)
    out = np.ones(faces.shape, bool)
    for s in (0.25, 0.5, 0.75):
        distance, hit = tree.query(p + s * edge, workers=-1)
        direction = along[k[hit]] / np.maximum(length[k[hit]], 1e-300)[..., None]
        out &= distance <= near
        out &= np.abs(np.einsum("fki,fki->fk", direction, edge)) >= _ALONG * long
    return out


def _hard_segments(asset: Asset) -> np.ndarray:
    """Ends of the asset's edges at which the normals of two faces jump, shape (H, 2, 3)."""
    soup = merge(asset)
    faces = soup.position_faces
    left, right = manifold_neighbours(faces)
    n_faces = len(faces)
    normals = soup.normals[soup.faces].transpose(1, 0, 2).reshape(-1, 3)  # of corner · F + face
    has = soup.has_normals[soup.faces].all(1)
    at, after = faces.T.ravel(), lambda half: (half + n_faces) % (3 * n_faces)
    swap = at[left] == at[right]  # wound the wrong way
    other_start, other_end = np.where(swap, right, after(right)), np.where(swap, after(right), right)
    least = np.cos(np.radians(_JUMP))
    same = np.einsum("ei,ei->e", normals[left], normals[other_start]) >= least
    same &= np.einsum("ei,ei->e", normals[after(left)], normals[other_end]) >= least
    jump = left[~same & has[left % n_faces] & has[right % n_faces]]
    return np.stack([soup.positions[at[jump]], soup.positions[at[after(jump)]]], 1)
