"""
Morph targets of an asset on a low-poly mesh.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import splu

from ..model.asset import Asset
from ..model.mesh import Mesh
from ..model.model import Morphs
from ..model.topology import vertex_normals
from .closest import Closest, ClosestPoints, sample_surface
from .soup import merge

#: Points of the asset's surface that a position's offsets are fitted to, on average.
_PER_POSITION = 40

#: How much the closest point counts beside them, as a share of what they count for a position.
_CLOSEST = 0.02


def carried_morphs(asset: Asset, mesh: Mesh) -> Morphs | None:
    """
    How a low-poly mesh moves with each of an asset's targets; None where it has none.

    Least squares: offsets d of the positions whose interpolation over the faces, B d, is closest to those of points all
    over the asset's surface, min |B d - e|² + ε |d - d'|², with d' the offsets of the closest points. Those alone would
    cut every bulge at its corners. Targets of one name in several parts are one.
    """
    parts = [part for part in asset.placed() if len(part.faces)]
    names = list(dict.fromkeys(morph.name for part in parts for morph in part.morphs))
    if not names:
        return None
    soup = merge(asset)
    surface = ClosestPoints(soup.vertices, soup.faces)
    own = surface.query(mesh.positions, vertex_normals(mesh.positions, mesh.position_faces))
    points, face = sample_surface(surface.corners, surface.double_area, _PER_POSITION * len(mesh.positions), seed=1)
    points, face = points[len(surface.corners) :], face[len(surface.corners) :]  # without the centres: evenly by area
    there = surface.query(points, surface.normals[face])
    low = ClosestPoints(mesh.positions, mesh.position_faces)
    here = low.query(points, surface.normals[face])
    solve = _fitted(here, mesh.position_faces, len(mesh.positions))
    weights, offsets = [], []
    for name in names:
        rows = [next((m.offsets for m in p.morphs if m.name == name), np.zeros((len(p.vertices), 3))) for p in parts]
        weights.append(next(m.weight for p in parts for m in p.morphs if m.name == name))
        of_vertex = np.concatenate(rows)
        closest, wanted = (
            np.einsum("nc,nci->ni", found.barycentric, of_vertex[soup.faces[found.face]]) for found in (own, there)
        )
        offsets.append(solve(closest, wanted))
    return Morphs(tuple(names), tuple(weights), np.array(offsets))


def _fitted(here: Closest, faces: np.ndarray, n: int):
    """``solve(closest, wanted)``: offsets (n, 3) of positions from those of their closest points and of all points."""
    rows = np.repeat(np.arange(len(here.face)), 3)
    b = csc_array((here.barycentric.ravel(), (rows, faces[here.face].ravel())), shape=(len(here.face), n))
    product = csc_array(b.T @ b)
    epsilon = _CLOSEST * product.trace() / n
    factor = splu(csc_array(product + epsilon * eye_array(n)))

    def solve(closest: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        return factor.solve(b.T @ wanted + epsilon * closest)

    return solve
