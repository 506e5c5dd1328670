"""
Leaves, pinnae, flowers and stalks of the sample plants; each grows along +Y with its upper side +Z.
"""

from __future__ import annotations

import numpy as np

from ...model.asset import Material, Part
from .noise import cloud_noise, smooth_noise
from .parametric import Curve, join, paint, smoothstep, surface, tube, with_uvs


def _grid(detail: float, columns: int, rows: int) -> tuple[int, int]:
    """Quads of a blade, an even number across, so that the midrib is an edge."""
    return max(2, 2 * round(columns * detail / 2)), max(3, round(rows * detail))


def _blade(name: str, half_width, height, length: float, material: Material, shape: tuple[int, int]) -> Part:
    """
    A blade over u in [-1, 1] across and v in [0, 1] from tip to base (the image's top is the tip).
    """

    def position(u, v):
        x, y = 2 * u - 1, 1 - v
        w = half_width(y, x)
        return np.stack([w * x, length * y, height(x, y, w)], -1)

    part = surface(name, position, shape, material, closed=(False, False))
    return Part(part.vertices, part.faces[:, ::-1], uvs=part.uvs, material=material, name=name)


def _veins(x: np.ndarray, y: np.ndarray, n: int, slope: float) -> np.ndarray:
    """1 on the midrib and on ``n`` veins that leave it, 0 between; x in [-1, 1], y in [0, 1]."""
    phase = (y - slope * np.abs(x)) * n
    side = smoothstep(0.16, 0.02, np.abs(phase - np.round(phase))) * smoothstep(1.0, 0.8, np.abs(x))
    return np.maximum(smoothstep(0.07, 0.02, np.abs(x)), 0.7 * side)


def leaf(kind: int, detail: float) -> Part:
    """
    An ovate, toothed, folded and wavy leaf, opaque; ``kind`` from 0 tells young, light ones from old, dark ones.
    """
    old = kind / 3
    seed = 0.37 * kind

    def half_width(y, x):
        outline = np.sin(np.pi * np.clip(y, 0, 1) ** 0.72) ** 0.9 * (1 - 0.25 * y)
        teeth = 1 + 0.09 * np.abs(((y * 9) % 1) - 0.5) * smoothstep(0.6, 1.0, np.abs(x))
        return 0.36 * outline * teeth + 0.012

    def height(x, y, w):
        fold = (0.45 - 0.2 * old) * np.abs(x) * w
        wave = 0.035 * np.sin(9 * y + 2.1 * x + 5 * seed) * np.abs(x)
        relief = -0.012 * _veins(x, y, 8, 0.35)
        return fold + wave + relief - (0.22 + 0.12 * old) * y**2

    def shade(u, v):
        x, y = 2 * u - 1, 1 - v
        mottle = cloud_noise((u + seed) % 1, v, 5, 5, 5)
        vein = _veins(x, y, 8, 0.35)
        young, aged = np.array([0.19, 0.38, 0.04]), np.array([0.025, 0.11, 0.02])
        rgb = (young + (aged - young) * old) * (0.55 + 0.9 * mottle)[..., None]
        # Light that comes through makes the thin parts yellow, the veins pale.
        rgb = rgb + np.array([0.10, 0.09, 0.0]) * ((1 - old) * smoothstep(0.2, 0.9, np.abs(x)))[..., None]
        rgb = rgb * (1 - 0.6 * vein)[..., None] + np.array([0.3, 0.36, 0.12]) * (0.6 * vein)[..., None]
        spots = smoothstep(0.72, 0.8, smooth_noise((u + seed) % 1, v, 22, 30)) * old
        rgb = rgb * (1 - spots)[..., None] + np.array([0.22, 0.11, 0.03]) * spots[..., None]
        return rgb, 0.62 - 0.12 * old + 0.15 * mottle, np.zeros_like(u)

    skin = paint((192, 256), shade, f"leaf_{kind}")
    return _blade(f"leaf_{kind}", half_width, height, 1.0, skin, _grid(detail, 10, 20))


def pinna(kind: int, detail: float) -> Part:
    """
    A lobed side leaf of a fern: a strip with relief, whose outline is cut by the texture's opacity (MASK).
    """
    n_lobes, seed = 11 + 2 * kind, 0.29 * kind

    def half_width(y, x):
        return np.full(np.shape(y), 0.17)

    def height(x, y, w):
        lobe = np.abs(((y * n_lobes) % 1) - 0.5)
        return 0.05 * np.abs(x) - 0.02 * lobe * np.abs(x) - 0.2 * y**2 + 0.015 * np.sin(6 * y + 9 * seed)

    def shade(u, v):
        x, y = 2 * u - 1, 1 - v
        mottle = cloud_noise((u + seed) % 1, v, 4, 8, 5)
        rib = smoothstep(0.06, 0.02, np.abs(x))
        tip, base = np.array([0.24, 0.42, 0.05]), np.array([0.05, 0.2, 0.025])
        rgb = (base + (tip - base) * (0.25 * kind + 0.5 * y)[..., None]) * (0.55 + 0.9 * mottle)[..., None]
        rgb = rgb * (1 - 0.5 * rib)[..., None] + np.array([0.25, 0.2, 0.06]) * (0.5 * rib)[..., None]
        return rgb, 0.66 + 0.12 * mottle, np.zeros_like(u)

    material = paint((96, 384), shade, f"pinna_{kind}")
    u, v = np.meshgrid((np.arange(96) + 0.5) / 96, (np.arange(384) + 0.5) / 384, indexing="xy")
    x, y = np.abs(2 * u - 1), 1 - v
    taper = np.sin(np.pi * np.clip(0.12 + 0.88 * y, 0, 1) ** 0.8) ** 0.6
    lobe = np.abs((((y - 0.12 * x) * n_lobes) % 1) - 0.5) * 2  # 0 in the middle of a lobe, 1 between two
    inside = taper * (1 - 0.5 * smoothstep(0.5, 1.0, lobe)) * (0.92 + 0.08 * smooth_noise(u, v, 9, 40)) - x
    opacity = np.maximum(smoothstep(-0.02, 0.02, inside), smoothstep(0.06, 0.04, x))
    base = material.base_color.copy()
    base[..., 3] = opacity
    skin = Material(material.name, base, material.specular, None, "MASK", 0.5)
    return _blade(f"pinna_{kind}", half_width, height, 1.0, skin, _grid(detail, 10, 26))


def flower(kind: int, detail: float) -> Part:
    """
    Five ruffled petals around a column, one texture.
    """
    seed = 0.4 * kind

    def shade(u, v):
        x, y = 2 * u - 1, 1 - v
        pink = np.array([0.75, 0.08, 0.16]) if kind == 0 else np.array([0.85, 0.33, 0.08])
        streak = smoothstep(0.35, 0.0, np.abs(((x * 5.5 / (0.4 + y)) % 1) - 0.5)) * smoothstep(1.0, 0.2, y)
        rgb = pink * (0.65 + 0.5 * cloud_noise((u + seed) % 1, v, 4, 4, 4))[..., None]
        deep = smoothstep(0.35, 0.05, y)[..., None]
        rgb = rgb * (1 - 0.35 * streak)[..., None] * (1 - deep) + np.array([0.28, 0.01, 0.05]) * deep
        return rgb, np.full_like(u, 0.6), np.zeros_like(u)

    skin = paint((128, 128), shade, f"flower_{kind}")

    def half_width(y, x):
        return 0.06 + 0.4 * np.sin(np.pi * np.clip(0.08 + 0.8 * y, 0, 1)) ** 0.8

    def height(x, y, w):
        return 0.55 * np.sqrt(y) * (1 - 0.55 * y) + 0.05 * np.sin(7 * x + 8 * y + 6 * seed) * y + 0.12 * x * x * y

    petal = _blade("petal", half_width, height, 1.0, skin, _grid(detail, 10, 12))
    parts = []
    for k in range(5):
        a = 2 * np.pi * k / 5 + 0.1 * np.sin(3 * k)
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        lift = np.array([0, 0, 0.02 * (k % 2)])  # neighbours overlap
        parts.append(Part(petal.vertices @ turn.T + lift, petal.faces, uvs=petal.uvs, material=skin, name="petal"))
    way = np.array([[0, 0, 0], [0.02, 0.01, 0.4], [0.06, 0.04, 0.95]], float)
    column = tube(Curve(way, np.tile([1.0, 0, 0], (3, 1))), lambda u, v: (0.035 + 0.03 * v**4, 0.035 + 0.03 * v**4))
    rod = surface("column", column, (max(3, round(8 * detail)), max(3, round(14 * detail))), skin)
    parts.append(with_uvs(rod, (0.45, 0.2), (0.1, 0.3)))
    return join(f"flower_{kind}", parts)


def stalk(
    name: str, knots: np.ndarray, radius: float, taper: float, detail: float, shape: tuple[int, int] = (8, 26)
) -> tuple[Part, Curve]:
    """
    A bark-covered tube along some points, thinner by the factor ``taper`` at its end, and its curve.
    """
    lean = np.tile([0.31, 0.12, 0.94], (len(knots), 1))
    curve = Curve(np.asarray(knots, float), lean)

    def around(u, v):
        r = radius * (1 + (taper - 1) * v) * (1 + 0.12 * np.sin(5 * 2 * np.pi * u + 3 * v) + 0.1 * np.sin(31 * v))
        return r, r

    def shade(u, v):
        bark = cloud_noise(u, v, 4, 24, 4)
        green = np.array([0.1, 0.16, 0.03])
        rgb = np.array([0.16, 0.1, 0.055]) * (0.5 + bark)[..., None] * (1 - 0.6 * v)[..., None]
        return rgb + green * (0.6 * v)[..., None], 0.75 + 0.15 * bark, np.zeros_like(u)

    skin = paint((32, 128), shade, name)
    columns, rows = (max(3, round(n * detail)) for n in shape)
    return surface(name, tube(curve, around), (columns, rows), skin), curve
