"""
Closest points on a triangle set, exact on the candidates that a KD-tree over surface samples proposes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class Closest:
    """
    Where points land on a surface.

    Parameters
    ----------
    face : ndarray, shape (N,), int64
        Triangle.
    barycentric : ndarray, shape (N, 3), float64
        Weights of its corners.
    point : ndarray, shape (N, 3), float64
    distance : ndarray, shape (N,), float64
        [units of the vertices]
    """

    face: np.ndarray
    barycentric: np.ndarray
    point: np.ndarray
    distance: np.ndarray


class ClosestPoints:
    """
    Closest-point queries against a fixed triangle set.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
    faces : ndarray, shape (F, 3)
    n_samples : int
        Surface samples that the tree holds beside one per triangle; more find the right triangle more often.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, n_samples: int = 200_000, seed: int = 0):
        self.corners = np.asarray(vertices, np.float64)[faces]  # (F, 3, 3)
        cross = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        self.double_area = np.linalg.norm(cross, axis=1)
        self.normals = cross / np.maximum(self.double_area, 1e-300)[:, None]  # (F, 3)
        points, self._face_of = sample_surface(self.corners, self.double_area, n_samples, seed)
        self._tree = cKDTree(points)

    def query(self, points: np.ndarray, normals: np.ndarray | None = None, candidates: int = 8) -> Closest:
        """
        Closest point among the triangles of the nearest samples.

        Parameters
        ----------
        points : ndarray, shape (N, 3)
        normals : ndarray, shape (N, 3), optional
            Prefer triangles that face the same way; others are taken only where no candidate does.
        """
        points = np.asarray(points, np.float64)
        if not len(points):
            none = np.zeros((0, 3))
            return Closest(np.zeros(0, np.int64), none, none, np.zeros(0))
        _, near = self._tree.query(points, k=min(candidates, len(self._face_of)), workers=-1)
        face = self._face_of[near.reshape(len(points), -1)]  # (N, K)
        bary = closest_barycentric(np.repeat(points, face.shape[1], axis=0), self.corners[face.ravel()])
        bary = bary.reshape(*face.shape, 3)
        point = np.einsum("nkc,nkci->nki", bary, self.corners[face])
        distance = np.linalg.norm(point - points[:, None], axis=2)
        cost = distance
        if normals is not None:
            away = np.einsum("nki,ni->nk", self.normals[face], normals) <= 0
            cost = distance + away * (distance.max() + 1.0)
        best = cost.argmin(1)
        row = np.arange(len(points))
        return Closest(face[row, best], bary[row, best], point[row, best], distance[row, best])


def sample_surface(corners: np.ndarray, double_area: np.ndarray, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """
    The centre of every triangle and about ``n`` points spread by area.

    Returns
    -------
    points : ndarray, shape (N, 3)
    face : ndarray, shape (N,)
    """
    rng = np.random.default_rng(seed)
    total = double_area.sum()
    wanted = double_area * (n / total) if total > 0 else np.zeros(len(corners))
    count = np.floor(wanted + rng.random(len(corners))).astype(np.int64)
    face = np.repeat(np.arange(len(corners)), count)
    r, s = np.sqrt(rng.random(len(face))), rng.random(len(face))
    bary = np.stack([1 - r, r * (1 - s), r * s], 1)
    points = np.concatenate([corners.mean(1), np.einsum("nc,nci->ni", bary, corners[face])])
    return points, np.concatenate([np.arange(len(corners)), face])


def closest_barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """
    Barycentric coordinates of the point of each triangle closest to each point (Ericson 2005, Sect. 5.1.5).

    Parameters
    ----------
    points : ndarray, shape (N, 3)
    corners : ndarray, shape (N, 3, 3)

    Returns
    -------
    ndarray, shape (N, 3)
    """
    a, b, c = corners.transpose(1, 0, 2)
    ab, ac = b - a, c - a

    def dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.einsum("ni,ni->n", x, y)

    d1, d2 = dot(ab, points - a), dot(ac, points - a)
    d3, d4 = dot(ab, points - b), dot(ac, points - b)
    d5, d6 = dot(ab, points - c), dot(ac, points - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2

    def ratio(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return x / np.where(np.abs(y) > 1e-300, y, 1.0)

    zero, one = np.zeros_like(d1), np.ones_like(d1)
    t_ab, t_ac, t_bc = ratio(d1, d1 - d3), ratio(d2, d2 - d6), ratio(d4 - d3, (d4 - d3) + (d5 - d6))
    total = va + vb + vc
    rules = [
        ((d1 <= 0) & (d2 <= 0), (one, zero, zero)),
        ((d3 >= 0) & (d4 <= d3), (zero, one, zero)),
        ((d6 >= 0) & (d5 <= d6), (zero, zero, one)),
        ((vc <= 0) & (d1 >= 0) & (d3 <= 0), (1 - t_ab, t_ab, zero)),
        ((vb <= 0) & (d2 >= 0) & (d6 <= 0), (1 - t_ac, zero, t_ac)),
        ((va <= 0) & (d4 >= d3) & (d5 >= d6), (zero, 1 - t_bc, t_bc)),
    ]
    inside = (ratio(va, total), ratio(vb, total), ratio(vc, total))
    conditions = [rule for rule, _ in rules]
    return np.stack([np.select(conditions, [v[k] for _, v in rules], inside[k]) for k in range(3)], 1)
