"""
What is blended over a surface: decals, lenses and lacquer belong to what they lie on.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ...machine.meshes import MISS
from ..groups import NEAR
from .lookup import N_VALUES, Detail, Points, SurfacePoints

#: Blended layers above a surface that count, and layers below a blended one.
LAYERS = 3


def seen(detail: Detail, s: Points, hits: SurfacePoints) -> list[mi.Float]:
    """
    As :meth:`.lookup.Detail.shade`, but where materials blend (glTF's BLEND) of all the layers that lie together.

    From above: blended layers on the hit, the hit itself, and, if it blends, what is below; all that face alike. A
    low-poly surface has one layer there: with the decal alone it would be a hole around the letters, without it blank.
    Colours are composed front to back, roughness, metalness and normals are means by what each layer shows.
    """
    own = detail.shade(s, hits)
    if not dr.any(detail.blended):
        return own
    sums, left = [mi.Float(0)] * N_VALUES, mi.Float(1)
    near = detail.diagonal * NEAR
    p, gap = detail.position(hits), 10 * detail.step
    t = mi.Float(0)
    for _ in range(LAYERS):
        layer, t = _next(detail, s, p + s.ray * near, t, near - gap, True)
        if not _any(layer):
            break
        sums, left = _behind(sums, left, _visible(detail, s, layer))
    sums, left = _behind(sums, left, own)
    below, t = detail.blends(hits), mi.Float(gap)
    for _ in range(LAYERS):
        layer, t = _next(detail, s, p, t, dr.select(below, near, 0), False)
        if not _any(layer):
            break
        sums, left = _behind(sums, left, _visible(detail, s, layer))
    opacity = sums[6]
    means = [
        dr.select(opacity > 1e-3, x / dr.maximum(opacity, 1e-3), y) for x, y in zip(sums[7:], own[7:], strict=True)
    ]
    return [*sums[:3], *own[3:6], opacity, *means[:6], own[13], *means[7:]]


def _any(layer: SurfacePoints) -> bool:
    """Whether a layer is there at all: most assets have one or two, and what a layer shows costs more than its rays."""
    dr.eval(layer)
    return bool(dr.any(layer.face != MISS))


def _visible(detail: Detail, s: Points, hits: SurfacePoints) -> list[mi.Float]:
    """What a layer shows, nothing where there is none."""
    found = hits.face != MISS
    hits.face = dr.select(found, hits.face, 0)
    return [dr.select(found, x, 0) for x in detail.shade(s, hits)]


def _behind(sums: list[mi.Float], left: mi.Float, layer: list[mi.Float]) -> tuple[list[mi.Float], mi.Float]:
    """A layer behind those that are summed, through which a share ``left`` can be seen."""
    share = left * layer[6]
    weights = [left] * 3 + [mi.Float(0)] * 3 + [left] + [share] * (N_VALUES - 7)
    sums = [x + w * y for x, w, y in zip(sums, weights, layer, strict=True)]
    left = left - share
    dr.eval(sums, left)
    return sums, left


@dr.syntax
def _next(detail: Detail, s: Points, start: mi.Point3f, t: mi.Float, end: mi.Float, blended_only: bool):
    """The next layer from ``start`` inwards between ``t`` and ``end``, and how far it is."""
    face, b = mi.UInt32(MISS), mi.Point2f(0)
    t, n = mi.Float(t), mi.Vector3f(s.ray)
    active = s.active & (t < end)
    while active:
        ray = mi.Ray3f(start - n * t, -n)
        ray.maxt = end - t
        pi = detail.scene.ray_intersect_preliminary(ray, False, active)
        active &= pi.is_valid()
        t = dr.select(active, t + pi.t + detail.step, end)
        alike = active & (dr.dot(detail.face_normal(pi.prim_index, active), n) > 0)
        if dr.hint(blended_only, mode="scalar"):
            alike &= detail.blends(SurfacePoints(dr.select(active, pi.prim_index, 0), pi.prim_uv))
        face = dr.select(alike, pi.prim_index, face)
        b = dr.select(alike, pi.prim_uv, b)
        active &= ~alike & (t < end)
    return SurfacePoints(face, b), t
