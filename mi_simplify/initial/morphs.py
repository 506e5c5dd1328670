"""
Morph targets of an asset on a low-poly mesh.
"""

from __future__ import annotations

import numpy as np

from ..model.asset import Asset
from ..model.mesh import Mesh
from ..model.model import Morphs
from ..model.topology import vertex_normals
from .closest import ClosestPoints
from .soup import merge


def carried_morphs(asset: Asset, mesh: Mesh) -> Morphs | None:
    """
    How the closest points of the asset's surface move with each of its targets; None where it has none.

    Targets of one name in several parts are one.
    """
    parts = [part for part in asset.placed() if len(part.faces)]
    names = list(dict.fromkeys(morph.name for part in parts for morph in part.morphs))
    if not names:
        return None
    soup = merge(asset)
    normals = vertex_normals(mesh.positions, mesh.position_faces)
    found = ClosestPoints(soup.vertices, soup.faces).query(mesh.positions, normals)
    corners = soup.faces[found.face]
    weights, offsets = [], []
    for name in names:
        rows = [next((m.offsets for m in p.morphs if m.name == name), np.zeros((len(p.vertices), 3))) for p in parts]
        weights.append(next(m.weight for p in parts for m in p.morphs if m.name == name))
        offsets.append(np.einsum("nc,nci->ni", found.barycentric, np.concatenate(rows)[corners]))
    return Morphs(tuple(names), tuple(weights), np.array(offsets))
