"""
First skinning weights of a reduced mesh: carried over from the asset, or by distance to the bones.
"""

from __future__ import annotations

import numpy as np

from ...model.asset import Asset
from ...model.mesh import Mesh
from ...model.rig import Rig, bone_distances
from ...model.topology import vertex_normals
from ..closest import ClosestPoints

#: Distance over which the pull of a bone falls to 1/e, as a share of the skeleton's longest side.
_REACH = 0.03


def carried_weights(asset: Asset, mesh: Mesh) -> np.ndarray:
    """
    Weights of the closest point of the asset in its bind pose that faces the same way.

    Parameters
    ----------
    asset : Asset
        With a rig.
    mesh : Mesh
        In the frame and the bind pose of the asset.

    Returns
    -------
    ndarray, shape (P, J), float32
        Of sum 1.
    """
    parts = [p for p in asset.placed() if len(p.vertices)]
    starts = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    faces = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)])
    surface = ClosestPoints(np.concatenate([p.vertices for p in parts]), faces)
    normals = vertex_normals(mesh.positions, mesh.position_faces)
    hit = surface.query(mesh.positions, normals)
    corners = asset.influences()[faces[hit.face]]  # (P, 3, J)
    weights = np.einsum("pc,pcj->pj", hit.barycentric, corners)
    return (weights / weights.sum(1, keepdims=True)).astype(np.float32)


def bone_weights(rig: Rig, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Weights by the distance to the bones in the bind pose, knowing nothing of a surface.

    The pull falls exponentially with the distance beyond that of the closest bone.

    Parameters
    ----------
    rig : Rig
    positions : ndarray, shape (P, 3)

    Returns
    -------
    weights : ndarray, shape (P, J), float32
        Of sum 1.
    reach : float
        Distance over which the pull falls to 1/e.
    """
    distance = bone_distances(rig, positions)
    reach = _REACH * max(float(np.ptp(rig.bind[:, :3, 3], axis=0).max()), 1e-12)
    weights = np.exp(-(distance - distance.min(1, keepdims=True)) / reach)
    return (weights / weights.sum(1, keepdims=True)).astype(np.float32), reach
