"""
A welded triangle mesh whose texture coordinates and normals may split, in plain NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .topology import fitted_normals


@dataclass(frozen=True)
class Mesh:
    """
    Welded triangle mesh whose UV seams split texture coordinates, never positions.

    Parameters
    ----------
    positions : ndarray, shape (P, 3), float64
        Welded positions; what is optimised.
    position_index : ndarray, shape (V,), int64
        Position of each vertex; several vertices share one along a UV seam.
    uvs : ndarray, shape (V, 2), float32
        Texture coordinates in [0, 1], origin top left, without overlap.
    faces : ndarray, shape (F, 3), int64
        Counter-clockwise *vertex* indices; ``position_index[faces]`` is the welded topology.
    normal_index : ndarray, shape (V,), int64, optional
        Vertices with the same number share a normal; a crease runs where those of one position differ. Without it all
        of one position share one.
    own_normals : ndarray, shape (G, 3), float64, optional
        Unit normals, one a normal group, where they are not those of the faces.
    cell_index : ndarray, shape (F,), int64, optional
        Row of :attr:`.model.Model.cells` that each face reads its textures from, with coordinates that repeat within.
    """

    positions: np.ndarray
    position_index: np.ndarray
    uvs: np.ndarray
    faces: np.ndarray
    normal_index: np.ndarray | None = None
    own_normals: np.ndarray | None = None
    cell_index: np.ndarray | None = None

    @property
    def normal_groups(self) -> np.ndarray:
        """Which normal each vertex has, shape (V,): a row of :meth:`normals`."""
        return self.position_index if self.normal_index is None else self.normal_index

    def normals(self) -> np.ndarray:
        """
        Its own normals, or those fitted to the faces, see :func:`.topology.fitted_normals`: one a normal group, shape
        (G, 3), float64.
        """
        if self.own_normals is not None:
            return self.own_normals
        return fitted_normals(self.positions, self.position_faces, self.normal_groups[self.faces])

    @property
    def vertices(self) -> np.ndarray:
        """Positions per vertex, shape (V, 3)."""
        return self.positions[self.position_index]

    @property
    def position_faces(self) -> np.ndarray:
        """Faces over welded positions, shape (F, 3)."""
        return self.position_index[self.faces]
