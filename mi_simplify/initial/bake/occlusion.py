"""
Ambient occlusion of the asset: how much of the sky its surface sees, by rays.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.meshes import make_mesh
from ..soup import Soup
from .lookup import Detail, Points, SurfacePoints

#: Rays of every point that is baked, of which a texel has several.
N_RAYS = 32

#: Steps of the plastic number: points of this lattice are spread evenly over the square, however many are taken.
_STEPS = (0.7548776662466927, 0.5698402909980532)


class Sky:
    """
    What hides the sky from the asset's surface: all of it but what blends.

    Parameters
    ----------
    soup : Soup
    detail : Detail
        Of the same triangles.
    """

    def __init__(self, soup: Soup, detail: Detail):
        blends = np.array([material.alpha_mode == "BLEND" for material in soup.materials])
        solid = soup.faces[~blends[soup.material_index]]
        self._detail = detail
        self._scene = mi.load_dict({"type": "scene", "mesh": make_mesh("mesh", soup.vertices, solid)} if len(solid) else
                                   {"type": "scene"})  # fmt: skip

    def seen(self, s: Points, hits: SurfacePoints, seed: int) -> mi.Float:
        """
        The share of light from everywhere that arrives at the hits, ∫ V(ω) cos θ dω / π, in [0, 1].

        By cosine-weighted directions around the asset's geometric normal, on the side of the point that looks; not
        differentiable. Every face of the hits must exist.

        Parameters
        ----------
        seed : int
            Of the turn of each point's directions.
        """
        detail = self._detail
        n = dr.normalize(detail.face_normal(hits.face, True))
        n = dr.select(dr.dot(n, s.n) < 0, -n, n)
        start = detail.position(hits) + n * (20 * detail.step)
        a, b = mi.sample_tea_32(dr.arange(mi.UInt32, dr.width(hits.face)), dr.opaque(mi.UInt32, seed))
        return _open(self._scene, start, n, mi.Float(a) * 2.0**-32, mi.Float(b) * 2.0**-32, s.active)


@dr.syntax
def _open(scene: mi.Scene, start: mi.Point3f, n: mi.Vector3f, u: mi.Float, v: mi.Float, active: mi.Bool) -> mi.Float:
    """Share of the directions in which nothing is met."""
    frame, k, count = mi.Frame3f(n), mi.UInt32(0), mi.Float(0)
    u, v = mi.Float(u), mi.Float(v)
    while k < N_RAYS:
        direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u, v)))
        hidden = scene.ray_test(mi.Ray3f(start, direction), active)
        count += dr.select(hidden, 0.0, 1.0)
        u += _STEPS[0]
        v += _STEPS[1]
        u -= dr.floor(u)
        v -= dr.floor(v)
        k += 1
    return count * (1 / N_RAYS)
