"""
Mitsuba's analytic shapes as triangles, in the texture coordinates that Mitsuba gives them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.topology import area_vectors

#: Segments around a circle; a polygon of so many corners lies within 0.0003 radii of it.
SEGMENTS = 128


@dataclass(frozen=True)
class Patch:
    """
    Triangles with everything that shading asks for.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3), float64
    faces : ndarray, shape (F, 3), int64
        Counter-clockwise seen from where the normals point to.
    normals : ndarray, shape (V, 3), float64
        Unit vectors.
    uvs : ndarray, shape (V, 2), float64, or None
        As in ``si.uv`` of Mitsuba; a mesh may have none.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray | None

    def placed(self, to_world: np.ndarray, flip_normals: bool = False) -> Patch:
        """
        Under an affine transform, shape (4, 4); normals stay on their side where it mirrors.
        """
        linear = to_world[:3, :3]
        normals = self.normals @ np.linalg.inv(linear)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        rewound = (np.linalg.det(linear) < 0) != flip_normals
        return Patch(
            self.vertices @ linear.T + to_world[:3, 3],
            self.faces[:, ::-1] if rewound else self.faces,
            -normals if flip_normals else normals,
            self.uvs,
        )


def _grid(n_u: int, n_v: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates (V,) of a grid over the unit square, u first, and its faces with du x dv towards the viewer."""
    u, v = (g.ravel() for g in np.meshgrid(np.arange(n_u + 1) / n_u, np.arange(n_v + 1) / n_v, indexing="ij"))
    k = np.arange(len(u)).reshape(n_u + 1, n_v + 1)
    c00, c10, c11, c01 = (c.ravel() for c in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    return u, v, np.concatenate([np.stack([c00, c10, c11], 1), np.stack([c00, c11, c01], 1)])


def _flattened(faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """The faces without those that a pole has shrunk to a line."""
    p = vertices[faces]
    return faces[np.linalg.norm(area_vectors(p), axis=1) > 1e-12]


def sphere() -> Patch:
    """
    Unit sphere, u once around +Z from +X, v from +Z to -Z.
    """
    u, v, faces = _grid(SEGMENTS, SEGMENTS // 2)
    phi, theta = 2 * np.pi * u, np.pi * v
    p = np.stack([np.cos(phi) * np.sin(theta), np.sin(phi) * np.sin(theta), np.cos(theta)], 1)
    return Patch(p, _flattened(faces[:, ::-1], p), p, np.stack([u, v], 1))


def cylinder() -> Patch:
    """
    Open cylinder of radius 1 from z = 0 to 1, u once around, v along.
    """
    u, v, faces = _grid(SEGMENTS, 1)
    phi = 2 * np.pi * u
    n = np.stack([np.cos(phi), np.sin(phi), np.zeros_like(u)], 1)
    return Patch(n + v[:, None] * [0, 0, 1], faces, n, np.stack([u, v], 1))


def disk() -> Patch:
    """
    Unit disk that faces +Z, u the distance from its centre, v once around.
    """
    u, v, faces = _grid(1, SEGMENTS)
    phi = 2 * np.pi * v
    p = np.stack([u * np.cos(phi), u * np.sin(phi), np.zeros_like(u)], 1)
    return Patch(p, _flattened(faces, p), np.broadcast_to([0.0, 0.0, 1.0], p.shape), np.stack([u, v], 1))


def rectangle() -> Patch:
    """
    The square from -1 to 1 in x and y that faces +Z.
    """
    u, v, faces = _grid(1, 1)
    p = np.stack([2 * u - 1, 2 * v - 1, np.zeros_like(u)], 1)
    return Patch(p, faces, np.broadcast_to([0.0, 0.0, 1.0], p.shape), np.stack([u, v], 1))


#: By plugin name. Mitsuba's `cube` is a mesh already.
SHAPES = {"sphere": sphere, "cylinder": cylinder, "disk": disk, "rectangle": rectangle}
