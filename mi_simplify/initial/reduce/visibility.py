"""
How much of a surface can be seen from outside: triangles are to be spent where somebody looks.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.meshes import make_mesh
from ...machine.upload import upload
from ...model.topology import area_vectors

#: Rays in all, at most, and for each face.
_RAYS, _LEAST, _MOST = 2_000_000, 4, 64


def visibility(positions: np.ndarray, faces: np.ndarray, opaque: np.ndarray | None = None) -> np.ndarray:
    """
    Share of the directions from which the surface around a position is seen by an observer outside of everything.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
    opaque : ndarray of bool, shape (F,), optional
        Faces that hide what lies behind them; all of them if not given.

    Returns
    -------
    ndarray, shape (P,), float64
        1 on a convex body, less in hollows, 0 where a position is walled in.
    """
    n_faces = len(faces)
    n = int(np.clip(_RAYS // n_faces, _LEAST, _MOST))
    walls = faces if opaque is None else faces[opaque]
    if not len(walls):
        return np.ones(len(positions))
    scene = mi.load_dict({"type": "scene", "walls": make_mesh("walls", positions, walls)})
    lane = dr.arange(mi.UInt32, n_faces * n)
    face = lane // n
    corners = dr.gather(mi.Vector3u, upload(mi.UInt32, faces.ravel()), face)
    points = upload(mi.Float, positions.ravel())
    a, b, c = (dr.gather(mi.Point3f, points, i) for i in corners)
    x, y = (mi.Float(bits) * 2.0**-32 for bits in mi.sample_tea_32(lane, 0, 6))
    u, v = (mi.Float(bits) * 2.0**-32 for bits in mi.sample_tea_32(lane, 1, 6))
    at = mi.warp.square_to_uniform_triangle(mi.Point2f(x, y))
    direction = mi.warp.square_to_uniform_sphere(mi.Point2f(u, v))
    origin = a + (b - a) * at.x + (c - a) * at.y
    origin += direction * float(1e-5 * np.linalg.norm(np.ptp(positions[np.unique(faces)], axis=0)))
    free = dr.select(scene.ray_test(mi.Ray3f(origin, direction)), mi.Float(0), 1)
    # Of a closed body's face one half of all directions is free at most.
    seen = 2.0 * dr.block_sum(free, n).numpy().astype(np.float64) / n

    p = positions[faces]
    area = np.linalg.norm(area_vectors(p), axis=1)
    total, weight = (np.bincount(faces.ravel(), np.repeat(w, 3), len(positions)) for w in (seen * area, area))
    return np.clip(np.divide(total, weight, out=np.zeros(len(positions)), where=weight > 0), 0, 1)
