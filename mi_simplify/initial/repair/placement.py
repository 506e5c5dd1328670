"""
Where the vertices of a reduced mesh best lie: a least-squares fit to the detailed surface, both ways.

Quadrics place a vertex on the planes around it, which leaves a coarse mesh inside of what it stands for and wears thin
tips away. A few steps of surface fitting (Hoppe et al. 1993, here with point-to-plane distances) bring both back.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, identity, kron
from scipy.sparse.linalg import spsolve

from ...model.topology import area_vectors
from ..closest import ClosestPoints, closest_barycentric, sample_surface
from ..manifold import edge_pairs

_STEPS = 4
_SAMPLES = 25_000
_TANGENTIAL = 0.15
"""Weight of the distance along the surface against the one across it."""
_SMOOTH, _STILL = 0.02, 0.002
"""Weights of the displacement's differences along edges, and of its length."""
_OUTLIER = 0.05
"""Distances beyond this share of the box's diagonal count for little: there is nothing to match."""
_SHARE = 0.6
"""How much of the way is gone. All of it would be closest in the mean, but edges then stand out of the silhouette."""
_EXACT = (0.003, 0.01)
"""Below the first ratio of distance to edge length a vertex is left where it is, above the second it moves freely."""


def settle(positions: np.ndarray, faces: np.ndarray, reference: ClosestPoints) -> np.ndarray:
    """
    Move the vertices of a reduced mesh so that the surfaces come closer; open borders stay.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
    reference : ClosestPoints
        The detailed surface, in the same frame, wound the same way.

    Returns
    -------
    ndarray, shape (P, 3), float64
        No face is turned over.
    """
    p = np.asarray(positions, np.float64)
    points, face = _spread(reference, _SAMPLES, seed=11)
    normals = reference.normals[face]
    edges, _, counts = edge_pairs(faces)
    pinned = np.zeros(len(p), bool)
    pinned[edges[counts != 2].ravel()] = True
    if pinned.all():
        return p
    freedom = _SHARE * _freedom(p, faces, edges, points, normals)
    moved = p
    for step in range(_STEPS):
        low = ClosestPoints(moved, faces, n_samples=min(2 * _SAMPLES, 50 * len(faces)), seed=step)
        pulls = _pulls(low, faces, reference, points, normals, step)
        displacement = _solve(pulls, len(p), edges, pinned)
        moved = _without_folds(moved, displacement, faces)
    return _without_folds(p, (moved - p) * freedom[:, None], faces)


def _spread(surface: ClosestPoints, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """About ``n`` points by area, and their faces."""
    c = surface.corners
    double_area = np.linalg.norm(area_vectors(c), axis=1)
    points, face = sample_surface(c, double_area, n, seed)
    return points[len(c) :], face[len(c) :]


def _freedom(p, faces, edges, points, normals) -> np.ndarray:
    """0 where the mesh is exact already (a box of planes), 1 where it is not, shape (P,)."""
    low = ClosestPoints(p, faces, n_samples=min(2 * _SAMPLES, 50 * len(faces)))
    hit = low.query(points, normals, candidates=4)
    alike = np.einsum("ni,ni->n", low.normals[hit.face], normals) > 0
    square = alike * np.einsum("ni,ni->n", points - hit.point, normals) ** 2
    corner = faces[hit.face].ravel()
    weight = np.bincount(corner, hit.barycentric.ravel(), len(p))
    error = np.sqrt(np.bincount(corner, (hit.barycentric * square[:, None]).ravel(), len(p)) / np.maximum(weight, 1e-9))
    length = np.repeat(np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1), 2)
    length = np.bincount(edges.ravel(), length, len(p)) / np.maximum(np.bincount(edges.ravel(), minlength=len(p)), 1)
    t = np.clip((error / np.maximum(length, 1e-30) - _EXACT[0]) / (_EXACT[1] - _EXACT[0]), 0, 1)
    return t * t * (3 - 2 * t)


def _pulls(low: ClosestPoints, faces, reference: ClosestPoints, points, normals, seed: int):
    """Vertices (N, 3) and their weights (N, 3), the plane's normal (N, 3), the way to go (N, 3), the weight (N,)."""
    there = low.query(points, normals, candidates=4)
    alike = np.einsum("ni,ni->n", low.normals[there.face], normals) > 0
    own, face = _spread(low, _SAMPLES // 2, seed)
    back = reference.query(own, low.normals[face], candidates=4)
    alike_back = np.einsum("ni,ni->n", reference.normals[back.face], low.normals[face]) > 0
    limit = _OUTLIER * np.linalg.norm(np.ptp(points, axis=0))

    def trust(alike: np.ndarray, distance: np.ndarray) -> np.ndarray:
        return alike / (1 + (distance / limit) ** 2) ** 2 / len(distance)

    return (
        np.concatenate([faces[there.face], faces[face]]),
        np.concatenate([there.barycentric, closest_barycentric(own, low.corners[face])]),
        np.concatenate([normals, reference.normals[back.face]]),
        np.concatenate([points - there.point, back.point - own]),
        np.concatenate([trust(alike, there.distance), 0.5 * trust(alike_back, back.distance)]),
    )


def _solve(pulls, n: int, edges: np.ndarray, pinned: np.ndarray) -> np.ndarray:
    """Displacement of least squared distances, shape (n, 3)."""
    vertices, weights, normals, way, trust = pulls
    m = len(vertices)
    blend = csr_array((weights.ravel(), (np.repeat(np.arange(m), 3), vertices.ravel())), shape=(m, n))
    across = csr_array(
        (
            (weights[:, :, None] * normals[:, None, :]).ravel(),
            (np.repeat(np.arange(m), 9), (3 * vertices[:, :, None] + np.arange(3)).ravel()),
        ),
        shape=(m, 3 * n),
    )
    w = diags_array(trust)
    mass = blend.T @ trust + 1e-12
    a, b = edges.T
    stiff = _SMOOTH * (mass[a] + mass[b]) / 6
    smooth = coo_array(
        (np.concatenate([stiff, stiff, -stiff, -stiff]), (np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a]))),
        shape=(n, n),
    )
    hold = np.where(pinned, 1e3 * mass.mean(), _STILL * mass)
    own = _TANGENTIAL**2 * (blend.T @ w @ blend) + smooth + diags_array(hold)
    matrix = across.T @ w @ across + kron(own, identity(3))
    right = across.T @ (trust * np.einsum("ni,ni->n", normals, way))
    right = right + _TANGENTIAL**2 * (blend.T @ (trust[:, None] * way)).ravel()
    return spsolve(matrix.tocsc(), right).reshape(n, 3)


def _without_folds(p: np.ndarray, displacement: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Positions after as much of the displacement as turns no face by more than some 70 degrees."""

    def normals(x: np.ndarray) -> np.ndarray:
        c = x[faces]
        return area_vectors(c)

    before = normals(p)
    share = np.ones(len(p))
    for attempt in range(8):
        after = normals(p + displacement * share[:, None])
        size = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        bad = np.einsum("fi,fi->f", before, after) < 0.3 * size
        if not bad.any():
            return p + displacement * share[:, None]
        share[np.unique(faces[bad])] *= 0.5 if attempt < 6 else 0.0
    return p
