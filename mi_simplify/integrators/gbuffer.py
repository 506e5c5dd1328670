"""
From rays to surface attributes: hits are found once and detached, attributes are looked up again with gradients.

This is the paper's deferred shading (Sect. 5.2) on a ray tracer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..latent.surface import Surface
from ..machine.frozen import frozen
from ..machine.meshes import MISS
from .camera import FilmRays, PixelRays

if TYPE_CHECKING:
    from .edge_rays import EdgeRays


@dataclass
class Hits:
    """
    What some rays met, found once and detached.

    Parameters
    ----------
    slot : mi.UInt32, width N
        Which of the places for hits, ascending; every ray that was traced has ``layers`` of them.
    face : mi.UInt32
        Triangle of *every* slot.
    lit : mi.Bool, width N, optional
        Whether the light reaches the hit; without shadows None.
    layers : int
        Hits of a ray at most, front to back.
    first, count : mi.UInt32, width M, optional
        Of the rays that hit anything: where their hits begin among the N, and how many they are; None with one layer.
    """

    slot: mi.UInt32
    face: mi.UInt32
    lit: mi.Bool | None
    layers: int = 1
    first: mi.UInt32 | None = None
    count: mi.UInt32 | None = None

    @property
    def ray(self) -> mi.UInt32:
        """Which of the rays that were traced, width N."""
        return self.slot if self.layers == 1 else self.slot // self.layers

    @property
    def front_ray(self) -> mi.UInt32:
        """The rays that hit anything, width M."""
        return dr.gather(mi.UInt32, self.slot, self.first) // self.layers


@dataclass
class Fragment:
    """
    Surface attributes where a ray meets a known triangle; all follow the surface along the *fixed* ray.

    ``normal`` and ``tangent`` are interpolated, ``normal`` is unit length, ``tangent`` neither unit nor orthogonal;
    ``handedness`` is ±1; ``density`` says how far the UV moves per unit length where the surface knows it, else it is
    1; ``cell`` is that of the textures; ``geometric_normal`` is detached; ``is_back`` says that the ray meets the
    triangle's back.
    """

    p: mi.Point3f
    normal: mi.Vector3f
    tangent: mi.Vector3f
    handedness: mi.Float
    density: mi.Float
    u: mi.Float
    v: mi.Float
    cell: mi.UInt32
    is_back: mi.Bool
    geometric_normal: mi.Vector3f
    active: mi.Bool


def trace(
    scene: mi.Scene, origin: mi.Point3f, direction: mi.Vector3f, active=True, tmin=None
) -> tuple[mi.UInt32, mi.Float]:
    """
    Nearest triangle of a scene of one mesh along each ray.

    Returns
    -------
    face : mi.UInt32
        Triangle index, :data:`MISS` where there is none.
    t : mi.Float
        Distance.
    """
    origin, direction = dr.detach(origin), dr.detach(direction)
    if tmin is not None:
        origin = dr.fma(direction, tmin, origin)
    ray = mi.Ray3f(origin, direction)
    pi = scene.ray_intersect_preliminary(ray, coherent=True, active=active)
    hit = pi.is_valid() & active
    return dr.select(hit, pi.prim_index, MISS), pi.t


def fragment(surface: Surface, face: mi.UInt32, origin: mi.Point3f, direction: mi.Vector3f) -> Fragment:
    """
    Attributes at the intersection of a ray with triangle ``face``.

    The intersection is computed again (Möller and Trumbore 1997), so that barycentric coordinates and everything
    interpolated with them carry the motion of the surface under a fixed ray; differentiable in surface and ray.
    """
    active = face != MISS
    index = dr.gather(mi.Vector4u, surface.faces, face, active)
    corners = [index.x, index.y, index.z]
    a = [dr.gather(mi.Vector4f, surface.packets, i * 3, active) for i in corners]
    b = [dr.gather(mi.Vector4f, surface.packets, i * 3 + 1, active) for i in corners]
    c = [dr.gather(mi.Vector4f, surface.packets, i * 3 + 2, active) for i in corners]

    e1, e2 = a[1].xyz - a[0].xyz, a[2].xyz - a[0].xyz
    h = dr.cross(direction, e2)
    det = dr.dot(e1, h)
    inv_det = dr.rcp(dr.select(dr.abs(det) > 1e-20, det, 1e-20))
    s = origin - a[0].xyz
    q = dr.cross(s, e1)
    b1 = dr.dot(s, h) * inv_det
    b2 = dr.dot(direction, q) * inv_det
    t = dr.dot(e2, q) * inv_det
    b0 = 1 - b1 - b2

    normal = mi.Vector3f(b[0].xyz * b0 + b[1].xyz * b1 + b[2].xyz * b2)
    return Fragment(
        p=mi.Point3f(origin + direction * t),
        normal=normal * dr.rsqrt(dr.maximum(dr.squared_norm(normal), 1e-12)),
        tangent=mi.Vector3f(c[0].xyz * b0 + c[1].xyz * b1 + c[2].xyz * b2),
        handedness=dr.sign(dr.detach(c[0].w)),
        density=dr.abs(c[0].w * b0 + c[1].w * b1 + c[2].w * b2),  # one sign in all corners
        u=a[0].w * b0 + a[1].w * b1 + a[2].w * b2,
        v=b[0].w * b0 + b[1].w * b1 + b[2].w * b2,
        cell=index.w,
        is_back=dr.detach(det) < 0,
        geometric_normal=dr.detach(dr.normalize(dr.cross(e1, e2))),
        active=active,
    )


def occluded(scene: mi.Scene, hit: Fragment, light: mi.Point3f) -> mi.Bool:
    """
    Whether something lies between a fragment and a point light; detached.
    """
    p = dr.detach(hit.p)
    to_light = dr.detach(light) - p
    distance = dr.norm(to_light)
    d = to_light / distance
    # Off the surface on the light's side, in proportion to the size of the numbers, as Mitsuba's spawn_ray does.
    n = dr.detach(hit.geometric_normal)
    offset = dr.mulsign(n, dr.dot(n, d)) * ((1 + dr.max(dr.abs(p))) * RAY_EPSILON)
    return scene.ray_test(mi.Ray3f(p + offset, d, distance * (1 - SHADOW_EPSILON), 0.0, []), active=hit.active)


def kept_hits(face: mi.UInt32, keep: mi.Bool) -> Hits | None:
    """
    Those of all rays that are kept, of the face that each met; reads back how many, None where there are none.
    """
    dr.eval(face, keep)
    ray = dr.compress(keep)
    return Hits(ray, face, None) if dr.width(ray) else None


@frozen()
def one_a_pixel(rays, face):
    """
    Of the samples of every pixel, FilmRays, one that hit, as PixelRays, and its face.
    """
    rays, chosen = PixelRays.through_visible(rays, face != MISS)
    return rays, dr.select(rays.coverage > 0, dr.gather(mi.UInt32, face, chosen), MISS)


def with_light(scene: mi.Scene, surface: Surface, rays: FilmRays | PixelRays | EdgeRays, hits: Hits) -> Hits:
    """
    The same hits, knowing whether the light of their view reaches them.
    """
    view, origin, direction = rays.at(hits.ray)
    hit = fragment(surface, dr.gather(mi.UInt32, hits.face, hits.slot), origin, direction)
    return replace(hits, lit=~occluded(scene, hit, mi.Point3f(rays.cameras.fetch(view, 4).xyz)))


RAY_EPSILON = 1e-4 * 0.9
SHADOW_EPSILON = 1e-3
