"""
Borders of the shadows that point, spot and directional lights cast: edges seen from the light, projected on what is
behind them.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from ..edges import OPEN
from .crossings import Crossings, Eyes, drawn
from .film_edges import FilmEdges
from .projections import Projections

#: How far beside an edge shadow rays pass [fraction of the coordinates]: float32 resolves some ten times less.
_ASIDE = 1e-5

#: Least cosine between a surface and what is shifted along it: where light grazes nothing jumps by much.
_GRAZING = 0.02


def sharp_lights(scene: mi.Scene) -> Eyes | None:
    """
    Where the lights that cast sharp shadows are, attached where they move; None where there is none.
    """
    rows: list = []
    for emitter in scene.emitters():
        params = mi.traverse(emitter)
        if "position" in params:
            rows += [*mi.Point3f(params["position"]), 1.0]
        elif mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaPosition):
            m = params["to_world"].matrix
            rows += [m[0, 3], m[1, 3], m[2, 3], 1.0]
        elif mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaDirection) and not emitter.is_environment():
            m = params["to_world"].matrix
            rows += [-m[0, 2], -m[1, 2], -m[2, 2], 0.0]
    if not rows:
        return None
    return Eyes(dr.ravel(mi.ArrayXf([mi.Float(x) for x in rows])), len(rows) // 4)


def soft_lights(scene: mi.Scene) -> list[str]:
    """
    Names of the lights whose shadows have no sharp border.
    """
    return [
        e.id() or e.class_name()
        for e in scene.emitters()
        if not (+e.flags() & (+mi.EmitterFlags.DeltaPosition | +mi.EmitterFlags.DeltaDirection)) or e.is_environment()
    ]


def sample_borders(
    edges: FilmEdges,
    positions: mi.Float,
    lights: Eyes,
    projections: Projections,
    scene: mi.Scene,
    plane: Callable[[mi.SurfaceInteraction3f], tuple[mi.Point3f, mi.Vector3f, list[mi.UInt32]]],
    n_samples: int,
    seed: mi.UInt32,
) -> Crossings:
    """
    Points on the borders of shadows in all views.

    An edge point q throws its shadow along the ray from the light through it, to where that meets the next surface:
    r = l + t (q - l) with t such that r is in the plane of the face there. r follows the light, the edge and the
    plane.

    Parameters
    ----------
    positions : mi.Float, width P·3
        Welded positions, attached where they move.
    plane : callable
        A point and the normal of the plane that is hit, attached where that moves, and two corners of the face.
    """
    flat, still = dr.detach(positions), dr.detach(lights)
    with dr.suspend_grad():
        planes = edges.planes(flat)
        dr.eval(planes)
        pair = dr.arange(mi.UInt32, edges.n_edges * lights.n)
        light = pair // edges.n_edges
        row = dr.gather(mi.Vector4u, edges.rows, pair - light * edges.n_edges)
        ends = [dr.gather(mi.Point3f, flat, i) for i in (row.x, row.y)]
        eye = still.fetch(light)
        kind = dr.gather(mi.UInt32, edges.kind, pair - light * edges.n_edges)
        to_light = Eyes.towards(eye, dr.lerp(ends[0], ends[1], 0.5))
        # The angle under which the light sees the edge, or its width across parallel light.
        weight = dr.norm(dr.cross(mi.Vector3f(ends[1] - ends[0]), dr.normalize(to_light)))
        weight *= dr.select(eye.w > 0, dr.rcp(dr.maximum(dr.norm(to_light), 1e-12)), 1)
        weight = dr.select(edges.turns(planes, row, eye) | (kind == OPEN), weight, 0)
        dr.eval(weight)
        pair, s, v, scale = drawn(weight, n_samples, seed)
        light = pair // edges.n_edges
        row = dr.gather(mi.Vector4u, edges.rows, pair - light * edges.n_edges)
        weight = dr.gather(mi.Float, weight, pair)
        ends = [dr.gather(mi.Point3f, flat, i) for i in (row.x, row.y)]
        q, eye = dr.lerp(*ends, s), still.fetch(light)
        onward = -dr.normalize(Eyes.towards(eye, q))
        epsilon = mi.math.RayEpsilon * (1 + dr.max(dr.abs(q)))
        ray = mi.Ray3f(mi.Point3f(dr.fma(onward, epsilon, mi.Vector3f(q))), mi.Vector3f(onward))
        si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.Minimal, coherent=False, active=weight > 0)
        hit = si.is_valid()
        a, n, receiver = plane(si)
        a, n = dr.detach(a), dr.select(hit, dr.detach(n), mi.Vector3f(0, 0, 1))
        # Mitsuba lifts the origins of shadow rays off the surface by this much, along its normal.
        lift = mi.math.RayEpsilon * (1 + dr.max(dr.abs(dr.detach(si.p))))
        r, slide = _shadow_point(q, eye, a, n, lift)
        edge = mi.Vector3f(ends[1] - ends[0])
        # How r runs along the border: the edge's own direction, slid along the light into the plane.
        along = slide(edge)
        view = mi.UInt32(dr.minimum(v * projections.n_views, projections.n_views - 1))
        shift = projections.shift(view, r, along)
        length = dr.norm(shift)
        film = projections.project(view, r)
        h = projections.homogeneous(view, r)
        valid = hit & (length > 1e-9) & (weight > 0) & (h.w > 1e-3) & projections.in_window(view, film.x, film.y)
        valid &= dr.isfinite(length)
        nx, ny = shift.y / dr.maximum(length, 1e-9), -shift.x / dr.maximum(length, 1e-9)
        count = length * scale / dr.maximum(weight, 1e-30) * (projections.n_views * projections.share)
        aside = _beside(q, r, eye, n, edge, along)
        across = projections.shift(view, r, aside)
        aside = dr.mulsign(aside, across.x * nx + across.y * ny)
    with dr.resume_grad():
        moving = [dr.gather(mi.Point3f, positions, i) for i in (row.x, row.y)]
        a, n, _ = plane(si)
        n = dr.select(hit, n, mi.Vector3f(0, 0, 1))
        moved, _ = _shadow_point(dr.lerp(*moving, s), lights.fetch(light), a, n, lift)
        moved_film = projections.project(view, moved)
        motion = dr.select(valid, moved_film.x * nx + moved_film.y * ny, 0)
    return Crossings(
        view=view,
        x=film.x,
        y=film.y,
        nx=nx,
        ny=ny,
        weight=dr.select(valid, count, 0),
        step=mi.Float(0),
        p=mi.Point3f(r),
        end0=receiver[0],
        end1=receiver[1],
        outline=mi.Bool(False),
        motion=motion,
        aside=aside,
    )


def _beside(
    q: mi.Point3f, r: mi.Point3f, eye: mi.Vector4f, n: mi.Vector3f, edge: mi.Vector3f, along: mi.Vector3f
) -> mi.Vector3f:
    """
    What to add to, or subtract from, the shadow r of an edge point q on the receiver's plane, so that a shadow ray
    passes just beside the edge.
    """
    to_light = dr.normalize(Eyes.towards(eye, q))
    across = dr.normalize(dr.cross(edge, to_light))
    sideways = dr.normalize(dr.cross(n, along))
    near, far = (dr.norm(Eyes.towards(eye, p)) for p in (q, r))
    scale = dr.select(eye.w > 0, far / dr.maximum(near, 1e-20), 1)
    width = _ASIDE * (1 + dr.maximum(dr.max(dr.abs(q)), dr.max(dr.abs(r)))) * scale
    return sideways * (width / dr.maximum(dr.abs(dr.dot(sideways, across)), _GRAZING))


def _shadow_point(q: mi.Point3f, eye: mi.Vector4f, a: mi.Point3f, n: mi.Vector3f, lift: mi.Float):
    """
    Where a point's shadow is rendered on the plane through a, and how it moves where the point does, in first order.

    Shadow rays start at ``lift`` above the plane. Where light grazes this moves borders by a multiple, and a shadow
    that is lower than it is not rendered at all.
    """
    d = -Eyes.towards(eye, q)  # along the light: q - l, or a constant
    n = dr.normalize(n)
    across = dr.dot(n, d)
    across = dr.select(dr.abs(across) > 1e-20, across, 1e-20)
    raised = -dr.mulsign(n, dr.detach(across)) * lift
    t = (dr.dot(n, mi.Vector3f(a - q)) + dr.dot(n, raised)) / across
    r = mi.Point3f(dr.fma(d, t, mi.Vector3f(q)) - raised)

    def slide(v: mi.Vector3f) -> mi.Vector3f:
        # r = q + t d with d = q - l: dr = (1 + t w) dq + d dt, and n·dr = 0.
        whole = v * dr.fma(t, eye.w, 1)
        return whole - d * (dr.dot(n, whole) / across)

    return r, slide
