"""
Parametric surfaces as textured parts: grids that close on themselves, lathes, tubes along a curve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ...model.asset import Material, Part
from ...model.topology import area_vectors


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """
    0 below ``low``, 1 above ``high``, a cubic between; ``low`` may be the larger one.
    """
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def surface(
    name: str,
    position: Callable[[np.ndarray, np.ndarray], np.ndarray],
    shape: tuple[int, int],
    material: Material,
    *,
    closed: tuple[bool, bool] = (True, False),
) -> Part:
    """
    The image of the unit square under ``position(u, v)``, as a grid of ``shape`` (columns, rows) quads.

    Parameters
    ----------
    position : callable
        Takes arrays of one shape in [0, 1], returns points, shape (..., 3). ``(u, v)`` must be wound so that
        ∂p/∂u × ∂p/∂v points inwards (v grows downwards in the texture).
    closed : tuple of bool
        Whether u, and v, come back to where they started: the last column (row) repeats the points of the first
        exactly, with texture coordinates of 1.

    Returns
    -------
    Part
        Without normals; triangles without area (poles) are left out.
    """
    columns, rows = shape
    i, j = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="xy")  # (rows + 1, columns + 1)
    wrapped = [np.where(c, k % n, k) / n for k, n, c in ((i, columns, closed[0]), (j, rows, closed[1]))]
    points = position(*wrapped).reshape(-1, 3)
    uvs = np.stack([i / columns, j / rows], -1).reshape(-1, 2)
    k = (i + j * (columns + 1))[:-1, :-1].ravel()
    right, below = k + 1, k + columns + 1
    faces = np.concatenate([np.stack([k, below, right], 1), np.stack([right, below, below + 1], 1)])
    p = points[faces]
    area = np.linalg.norm(area_vectors(p), axis=1)
    return Part(points, faces[area > 1e-12], uvs=uvs.astype(np.float32), material=material, name=name)


def join(name: str, parts: list[Part]) -> Part:
    """
    Several parts with the first one's material as one.
    """
    starts = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    return Part(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=True)]),
        uvs=np.concatenate([p.uvs for p in parts]),
        material=parts[0].material,
        name=name,
    )


def with_uvs(part: Part, start: tuple[float, float], scale: tuple[float, float]) -> Part:
    """
    The part with its texture coordinates scaled and moved.
    """
    assert part.uvs is not None
    return replace(part, uvs=(np.array(start) + part.uvs * np.array(scale)).astype(np.float32))


class Curve:
    """
    A smooth curve by arc length, with a frame that leans towards a given side.

    Parameters
    ----------
    knots : ndarray, shape (K, 3)
        Points that it passes through.
    lean : ndarray, shape (K, 3)
        Where the first normal points at every knot, as far as the curve's direction allows.
    """

    def __init__(self, knots: np.ndarray, lean: np.ndarray):
        chord = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
        spline = CubicSpline(chord, knots, bc_type="natural")
        fine = np.linspace(0, chord[-1], 4000)
        way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(spline(fine), axis=0), axis=1))])
        self.length = float(way[-1])
        self._parameter = lambda s: np.interp(np.asarray(s) * way[-1], way, fine)
        self._spline, self._lean = spline, CubicSpline(chord, lean, bc_type="natural")

    def frame(self, s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """
        Point, unit tangent, normal and binormal (tangent × normal) at ``s`` in [0, 1], shape (..., 3) each.
        """
        x = self._parameter(s)
        tangent = unit(self._spline(x, 1))
        lean = self._lean(x)
        normal = unit(lean - tangent * (lean * tangent).sum(-1, keepdims=True))
        return self._spline(x), tangent, normal, np.cross(tangent, normal)


def unit(x: np.ndarray) -> np.ndarray:
    """
    Unit vectors along the last axis.
    """
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-12)


def tube(curve: Curve, radius: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Callable:
    """
    A tube along a curve as a ``position(u, v)``: u runs around it, 0 where the normal points, v along it.

    ``radius(u, v)`` gives the half widths along normal and binormal.
    """

    def position(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        point, _, normal, binormal = curve.frame(v)
        high, wide = radius(u, v)
        a = 2 * np.pi * u
        return point + normal * (high * np.cos(a))[..., None] - binormal * (wide * np.sin(a))[..., None]

    return position


def lathe(radius: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Callable:
    """
    A surface of revolution about +Y as a ``position(u, v)``; ``radius(u, v)`` gives distance and height, top first.
    """

    def position(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        r, y = radius(u, v)
        a = 2 * np.pi * u
        return np.stack([r * np.cos(a), y, -r * np.sin(a)], -1)

    return position


def paint(shape: tuple[int, int], shader: Callable, name: str) -> Material:
    """
    A material whose textures are a function of (u, v) at the texel centres.

    Parameters
    ----------
    shape : tuple of int
        Columns and rows.
    shader : callable
        ``shader(u, v) -> (rgb, roughness, metallic)``, linear; arrays of shape (H, W, 3), (H, W), (H, W).
    """
    columns, rows = shape
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows, indexing="xy")
    rgb, roughness, metallic = (np.clip(x, 0, 1) for x in shader(u, v))
    return Material(
        name,
        base_color=np.concatenate([rgb, np.ones((rows, columns, 1))], -1).astype(np.float32),
        specular=np.stack([np.zeros((rows, columns)), roughness, metallic], -1).astype(np.float32),
    )
