"""
UsdGeom's solids as polygons: Sphere, Cube, Cylinder, Cone, Capsule and Plane.
"""

from __future__ import annotations

import numpy as np
from pxr import Usd

from .values import TIME

#: Segments around an axis, and from pole to pole of a sphere.
AROUND, DOWN = 48, 24

TYPES = ("Sphere", "Cube", "Cylinder", "Cone", "Capsule", "Plane", "Cylinder_1", "Capsule_1")


def primitive_mesh(prim: Usd.Prim) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """
    A solid as a closed triangle mesh (an open one for a plane), counter-clockwise seen from outside.

    Returns
    -------
    vertices : ndarray, shape (V, 3), float64
    faces : ndarray, shape (F, 3), int64
    normals : ndarray, shape (V, 3), float64
        Unit normals of the surface; vertices of creases are there twice.

    None for another type.
    """
    kind = prim.GetTypeName()
    if kind not in TYPES:
        return None

    def number(name: str, default: float) -> float:
        attribute = prim.GetAttribute(name)
        value = attribute.Get(TIME) if attribute else None
        return default if value is None else float(value)

    if kind == "Cube":
        return _cube(number("size", 2.0) / 2)
    if kind == "Plane":
        width, length = number("width", 2.0) / 2, number("length", 2.0) / 2
        if str(prim.GetAttribute("axis").Get(TIME)) != "Z":  # the width lies along z, or along x, the length across
            width, length = length, width
        corners = np.array([[-width, -length, 0], [width, -length, 0], [width, length, 0], [-width, length, 0]])
        out = corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0.0, 0.0, 1.0], (4, 1))
    elif kind == "Sphere":
        return _lathe(_arc(number("radius", 1.0), -90, 90))
    else:
        radius, half = number("radius", 1.0 if kind[:7] != "Capsule" else 0.5), number("height", 2.0) / 2
        if kind.startswith("Capsule"):
            half = number("height", 1.0) / 2
            low, high = number("radiusBottom", radius), number("radiusTop", radius)
            pieces = [_arc(low, -90, 0, -half), _line((low, -half), (high, half)), _arc(high, 0, 90, half)]
        elif kind == "Cone":
            pieces = [_line((0, -half), (radius, -half)), _line((radius, -half), (0, half))]
        else:
            low, high = number("radiusBottom", radius), number("radiusTop", radius)
            pieces = [
                _line((0, -half), (low, -half)),
                _line((low, -half), (high, half)),
                _line((high, half), (0, half)),
            ]
        parts = [_lathe(piece) for piece in pieces]
        starts = np.cumsum([0, *(len(v) for v, _, _ in parts)])
        out = (
            np.concatenate([v for v, _, _ in parts]),
            np.concatenate([f + n for (_, f, _), n in zip(parts, starts, strict=False)]),
            np.concatenate([n for _, _, n in parts]),
        )
    axis = prim.GetAttribute("axis").Get(TIME) if prim.GetAttribute("axis") else "Z"
    shift = {"X": 1, "Y": 2}.get(str(axis), 0)  # z goes to the axis, the others follow in turn
    return np.roll(out[0], shift, axis=1), out[1], np.roll(out[2], shift, axis=1)


def _arc(radius: float, low: float, high: float, z: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points (r, z) of a circle's arc between two latitudes [degrees], and their normals."""
    angles = np.radians(np.linspace(low, high, DOWN // (1 if high - low > 90 else 2) + 1))
    normals = np.stack([np.maximum(np.cos(angles), 0), np.sin(angles)], axis=1)
    return radius * normals + [0, z], normals


def _line(a: tuple[float, float], b: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Two points (r, z), upwards or across, and the normal to the right of the way."""
    points = np.array([a, b], float)
    r, z = points[1] - points[0]
    length = np.hypot(r, z) or 1.0
    return points, np.tile([z / length, -r / length], (2, 1))


def _lathe(profile: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A profile turned around z; quads that end in a pole become triangles."""
    points, normals = profile
    angles = np.arange(AROUND) * (2 * np.pi / AROUND)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)  # (A, 2)

    def turned(rows: np.ndarray) -> np.ndarray:
        flat = rows[:, None, :1] * ring
        return np.concatenate([flat, np.broadcast_to(rows[:, None, 1:], (*flat.shape[:2], 1))], axis=2).reshape(-1, 3)

    k, a = np.meshgrid(np.arange(len(points) - 1), np.arange(AROUND), indexing="ij")
    b = (a + 1) % AROUND
    low_a, low_b, high_a, high_b = k * AROUND + a, k * AROUND + b, (k + 1) * AROUND + a, (k + 1) * AROUND + b
    has_low, has_high = (points[:-1, 0] > 1e-12)[k], (points[1:, 0] > 1e-12)[k]
    faces = np.concatenate(
        [np.stack([low_a, low_b, high_b], -1)[has_low], np.stack([low_a, high_b, high_a], -1)[has_high]]
    )
    return turned(points), faces, turned(normals)


def _cube(half: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    square = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float)
    turns = [np.roll(square, k, axis=1) for k in range(3)]
    sides = [side for t in turns for side in (t, -t[::-1])]
    normals = [np.tile(side.mean(0), (4, 1)) for side in sides]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    vertices = np.concatenate(sides) * half
    return vertices, np.concatenate([faces + 4 * k for k in range(6)]), np.concatenate(normals)
