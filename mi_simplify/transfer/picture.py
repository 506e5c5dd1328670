"""
Pictures of an object from its coefficients: what a pixel sees is found once, and shaded under any light.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ..machine.meshes import make_mesh
from .light import shade


@dataclass(frozen=True)
class Camera:
    """
    A pinhole camera; it looks at ``target`` from ``origin``, +Y up, ``fov`` degrees across a square picture.
    """

    origin: np.ndarray
    target: np.ndarray
    fov: float = 35.0

    @classmethod
    def around(cls, points: np.ndarray, azimuth: float = 30.0, elevation: float = 20.0, fov: float = 35.0) -> Camera:
        """
        From a direction [degrees around +Y from +Z, degrees up], so far away that points (..., 3) fit into the picture.
        """
        flat = np.asarray(points, np.float64).reshape(-1, 3)
        low, high = flat.min(0), flat.max(0)
        a, e = np.radians(azimuth), np.radians(elevation)
        away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        radius = np.linalg.norm(flat - (low + high) / 2, axis=1).max()
        return cls((low + high) / 2 + away * radius / np.sin(np.radians(fov) / 2), (low + high) / 2, fov)

    def rays(self, size: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Origins and unit directions through the pixel centres, row by row, shape (size², 3) each.
        """
        forward = _unit(self.target - self.origin)
        right = _unit(np.cross(forward, [0.0, 1.0, 0.0]))
        up = np.cross(right, forward)
        at = (2 * (np.arange(size) + 0.5) / size - 1) * np.tan(np.radians(self.fov) / 2)
        d = forward + at[None, :, None] * right - at[:, None, None] * up
        d = _unit(d).reshape(-1, 3)
        return np.broadcast_to(self.origin, d.shape), d


@dataclass(frozen=True)
class Hits:
    """
    What the pixels of a picture see.

    Parameters
    ----------
    covered : ndarray, shape (size, size), bool
        The front of the object; its back counts as nothing.
    corners : ndarray, shape (size, size, 3), int64
        Vertices of the triangle.
    weights : ndarray, shape (size, size, 3), float32
        Barycentric coordinates.
    """

    covered: np.ndarray
    corners: np.ndarray
    weights: np.ndarray

    def shaded(self, transfer: np.ndarray, light: np.ndarray) -> np.ndarray:
        """
        Radiance and coverage, shape (size, size, 4), linear, from transfer (V, K) and light (K, 3).
        """
        radiance = shade(np.einsum("hwj,hwjk->hwk", self.weights, np.asarray(transfer)[self.corners]), light)
        return np.concatenate([radiance, np.ones_like(radiance[..., :1])], axis=2) * self.covered[..., None]


def seen(positions: np.ndarray, faces: np.ndarray, camera: Camera, size: int) -> Hits:
    """
    Find what each pixel of a picture sees.

    Parameters
    ----------
    positions : ndarray, shape (V, 3)
    faces : ndarray, shape (F, 3)
    camera : Camera
    size : int
        Width and height [px].
    """
    origin, d = camera.rays(size)
    scene = mi.load_dict({"type": "scene", "object": make_mesh("object", positions, faces)})
    ray = mi.Ray3f(*(np.ascontiguousarray(x.T, np.float32) for x in (origin, d)))
    hit = scene.ray_intersect_preliminary(ray, coherent=True)
    valid = np.array(hit.is_valid())
    prim = np.where(valid, np.array(hit.prim_index), 0).astype(np.int64)
    v = np.where(valid, np.array(hit.prim_uv), 0).T
    corners = np.asarray(faces)[prim]
    p = np.asarray(positions, np.float64)[corners]
    front = np.einsum("ni,ni->n", np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), d) < 0
    weights = np.stack([1 - v[:, 0] - v[:, 1], v[:, 0], v[:, 1]], axis=1).astype(np.float32)
    covered = valid & front
    return Hits(covered.reshape(size, size), corners.reshape(size, size, 3), weights.reshape(size, size, 3))


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)
