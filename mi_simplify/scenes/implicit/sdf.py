"""
Signed distance functions in Dr.Jit: primitives, ways to join them, and ways to warp the space that they are in.

Everything takes points, an ``mi.Point3f``, and numbers; distances are negative inside. What is marked *exact* is the
Euclidean distance outside, what is marked *bound* never exceeds it: both can be sphere traced. Functions that warp
space return points, to be handed to the next function. After the functions of Inigo Quilez's articles on distance
functions (the mathematics; the code is ours).

A function of one's own is any combination of these::

    from mi_simplify.scenes.implicit import sdf

    def mushroom(p):
        stem = sdf.cone(p, (0, -1, 0), (0, 0.2, 0), 0.3, 0.2)
        cap = sdf.intersect(sdf.sphere(p, 0.8), sdf.half_space(p, (0, -1, 0), 0.0))
        return sdf.smooth_union(stem, cap, 0.1)
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

Vector = Sequence[float] | np.ndarray


def _v(v: Vector) -> mi.Vector3f:
    return mi.Vector3f(*(float(x) for x in v))


def _norm(v):
    """Length, whose derivative at zero is zero and not NaN."""
    return dr.sqrt(dr.maximum(dr.squared_norm(v), 1e-20))


# --- primitives ---------------------------------------------------------------------------------------------------


def sphere(p, radius: float, center: Vector = (0, 0, 0)):
    """
    A ball; exact.
    """
    return _norm(p - _v(center)) - radius


def ellipsoid(p, radii: Vector, center: Vector = (0, 0, 0)):
    """
    An ellipsoid with axes along x, y, z; close to exact near the surface, a bound elsewhere.
    """
    q = p - _v(center)
    a, b = _norm(q / _v(radii)), _norm(q / _v(np.square(radii)))
    return a * (a - 1) / dr.maximum(b, 1e-9)


def box(p, half: Vector, center: Vector = (0, 0, 0), rounding: float = 0.0):
    """
    A box of half sides ``half``, its edges rounded inwards; exact.
    """
    q = dr.abs(p - _v(center)) - _v(np.subtract(half, rounding))
    outside = _norm(dr.maximum(q, 0))
    return outside + dr.minimum(dr.max(q), 0) - rounding


def cylinder(p, radius: float, half: float, center: Vector = (0, 0, 0)):
    """
    An upright cylinder, along y; exact.
    """
    q = p - _v(center)
    side, top = _norm(mi.Vector2f(q.x, q.z)) - radius, dr.abs(q.y) - half
    return dr.minimum(dr.maximum(side, top), 0) + _norm(mi.Vector2f(dr.maximum(side, 0), dr.maximum(top, 0)))


def torus(p, major: float, minor: float, center: Vector = (0, 0, 0)):
    """
    A torus around y; exact.
    """
    q = p - _v(center)
    return _norm(mi.Vector2f(_norm(mi.Vector2f(q.x, q.z)) - major, q.y)) - minor


def half_space(p, normal: Vector, offset: float):
    """
    Everything below the plane ``normal · p = offset``; exact.
    """
    n = np.asarray(normal, np.float64) / np.linalg.norm(normal)
    return dr.dot(p, _v(n)) - offset


def cone(p, a: Vector, b: Vector, radius_a: float, radius_b: float):
    """
    Two balls and the cone that touches both, a capsule where their radii are equal; exact.
    """
    start, way = np.asarray(a, np.float64), np.subtract(b, a)
    length = float(np.linalg.norm(way))
    axis, sine = way / length, (radius_a - radius_b) / length
    cosine = float(np.sqrt(max(1 - sine**2, 0.0)))
    q = p - _v(start)
    along = dr.dot(q, _v(axis))
    across = dr.sqrt(dr.maximum(dr.squared_norm(q) - dr.square(along), 1e-20))
    # The nearest ball has its centre where the normal of the cone through p meets the axis.
    t = dr.clip(along - across * (sine / max(cosine, 1e-6)), 0, length)
    return _norm(mi.Vector2f(across, along - t)) - dr.lerp(mi.Float(radius_a), radius_b, t / length)


def tube(p, points: Sequence[Vector] | np.ndarray, radii: Sequence[float], k: float = 0.0):
    """
    Cones along a polyline, joined softly by ``k``; exact where that is 0.
    """
    parts = zip(points[:-1], points[1:], radii[:-1], radii[1:], strict=True)
    return smooth_union(*(cone(p, *part) for part in parts), k)


# --- joining ------------------------------------------------------------------------------------------------------


def union(*distances):
    """
    What is in any of them; a bound.
    """
    out = distances[0]
    for d in distances[1:]:
        out = dr.minimum(out, d)
    return out


def intersect(*distances):
    """
    What is in all of them; a bound.
    """
    return -union(*(-d for d in distances))


def subtract(a, b):
    """
    What is in ``a`` and not in ``b``; a bound.
    """
    return dr.maximum(a, -b)


def smooth_union(*distances_and_k):
    """
    ``smooth_union(d, e, ..., k)``: as :func:`union`, with a fillet where surfaces are closer than ``k``; a bound.
    """
    *distances, k = distances_and_k
    out = distances[0]
    for d in distances[1:]:
        h = dr.maximum(k - dr.abs(out - d), 0)
        out = dr.minimum(out, d) - (h * h * (0.25 / k) if k > 0 else 0)
    return out


def smooth_intersect(*distances_and_k):
    """
    As :func:`intersect`, its edges rounded off within ``k``.
    """
    *distances, k = distances_and_k
    return -smooth_union(*(-d for d in distances), k)


def smooth_subtract(a, b, k: float):
    """
    As :func:`subtract`, its edges rounded off within ``k``.
    """
    return -smooth_union(-a, b, k)


def shell(d, thickness: float):
    """
    A shell of this thickness around the surface; exact where ``d`` is.
    """
    return dr.abs(d) - thickness / 2


def rounded(d, radius: float):
    """
    Grown by ``radius``, which rounds convex edges; exact where ``d`` is.
    """
    return d - radius


def displaced(d, height):
    """
    The surface moved outwards by ``height``, a function of the point; steep ones make it no bound, see
    :class:`.surface.Implicit` for how that is found and met.
    """
    return d - height


# --- warping ------------------------------------------------------------------------------------------------------


def moved(p, offset: Vector):
    """
    Points in which a shape at the origin stands at ``offset``.
    """
    return p - _v(offset)


def turned(p, axis: Vector, angle: float):
    """
    Points in which a shape is turned by ``angle`` [degrees] around an axis through the origin.
    """
    return mi.Transform4f(mi.ScalarTransform4f().rotate(_v_scalar(axis), -angle).matrix) @ mi.Point3f(p)


def _v_scalar(v: Vector) -> list[float]:
    return [float(x) for x in v]


def mirrored(p, axis: int = 0):
    """
    Points in which a shape on the positive side of an axis stands on both sides of it.
    """
    out = mi.Point3f(p)
    out[axis] = dr.abs(out[axis])
    return out


def repeated(p, period: Vector, count: Vector | None = None):
    """
    Points in which a shape around the origin stands in every cell of a lattice.

    Parameters
    ----------
    period : (3,)
        Sides of a cell; 0 does not repeat along that axis. A shape has to stay inside its cell, or bounds are wrong.
    count : (3,), optional
        How many cells there are to either side of the middle one; without it they go on for ever.
    """
    out = mi.Point3f(p)
    for axis, side in enumerate(period):
        if side > 0:
            cell = dr.round(out[axis] * (1 / side))
            if count is not None:
                cell = dr.clip(cell, -float(count[axis]), float(count[axis]))
            out[axis] -= side * cell
    return out


def repeated_around(p, n: int):
    """
    Points in which a shape on the positive x axis stands ``n`` times around y.
    """
    sector = 2 * np.pi / n
    angle = dr.atan2(p.z, p.x)
    sine, cosine = dr.sincos(angle - sector * dr.round(angle * (1 / sector)))
    radius = _norm(mi.Vector2f(p.x, p.z))
    return mi.Point3f(radius * cosine, p.y, radius * sine)


def twisted(p, rate: float):
    """
    Points in which a shape is twisted around y by ``rate`` [degrees per unit of length]; no bound far from the axis.
    """
    sine, cosine = dr.sincos(p.y * float(np.radians(rate)))
    return mi.Point3f(cosine * p.x - sine * p.z, p.y, sine * p.x + cosine * p.z)


def bent(p, rate: float):
    """
    Points in which a shape along x is bent up, by ``rate`` [degrees per unit of length]; no bound far from the axis.
    """
    sine, cosine = dr.sincos(p.x * float(np.radians(rate)))
    return mi.Point3f(cosine * p.x - sine * p.y, sine * p.x + cosine * p.y, p.z)


def waves(p, frequency: float, phase: Vector = (0, 0, 0)):
    """
    A smooth pattern in [-1, 1], the product of three sines, for :func:`displaced` and for colours.
    """
    q = p * frequency + _v(phase)
    return dr.sin(q.x) * dr.sin(q.y) * dr.sin(q.z)
