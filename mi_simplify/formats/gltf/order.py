"""
The order of triangles and vertices that a GPU draws fastest: triangles for its vertex cache, vertices as they are used.
"""

from __future__ import annotations

from dataclasses import replace

import meshopt
import numpy as np

from ...model.mesh import Mesh


def ordered(mesh: Mesh) -> Mesh:
    """
    The same mesh with its triangles in the order of a GPU's vertex cache and its vertices in that of their first use.

    Vertices that no triangle uses are left out; positions and normals keep their places. By meshoptimizer (Kapoulkine
    2016, after Sander et al. 2007).
    """
    corners = np.asarray(mesh.faces, np.uint32).ravel()
    indices, remap, n_used = meshopt.reorder_mesh(corners, triangles=True, optsize=False)
    kept = np.argsort(remap, kind="stable")[:n_used]  # what is unused has the largest number
    return replace(
        mesh,
        position_index=mesh.position_index[kept],
        normal_index=None if mesh.normal_index is None else mesh.normal_index[kept],
        uvs=mesh.uvs[kept],
        faces=indices.reshape(-1, 3).astype(mesh.faces.dtype),
    )
