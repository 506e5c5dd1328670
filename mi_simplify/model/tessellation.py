"""
Edge-midpoint subdivision of a base mesh, and its displacement along the interpolated normal, in plain NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .mesh import Mesh


@dataclass(frozen=True)
class Tessellation:
    """
    A base mesh whose faces are split in four, several times; every subdivision keeps the vertices of the one before,
    and appends the midpoints of its edges.

    Parameters
    ----------
    mesh : Mesh
        The finest one, not displaced, without creases.
    vertex_edges, position_edges : tuple of ndarray, shape (E, 2)
        Of each subdivision the edges, over vertices and over welded positions, whose midpoints are appended.
    base : Mesh
        Without creases.
    """

    mesh: Mesh
    vertex_edges: tuple[np.ndarray, ...]
    position_edges: tuple[np.ndarray, ...]
    base: Mesh

    @staticmethod
    def of(base: Mesh, subdivisions: int) -> Tessellation:
        """
        The topology, which no parameter moves.

        Base positions that a crease runs through get one normal all the same: surfaces that are displaced along two
        would come apart.
        """
        mesh = base = replace(base, normal_index=None)
        vertex_edges, position_edges = [], []
        for _ in range(subdivisions):
            mesh, of_vertices, of_positions = _split(mesh)
            vertex_edges.append(of_vertices)
            position_edges.append(of_positions)
        return Tessellation(mesh, tuple(vertex_edges), tuple(position_edges), base)

    def positions(self, base: np.ndarray, height: np.ndarray) -> np.ndarray:
        """
        Displaced positions, shape (P, 3).

        Parameters
        ----------
        base : ndarray, shape (B, 3)
            Positions of the base mesh.
        height : ndarray, shape (H, W)
            Displacement along the unit interpolated normal [units of the positions], texel centres at (k + .5)/N.
        """
        points, normals = np.asarray(base, np.float64), replace(self.base, positions=np.asarray(base)).normals()
        for edges in self.position_edges:
            points = midpoints(points, edges)
        return points + self.interpolated(normals, 0) * self._heights(height)[:, None]

    def interpolated(self, normals: np.ndarray, level: int) -> np.ndarray:
        """
        Unit normals of the positions of so many subdivisions, interpolated to all, shape (P, 3).
        """
        for edges in self.position_edges[level:]:
            normals = midpoints(normals, edges)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    def _heights(self, height: np.ndarray) -> np.ndarray:
        """At the positions: the mean over their vertices, which along a seam read two places of the map."""
        index, weight = bilinear(self.mesh.uvs, height.shape)
        values = np.sum(height.ravel()[index] * weight, axis=1)
        where, n = self.mesh.position_index, len(self.mesh.positions)
        return np.bincount(where, values, n) / np.maximum(np.bincount(where, minlength=n), 1)


def midpoints(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """
    With the means of the two ends of every edge appended.
    """
    return np.concatenate([values, 0.5 * (values[edges[:, 0]] + values[edges[:, 1]])])


def bilinear(uvs: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """
    Texels around texture coordinates, row by row in an image of this (H, W), and their weights, shape (N, 4) each.
    """
    height, width = shape
    x, y = uvs[:, 0] * width - 0.5, uvs[:, 1] * height - 0.5
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = x - x0, y - y0
    columns, rows = [x0 % width, (x0 + 1) % width], [y0 % height, (y0 + 1) % height]
    index = np.stack([r * width + c for r in rows for c in columns], axis=1)
    return index, np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)


def _split(mesh: Mesh) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """Every face in four; the edges whose midpoints are appended, over vertices and over positions."""
    of_vertices, middle = _edges(mesh.faces)
    of_positions, _ = _edges(mesh.position_faces)
    n_positions = len(mesh.positions)
    # Which edge over positions an edge over vertices lies on.
    key = np.sort(mesh.position_index[of_vertices], axis=1)
    rows = np.sort(of_positions, axis=1)
    order = np.lexsort(rows.T[::-1])
    code = lambda pairs: pairs[:, 0] * np.int64(n_positions) + pairs[:, 1]  # noqa: E731
    place = order[np.searchsorted(code(rows[order]), code(key))]
    a, b, c = mesh.faces.T
    ab, bc, ca = (middle + len(mesh.uvs)).T
    faces = np.concatenate([np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return (
        Mesh(
            midpoints(mesh.positions, of_positions),
            np.concatenate([mesh.position_index, n_positions + place]),
            midpoints(mesh.uvs, of_vertices).astype(np.float32),
            faces,
        ),
        of_vertices,
        of_positions,
    )


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct edges (E, 2), and which the three of each face are, (F, 3): from its first, second, third corner on."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, index = np.unique(ends, axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)
