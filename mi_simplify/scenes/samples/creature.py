"""
The sample ``creature``: an elephant-like animal of this project's own, an implicit surface.

Wrinkled hide with a painted blanket, ivory tusks, thin ears, a curled trunk, and four legs that stand close together:
gaps that a fit has to open, thin and sharp parts that it has to find.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..implicit import sdf
from ..implicit.surface import Implicit, Surfel

_TRUNK = [
    (0.86, 0.34, 0.0), (1.03, 0.14, 0.0), (1.1, -0.12, 0.0), (1.1, -0.4, 0.0), (1.16, -0.62, 0.0), (1.31, -0.72, 0.0),
    (1.45, -0.64, 0.0), (1.46, -0.5, 0.0),
]  # fmt: skip
_TRUNK_RADII = [0.2, 0.165, 0.135, 0.11, 0.09, 0.078, 0.066, 0.055]


def _bezier(n: int, *p) -> np.ndarray:
    """Points on a cubic Bézier curve, shape (n, 3)."""
    t = np.linspace(0, 1, n)
    weights = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    return weights @ np.array(p)


_TUSK = _bezier(7, (0.84, 0.2, 0.15), (1.04, -0.2, 0.3), (1.42, -0.32, 0.32), (1.64, 0.06, 0.17))
_TUSK_RADII = [0.074, 0.072, 0.066, 0.056, 0.042, 0.026, 0.008]
_TAIL = [(-0.86, 0.28, 0.0), (-1.02, 0.08, 0.0), (-1.06, -0.2, 0.03), (-1.03, -0.42, 0.05)]

#: Where legs stand, on one side: hip, knee, foot.
_LEGS = [
    [(0.48, -0.1, 0.2), (0.5, -0.55, 0.19), (0.47, -0.93, 0.19)],
    [(-0.5, -0.1, 0.2), (-0.54, -0.52, 0.2), (-0.52, -0.93, 0.2)],
]
_LEG_RADII = [0.24, 0.165, 0.165]


def _hide(p, q):
    """Everything with skin; ``q`` is ``p`` on the positive side of z."""
    body = sdf.ellipsoid(p, (0.92, 0.56, 0.5), (-0.08, 0.12, 0.0))
    head = sdf.smooth_union(
        sdf.ellipsoid(p, (0.36, 0.38, 0.3), (0.78, 0.48, 0.0)), sdf.sphere(q, 0.2, (0.74, 0.74, 0.1)), 0.12
    )
    trunk = sdf.tube(p, _TRUNK, _TRUNK_RADII, 0.05)
    # Rings around the trunk, fading where it joins the head.
    along = dr.sqrt(dr.square(p.x - 0.86) + dr.square(p.y - 0.34) + 1e-6)
    trunk = sdf.displaced(trunk, 0.006 * dr.sin(42 * along) * dr.clip(2 * along - 0.3, 0, 1))
    legs = [sdf.tube(q, leg, _LEG_RADII, 0.08) for leg in _LEGS]
    feet = sdf.union(*(sdf.cylinder(q, 0.175, 0.05, (leg[-1][0], -1.0, leg[-1][2])) - 0.02 for leg in _LEGS))
    tail = sdf.tube(p, _TAIL, [0.05, 0.035, 0.028, 0.03], 0.03)
    out = sdf.smooth_union(body, head, 0.22)
    out = sdf.smooth_union(out, sdf.smooth_union(*legs, feet, 0.05), 0.16)
    out = sdf.smooth_union(out, trunk, 0.1)
    out = sdf.smooth_union(out, tail, 0.06)
    wrinkles = sdf.waves(sdf.twisted(p, 40.0), 17.0, (0.3, 1.1, 0.7)) + 0.6 * sdf.waves(p, 29.0, (1.7, 0.4, 2.2))
    return sdf.displaced(out, 0.009 * wrinkles)


def _ear(q):
    """One thin, wavy ear, standing off the head."""
    r = sdf.turned(sdf.moved(q, (0.62, 0.44, 0.44)), (0, 1, 0), 32.0)
    r = sdf.turned(r, (0, 0, 1), 12.0)
    fold = 0.05 * dr.sin(6 * r.y + 1.0) * dr.clip(r.z * 3, 0, 1)
    sheet = sdf.ellipsoid(mi.Point3f(r.x + fold, r.y, r.z), (0.055, 0.44, 0.38))
    return sdf.smooth_subtract(sheet, sdf.sphere(r, 0.3, (0.32, -0.02, 0.02)), 0.04)


def _nails(q):
    """Four nails on each foot, a repetition around its axis."""
    parts = []
    for *_, (x, _, z) in _LEGS:
        r = sdf.repeated_around(sdf.turned(sdf.moved(q, (x, -1.02, z)), (0, 1, 0), 45.0), 8)
        parts.append(sdf.ellipsoid(r, (0.04, 0.05, 0.045), (0.175, 0.0, 0.0)))
    return sdf.union(*parts)


def _blanket(p):
    """A cloth over the back, with studs repeated along its hem."""
    cloth = sdf.shell(sdf.ellipsoid(p, (0.955, 0.6, 0.535), (-0.08, 0.12, 0.0)), 0.025)
    cloth = sdf.smooth_intersect(cloth, sdf.box(p, (0.42, 0.5, 0.8), (-0.14, 0.5, 0.0)), 0.02)
    studs = sdf.repeated(sdf.moved(p, (-0.14, 0.04, 0.0)), (0.14, 0, 0), (2, 0, 0))
    studs = sdf.mirrored(studs, 2)
    return sdf.union(cloth, sdf.sphere(studs, 0.035, (0.0, 0.0, 0.535)))


def _parts(p) -> dict[str, mi.Float]:
    """Distances to the parts, by their material."""
    q = sdf.mirrored(p, 2)
    return {
        "hide": sdf.smooth_union(_hide(p, q), _ear(q), 0.03),
        "tusk": sdf.tube(q, _TUSK, _TUSK_RADII, 0.015),
        "nail": _nails(q),
        "eye": sdf.sphere(q, 0.045, (1.02, 0.56, 0.2)),
        "cloth": _blanket(p),
    }


def distance(p: mi.Point3f) -> mi.Float:
    """
    Signed distance of the creature; about 2.8 long and 2.2 high, it looks along x.
    """
    return sdf.union(*_parts(p).values())


def material(p: mi.Point3f) -> Surfel:
    """
    Its colours, linear: that of the nearest part.
    """
    spots = 0.5 + 0.25 * (sdf.waves(p, 9.0, (0.4, 1.9, 2.5)) + sdf.waves(p, 23.0, (2.0, 0.3, 1.2)))
    belly = dr.clip(0.6 - 0.9 * p.y, 0, 1)
    grey = dr.lerp(mi.Color3f(0.19, 0.17, 0.165), mi.Color3f(0.34, 0.29, 0.27), mi.Float(spots))
    grey = dr.lerp(grey, mi.Color3f(0.3, 0.22, 0.17), 0.45 * belly)
    ear = dr.clip(1 - 4 * dr.abs(_ear(sdf.mirrored(p, 2))), 0, 1) * dr.clip(3 * (dr.abs(p.z) - 0.42), 0, 1)
    grey = dr.lerp(grey, mi.Color3f(0.52, 0.3, 0.26), 0.7 * ear)
    # Bands across the blanket, lozenges between them.
    u, v = (p.x + 0.14) * 9.0, dr.atan2(p.z, p.y) * 5.0
    lozenge = dr.abs(u - dr.round(u)) + dr.abs(v - dr.round(v))
    cloth = dr.select(lozenge < 0.32, mi.Color3f(0.78, 0.52, 0.07), mi.Color3f(0.42, 0.03, 0.05))
    hem = dr.maximum(dr.abs(p.x + 0.14) - 0.37, 0.09 - p.y) > 0
    cloth = dr.select(hem, mi.Color3f(0.04, 0.1, 0.32), cloth)
    looks = {
        "hide": (grey, 0.75 - 0.15 * spots, 0.0),
        "tusk": (mi.Color3f(0.83, 0.75, 0.56) * (1 - 0.25 * dr.clip(1.2 - p.x, 0, 1)), 0.25, 0.0),
        "nail": (mi.Color3f(0.55, 0.46, 0.36), 0.4, 0.0),
        "eye": (mi.Color3f(0.02, 0.012, 0.01), 0.12, 0.0),
        "cloth": (cloth, 0.6, 0.0),
    }
    parts = _parts(p)
    nearest = sdf.union(*parts.values())
    out = Surfel(mi.Color3f(0), mi.Float(0), mi.Float(0))
    for name, (color, roughness, metallic) in looks.items():
        here = parts[name] <= nearest
        out.base_color = dr.select(here, color, out.base_color)
        out.roughness = dr.select(here, mi.Float(roughness), out.roughness)
        out.metallic = dr.select(here, mi.Float(metallic), out.metallic)
    return out


def creature(**changes: Any) -> Implicit:
    """
    The sample; ``changes`` replace fields of it.
    """
    bounds = np.array([[-1.2, -1.12, -0.95], [1.75, 1.05, 0.95]])
    fields = {"material": material, "bounds": bounds, "ambient": (0.06, 0.07, 0.1), "name": "creature"}
    return Implicit(distance, **{**fields, **changes})
