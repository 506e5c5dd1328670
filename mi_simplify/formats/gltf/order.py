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
    return ordered_groups(mesh, np.zeros(len(mesh.faces), np.int64))[0]


def ordered_groups(mesh: Mesh, of_face: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """
    As :func:`ordered`, the triangles of each group together; the mesh and the groups of its faces, rising.
    """
    runs = []
    for k in range(int(of_face.max()) + 1):
        corners = np.asarray(mesh.faces[of_face == k], np.uint32).ravel()
        indices, remap, n_used = meshopt.reorder_mesh(corners, triangles=True, optsize=False)
        runs.append(np.argsort(remap, kind="stable")[:n_used][indices])  # what is unused has the largest number
    flat = np.concatenate(runs)
    _, first, inverse = np.unique(flat, return_index=True, return_inverse=True)
    kept = flat[np.sort(first)]
    new = np.empty(len(first), np.int64)
    new[np.argsort(first)] = np.arange(len(first))
    mesh = replace(
        mesh,
        position_index=mesh.position_index[kept],
        normal_index=None if mesh.normal_index is None else mesh.normal_index[kept],
        uvs=mesh.uvs[kept],
        faces=new[inverse].reshape(-1, 3).astype(mesh.faces.dtype),
    )
    return mesh, np.sort(of_face)
