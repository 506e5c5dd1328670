"""
The parts of the sample ``relic``: a serpent wound around an inlaid stone egg on a pierced golden foot.

Fine relief (scales, inlay, gadroons), through-holes (the gallery, the coils, two rings), thin parts (spines, horns,
tongue, prongs), materials with textures of their own, metal and stone; no symmetry, so that a swapped axis shows.
"""

from __future__ import annotations

import numpy as np

from ...formats.images import constant
from ...model.asset import Material, Part
from .noise import cloud_noise, lattice_hash, smooth_noise
from .parametric import Curve, join, lathe, paint, smoothstep, surface, tube, unit, with_uvs

GOLD = np.array([0.83, 0.56, 0.16])


def _steps(detail: float, columns: int, rows: int) -> tuple[int, int]:
    return max(3, round(columns * detail)), max(3, round(rows * detail))


def _texels(detail: float, width: int, height: int) -> tuple[int, int]:
    return (width, height) if detail > 0.74 else (width // 2, height // 2)


def _egg_profile(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radius and height of the smooth egg; v = 0 at the top."""
    a = np.pi * v
    return 0.47 * np.sin(a) * (1 - 0.2 * np.cos(a)), 0.03 + 0.66 * np.cos(a)


def _egg_inlay(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Where golden wire lies on the egg, the bud inside every mesh of it, and a number for every mesh.

    Two families of spirals, 8 one way and 13 the other as on a pine cone, cross in meshes that shrink to the poles.
    """
    height = 3 * np.log(np.tan(np.pi * np.clip(v, 0.02, 0.98) / 2))  # Mercator, so that meshes keep their angles
    p, q = 8 * u + 1.1 * height, 13 * u - 0.8 * height
    dp, dq = np.abs(p - np.round(p)), np.abs(q - np.round(q))
    kind = lattice_hash(np.floor(p) % 8, np.floor(q) % 13)
    away = np.minimum(dp, dq)  # 0 on a wire, .5 in the middle of a mesh
    rim = smoothstep(0.115, 0.1, v) + smoothstep(0.885, 0.9, v)  # caps at the poles
    wire = smoothstep(0.1, 0.055, away)
    knot = smoothstep(0.2, 0.12, np.hypot(dp, dq))
    setting = smoothstep(0.05, 0.03, np.abs(away - 0.25)) * ((kind > 0.8) | (kind < 0.24))
    wire = np.maximum(np.maximum(wire, 1.6 * knot), np.maximum(0.7 * setting, rim))
    bud = smoothstep(0.16, 0.42, away) * (1 - rim)
    return wire, bud, kind


def egg(detail: float) -> Part:
    def radius(u, v):
        r, y = _egg_profile(v)
        wire, bud, kind = _egg_inlay(u, v)
        relief = 0.012 * wire + 0.022 * bud * (0.6 + 0.4 * kind)
        fade = np.sin(np.pi * v)
        return r + relief * fade, y + 0.01 * wire * np.cos(np.pi * v)

    def shade(u, v):
        wire, bud, kind = _egg_inlay(u, v)
        wire = np.minimum(wire, 1)
        clouds = cloud_noise(u, v, 6, 6, 5)
        lapis = np.array([0.015, 0.045, 0.25]) + np.array([0.02, 0.07, 0.3]) * clouds[..., None]
        speck = smoothstep(0.78, 0.86, smooth_noise(u, v, 180, 150)) * smoothstep(0.45, 0.6, clouds)  # pyrite
        jade = np.array([0.03, 0.3, 0.16]) * (0.6 + 0.8 * clouds[..., None])
        ruby = np.array([0.42, 0.015, 0.03]) * (0.7 + 0.6 * clouds[..., None])
        stone = np.where((kind > 0.8)[..., None], ruby, np.where((kind < 0.24)[..., None], jade, lapis))
        stone = lapis + (stone - lapis) * smoothstep(0.15, 0.3, bud)[..., None]
        metal = np.maximum(wire, speck * (1 - bud))
        gold = GOLD * (0.85 + 0.3 * smooth_noise(u, v, 40, 60))[..., None]
        rgb = stone * (1 - metal[..., None]) + gold * metal[..., None]
        rgb *= (0.45 + 0.55 * np.maximum(smoothstep(0.0, 0.5, bud), wire))[..., None]  # dirt in the grooves
        return rgb, (0.32 - 0.12 * bud + 0.2 * (1 - bud) * (1 - wire)) * (1 - metal) + 0.3 * metal, np.round(metal)

    return surface("egg", lathe(radius), _steps(detail, 232, 164), paint(_texels(detail, 1024, 1024), shade, "inlay"))


def _serpent_curve() -> Curve:
    """From the tip of the tail at the foot, up around the egg, to the snout."""
    t = np.linspace(0, 1, 34)
    angle = 0.6 + 2 * np.pi * 2.35 * t
    r, y = _egg_profile(0.885 - 0.7 * t)
    r = r + 0.085 - 0.02 * t + 0.012 * np.sin(9.1 * t + 1)
    y = y + 0.02 * np.sin(7 * t)
    coil = np.stack([r * np.cos(angle), y, -r * np.sin(angle)], 1)
    out = unit(coil * [1, 0.35, 1])
    tail = np.array([[0.78, -0.42, 0.12], [0.72, -0.53, -0.08], [0.56, -0.585, -0.27], [0.36, -0.59, -0.31]])
    head = np.array([[-0.27, 0.74, 0.12], [-0.2, 0.87, 0.22], [0.02, 0.99, 0.2], [0.2, 0.985, 0.26], [0.36, 0.9, 0.36]])
    up = np.broadcast_to([0.0, 1.0, 0.0], head.shape)
    tail_lean = np.array([[0.1, 1, 0], [0.2, 1, -0.2], [0.3, 0.8, -0.5], [0.4, 0.3, -0.8]])
    head_lean = up + np.array([[-1.2, 0, 0.2], [-0.8, 0, 0.0], [-0.2, 0, -0.2], [0.1, 0, 0.1], [0.3, 0, 0.3]])
    return Curve(np.concatenate([tail, coil[1:], head]), np.concatenate([tail_lean, out[1:], unit(head_lean)]))


_HEAD = 0.945
"""Where the neck ends, as a share of the serpent's length."""


def _thickness(v: np.ndarray) -> np.ndarray:
    body = 0.078 * smoothstep(-0.05, 0.3, v) * (1 - 0.35 * smoothstep(0.55, 0.93, v)) + 0.004
    h = np.clip((v - _HEAD) / (1 - _HEAD), 0, 1)
    skull = 0.052 + 0.045 * np.sin(np.pi * np.clip(h * 1.25, 0, 1)) ** 1.3 - 0.012 * h
    tip = np.sqrt(np.maximum(1 - ((h - 0.72) / 0.28).clip(0) ** 2, 0))
    return np.where(v < _HEAD, body, skull * tip) * smoothstep(0, 0.012, v)


def _scales(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height in [0, 1] of the scales, a number for every scale, and how much this is the belly."""
    around = np.abs(((u + 0.5) % 1) - 0.5) * 2  # 0 on the back, 1 under the belly
    belly = smoothstep(0.72, 0.78, around)
    x, y = u * 16, v * 190
    best = np.full(np.shape(u), np.inf)
    kind = np.zeros(np.shape(u))
    for step in (0, 1):  # rows are set off by half a scale, like bricks
        row = np.floor(y) + step
        shifted = x + 0.5 * (row % 2)
        away = np.hypot((shifted - np.round(shifted)) / 0.5, (y - row) / 0.62)
        nearer = away < best
        best = np.where(nearer, away, best)
        kind = np.where(nearer, lattice_hash(np.round(shifted) % 16, row), kind)
    back = smoothstep(1.05, 0.25, best)
    plates = smoothstep(0, 0.2, (v * 120) % 1) * (1 - smoothstep(0.75, 1.0, (v * 120) % 1))
    return back * (1 - belly) + plates * belly, kind, belly


def serpent(detail: float) -> Part:
    curve = _serpent_curve()

    def radius(u, v):
        height, _, belly = _scales(u, v)
        t = _thickness(v)
        on_head = smoothstep(_HEAD - 0.01, _HEAD + 0.01, v)
        a = 2 * np.pi * u
        h = np.clip((v - _HEAD) / (1 - _HEAD), 0, 1)
        temple = np.exp(-((np.abs(np.sin(a)) - 0.7) ** 2) / 0.03) * (np.cos(a) > 0)
        brow = 0.016 * np.exp(-(((h - 0.45) / 0.16) ** 2)) * temple
        mouth = 0.012 * np.exp(-((np.cos(a) + 0.12) ** 2) / 0.004) * smoothstep(0.35, 0.6, h)
        relief = 0.17 * t * height * (1 - 0.55 * on_head) + (brow - mouth) * on_head
        return (t + relief) * (1 - 0.3 * on_head), (t + relief) * (1 + 0.12 * on_head)

    def shade(u, v):
        height, kind, belly = _scales(u, v)
        stripe = smoothstep(0.35, 0.65, 0.5 + 0.5 * np.sin(2 * np.pi * v * 26 + 0.8 * np.cos(4 * np.pi * u)))
        emerald = np.array([0.012, 0.16, 0.085]) * (0.6 + 0.9 * kind[..., None])
        teal = np.array([0.01, 0.2, 0.24]) * (0.6 + 0.9 * kind[..., None])
        skin = teal + (emerald - teal) * stripe[..., None]
        gilded = (kind > 0.93) * (1 - belly) * (height > 0.2)
        ivory = np.array([0.62, 0.5, 0.3]) * (0.75 + 0.35 * smooth_noise(u, v, 12, 300))[..., None]
        rgb = skin * (1 - belly[..., None]) + ivory * belly[..., None]
        rgb = np.where(gilded[..., None] > 0.5, GOLD, rgb)
        rgb = rgb * (0.2 + 0.8 * smoothstep(0.05, 0.5, height))[..., None]
        return rgb, np.where(gilded > 0.5, 0.28, 0.5 - 0.22 * height + 0.1 * belly), np.round(gilded)

    skin = paint(_texels(detail, 256, 2048), shade, "scales")
    parts = [surface("serpent", tube(curve, radius), _steps(detail, 40, 860), skin)]
    return join("serpent", [*parts, *_spines(curve, detail, skin), *_head_parts(curve, detail, skin)])


def _thorn(knots: np.ndarray, width: float, detail: float, skin: Material, steps=(8, 10), flat: float = 1.0) -> Part:
    """A curved thorn along three or more points, thin at its end; coloured like the belly."""
    lean = np.broadcast_to(unit(np.cross(knots[1] - knots[0], [0.3, 0.2, 0.9])), knots.shape)

    def radius(u, v):
        r = width * np.sqrt(np.maximum(1 - v, 0)) * (1 - 0.25 * v) + 0.0004
        return r, r * flat

    part = surface("thorn", tube(Curve(knots, lean), radius), _steps(np.sqrt(detail), *steps), skin)
    return with_uvs(part, (0.46, 0.3), (0.08, 0.01))


def _spines(curve: Curve, detail: float, skin: Material) -> list[Part]:
    """Thorns along the back, each leaning towards the tail."""
    out = []
    for s in np.linspace(0.12, 0.93, 46):
        p, t, n, _ = curve.frame(s)
        r = float(_thickness(np.asarray(s)))
        size = 0.6 * r + 0.035 * np.sin(np.pi * s)
        base = p + n * r * 0.95
        knots = np.stack([base, base + n * size * 0.6 - t * size * 0.2, base + n * size - t * size * 0.75])
        out.append(_thorn(knots, 0.22 * r, detail, skin, (7, 6), 0.6))
    return out


def _head_parts(curve: Curve, detail: float, skin: Material) -> list[Part]:
    """Horns and a forked tongue."""
    out = []
    p, t, n, b = curve.frame(0.962)
    for side in (-1, 1):
        base = p + n * 0.05 + b * 0.05 * side
        bend = [(0.0, 0.0, 0.0), (0.05, -0.06, 0.03), (0.1, -0.16, 0.05), (0.17, -0.22, 0.03)]
        knots = np.stack([base + n * x + t * y + b * side * z for x, y, z in bend])
        out.append(_thorn(knots, 0.02, detail, skin, (12, 24)))
    p, t, n, b = curve.frame(0.999)
    for side in (-1, 1):
        way = [[0, -0.02, 0.002], [0.06, -0.03, 0.004], [0.11, -0.02, 0.012], [0.16, 0.01, 0.04]]
        knots = np.stack([p + t * x + n * y + b * side * z for x, y, z in way])
        out.append(_thorn(knots, 0.008, detail, skin, (6, 14), 0.5))
    return out


def eyes(detail: float) -> Part:
    """Two rubies; a constant material, and a part in two pieces."""
    ruby = Material("ruby", constant(0.5, 0.012, 0.02, 1), constant(0, 0.08, 0))
    p, _, n, b = _serpent_curve().frame(0.974)
    eyes = []
    for side in (-1, 1):
        ball = lathe(lambda u, v: (0.024 * np.sin(np.pi * v), 0.024 * np.cos(np.pi * v)))
        eye = surface("eye", ball, _steps(detail, 20, 12), ruby)
        centre = p + n * 0.034 + b * side * 0.071
        eyes.append(Part(eye.vertices + centre, eye.faces, uvs=eye.uvs, material=ruby, name="eye"))
    return join("eyes", eyes)


def foot(detail: float) -> Part:
    """A gadrooned base, a gallery of rings, five prongs that hold the egg, and a handle on one side."""
    profile = np.array(
        [[0, -0.66], [0.2, -0.655], [0.3, -0.63], [0.33, -0.645], [0.3, -0.69], [0.24, -0.73], [0.25, -0.77],
         [0.36, -0.8], [0.5, -0.83], [0.53, -0.86], [0.54, -0.9], [0.51, -0.915], [0.55, -0.93], [0.575, -0.97],
         [0.55, -1.0], [0.3, -1.0], [0, -0.985]]
    )  # fmt: skip
    way = np.linspace(0, 1, len(profile))

    def radius(u, v):
        r, y = (np.interp(v, way, c) for c in profile.T)
        lobes = smoothstep(0.42, 0.5, v) * smoothstep(0.6, 0.55, v)
        flutes = smoothstep(0.24, 0.3, v) * smoothstep(0.42, 0.38, v)
        beads = smoothstep(0.74, 0.78, v) * smoothstep(0.86, 0.82, v)
        a = 2 * np.pi * u
        relief = 0.03 * lobes * np.abs(np.sin(12 * a + 6 * v)) - 0.012 * flutes * np.abs(np.sin(14 * a))
        return r + relief + 0.012 * beads * np.sqrt(np.abs(np.sin(30 * a))), y

    def shade(u, v):
        clouds = cloud_noise(u, v, 8, 8, 5)
        patina = smoothstep(0.5, 0.7, clouds) * smoothstep(0.3, 0.6, smooth_noise(u, v, 24, 24))
        groove = 0.55 + 0.45 * np.abs(np.sin(24 * np.pi * u + 6 * v)) ** 0.4 * np.ones_like(v)
        gold = GOLD * (0.8 + 0.35 * smooth_noise(u, v, 60, 60))[..., None] * groove[..., None]
        green = np.array([0.08, 0.22, 0.17]) * (0.7 + 0.6 * clouds[..., None])
        metal = (patina < 0.5).astype(float)
        rgb = np.where(metal[..., None] > 0.5, gold, green)
        return rgb, np.where(metal > 0.5, 0.22 + 0.25 * clouds, 0.75), metal

    brass = paint(_texels(detail, 1024, 1024), shade, "brass")
    parts = [surface("base", lathe(radius), _steps(detail, 168, 56), brass)]
    for k in range(14):
        a = 2 * np.pi * (k + 0.25) / 14
        centre = np.array([0.405 * np.cos(a), -0.735, -0.405 * np.sin(a)])
        out = np.array([np.cos(a), 0.25, -np.sin(a)])
        parts.append(_ring(centre, out, 0.075, 0.013, detail, brass, k / 14))
    for k in range(5):
        a = 2 * np.pi * (k + 0.4) / 5
        reach = [[0.27, -0.66], [0.4, -0.6], [0.455, -0.45], [0.5, -0.3], [0.47, -0.17]]
        knots = np.array([[r * np.cos(a + 0.2 * i), y, -r * np.sin(a + 0.2 * i)] for i, (r, y) in enumerate(reach)])
        thorn = _thorn(knots, 0.022, detail, brass, (10, 30))
        parts.append(with_uvs(thorn, (0, 0), (1, 2)))
    parts.append(_ring(np.array([-0.63, -0.87, 0.16]), np.array([0.25, 0.1, 1.0]), 0.12, 0.016, detail, brass, 0.1, 40))
    parts.append(_ring(np.array([-0.74, -0.885, 0.185]), np.array([0.1, 1.0, 0.3]), 0.07, 0.011, detail, brass, 0.6))
    return join("foot", parts)


def _ring(centre, axis, radius, thick, detail: float, material: Material, at: float, steps: int = 26) -> Part:
    """A twisted ring around an axis; its texels lie at u = ``at``."""
    axis = unit(np.asarray(axis, float))
    x = unit(np.cross(axis, [0.0, 1.0, 0.1]))
    y = np.cross(axis, x)

    def position(u, v):
        a, b = 2 * np.pi * v, 2 * np.pi * u
        out = np.cos(a)[..., None] * x + np.sin(a)[..., None] * y
        r = thick * (1 + 0.12 * np.sin(3 * b + 12 * a))
        return centre + out * (radius + r * np.cos(b))[..., None] + axis * (r * np.sin(b))[..., None]

    part = surface("ring", position, _steps(np.sqrt(detail), 9, steps), material, closed=(True, True))
    return with_uvs(part, (at, 0.66), (0.05, 0.02))
