"""
The sample ``walker``: a figure of eleven joints that walks on the spot, one stride in 24 frames.

It faces +Z, stands 1.8 units high, and is bound with its arms spread. Left and right differ in colour and it carries a
satchel on one side, so that a mirrored axis shows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...model.asset import Asset, Instance, Material, Part
from ...model.rig import Rig, Skin
from .parametric import Curve, lathe, paint, smoothstep, surface, tube

N_FRAMES, RATE = 24, 24.0

#: Name, joint above, place in the bind pose.
_JOINTS = (
    ("hips", "", (0.0, 0.95, 0.0)),
    ("spine", "hips", (0.0, 1.12, 0.0)),
    ("head", "spine", (0.0, 1.5, 0.0)),
    ("arm_l", "spine", (0.19, 1.42, 0.0)),
    ("forearm_l", "arm_l", (0.47, 1.42, 0.0)),
    ("arm_r", "spine", (-0.19, 1.42, 0.0)),
    ("forearm_r", "arm_r", (-0.47, 1.42, 0.0)),
    ("thigh_l", "hips", (0.1, 0.9, 0.0)),
    ("shin_l", "thigh_l", (0.1, 0.48, 0.0)),
    ("thigh_r", "hips", (-0.1, 0.9, 0.0)),
    ("shin_r", "thigh_r", (-0.1, 0.48, 0.0)),
)
_NUMBER = {name: j for j, (name, _, _) in enumerate(_JOINTS)}


def walker(detail: float) -> Asset:
    """
    The figure; ``detail`` 1 has about 12,000 triangles.
    """
    parts = [_torso(detail), _head(detail), _satchel(detail)]
    for side, x in (("l", 1.0), ("r", -1.0)):
        parts += [_arm(detail, side, x), _leg(detail, side, x)]
    rig = _rig()
    instances = tuple(
        Instance(k, name=p.name, joint=_NUMBER["hips"] if p.skin is None else None) for k, p in enumerate(parts)
    )
    return Asset(tuple(parts), instances, name="walker", rig=rig)


def _rig() -> Rig:
    parents = np.array([_NUMBER.get(above, -1) for _, above, _ in _JOINTS])
    bind = np.tile(np.eye(4), (len(_JOINTS), 1, 1))
    bind[:, :3, 3] = [place for _, _, place in _JOINTS]
    turns = _turns(np.arange(N_FRAMES) / N_FRAMES)
    poses = np.empty((N_FRAMES, *bind.shape))
    for j, (name, _, _) in enumerate(_JOINTS):
        above = parents[j]
        local = np.tile(bind[j] if above < 0 else np.linalg.inv(bind[above]) @ bind[j], (N_FRAMES, 1, 1))
        if above < 0:  # up and down twice a stride, from side to side once
            phase = 2 * np.pi * np.arange(N_FRAMES) / N_FRAMES
            local[:, 0, 3] += 0.015 * np.sin(phase)
            local[:, 1, 3] += 0.02 * np.cos(2 * phase) - 0.03
        turn = np.tile(np.eye(4), (N_FRAMES, 1, 1))
        turn[:, :3, :3] = turns[name].as_matrix()
        poses[:, j] = (local if above < 0 else poses[:, above] @ local) @ turn
    return Rig(tuple(name for name, _, _ in _JOINTS), parents, bind, poses, np.arange(N_FRAMES, dtype=float), RATE)


def _turns(t: np.ndarray) -> dict[str, Rotation]:
    """Rotations of all joints against the bind pose at shares ``t`` of a stride."""
    swing = np.sin(2 * np.pi * t)

    def about(axes: str, *degrees: np.ndarray | float) -> Rotation:
        return Rotation.from_euler(axes, np.stack([np.broadcast_to(d, t.shape) for d in degrees], -1), degrees=True)

    out = {
        "hips": about("y", 6 * swing),
        "spine": about("xy", 4, -12 * swing),
        "head": about("xy", -4 + 3 * np.cos(4 * np.pi * t), 6 * swing),
    }
    for side, sign in (("l", 1.0), ("r", -1.0)):
        s = sign * swing
        bend = 55 * np.maximum(0, np.sin(2 * np.pi * t + (0 if sign > 0 else np.pi) - 2.2)) ** 2
        out[f"thigh_{side}"] = about("x", -26 * s - 0.25 * bend)
        out[f"shin_{side}"] = about("x", 8 + bend)
        out[f"arm_{side}"] = about("xz", 24 * s, -72 * sign)  # lowered, then swung
        out[f"forearm_{side}"] = about("y", -sign * (28 + 14 * s))
    return out


def _skin(n: int, *weights: tuple[str, np.ndarray]) -> Skin:
    names, values = zip(*weights, strict=True)
    joints = np.tile([_NUMBER[name] for name in names], (n, 1))
    values = np.stack(values, 1)
    return Skin(np.where(values > 0, joints, 0), values / values.sum(1, keepdims=True))


def _stripes(name: str, cloth: list[float], trim: list[float], n: int) -> Material:
    def shade(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        band = smoothstep(0.3, 0.36, np.abs((v * n + 0.08 * np.sin(6 * np.pi * u)) % 1 - 0.5))
        weave = 1 + 0.12 * np.sin(160 * np.pi * u) * np.sin(160 * np.pi * v)
        rgb = (np.array(cloth) * (1 - band[..., None]) + np.array(trim) * band[..., None]) * weave[..., None]
        return rgb, 0.75 - 0.3 * band, np.zeros_like(u)

    return paint((256, 256), shade, name)


def _limb(name: str, knots: np.ndarray, radius, steps: tuple[int, int], material: Material) -> Part:
    lean = np.tile([0.0, 0.0, 1.0], (len(knots), 1))
    return surface(name, tube(Curve(knots, lean), radius), steps, material)


def _steps(detail: float, columns: int, rows: int) -> tuple[int, int]:
    scale = np.sqrt(detail)
    return max(5, round(columns * scale)), max(6, round(rows * scale))


def _torso(detail: float) -> Part:
    knots = np.array([[0, 0.82, 0], [0, 0.95, 0], [0, 1.15, 0.01], [0, 1.35, 0], [0, 1.52, 0.0]])

    def radius(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        wide = np.interp(v, [0, 0.05, 0.2, 0.45, 0.75, 0.88, 1], [0, 0.13, 0.17, 0.14, 0.19, 0.09, 0.05])
        return wide * 0.68, wide

    part = _limb(
        "torso", knots, radius, _steps(detail, 36, 44), _stripes("shirt", [0.1, 0.25, 0.5], [0.7, 0.7, 0.6], 6)
    )
    up = smoothstep(0.98, 1.18, part.vertices[:, 1])
    return replace(part, skin=_skin(len(up), ("hips", 1 - up), ("spine", up)))


def _head(detail: float) -> Part:
    def profile(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a = np.pi * v
        nose = 0.05 * np.exp(-(((u - 0.75) / 0.03) ** 2) - ((v - 0.55) / 0.05) ** 2)
        neck = smoothstep(0.8, 0.95, v)
        return (0.13 * np.sin(a) + nose) * (1 - neck) + 0.055 * neck * (v < 1), 1.64 + 0.16 * np.cos(a) - 0.05 * neck

    def shade(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        hair = smoothstep(0.42, 0.38, v + 0.06 * np.cos(2 * np.pi * (u - 0.75)))
        eyes = sum(np.exp(-(((u - c) / 0.025) ** 2) - ((v - 0.46) / 0.03) ** 2) for c in (0.68, 0.82))
        rgb = np.array([0.6, 0.38, 0.27]) * (1 - hair[..., None]) + np.array([0.06, 0.03, 0.02]) * hair[..., None]
        return rgb * (1 - 0.9 * np.clip(eyes, 0, 1))[..., None], 0.6 - 0.2 * hair, np.zeros_like(u)

    part = surface("head", lathe(profile), _steps(detail, 36, 32), paint((256, 256), shade, "head"))
    up = smoothstep(1.46, 1.54, part.vertices[:, 1])
    return replace(part, skin=_skin(len(up), ("spine", 1 - up), ("head", up)))


def _satchel(detail: float) -> Part:
    """A rigid thing at the hips, without a skin of its own."""

    def profile(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.075 * np.sin(np.pi * v) ** 0.35, 0.1 * np.cos(np.pi * v)

    part = surface(
        "satchel", lathe(profile), _steps(detail, 20, 14), _stripes("leather", [0.3, 0.13, 0.04], [0.6, 0.5, 0.1], 2)
    )
    return replace(part, vertices=part.vertices * [0.7, 1, 1.2] + [0.2, 0.92, 0.02])


def _arm(detail: float, side: str, x: float) -> Part:
    knots = np.array([[0.1, 1.42, 0], [0.3, 1.42, -0.005], [0.47, 1.42, -0.01], [0.62, 1.42, 0], [0.78, 1.42, 0.01]])

    def radius(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r = np.interp(v, [0, 0.04, 0.3, 0.55, 0.8, 0.87, 0.95, 1], [0, 0.075, 0.062, 0.05, 0.04, 0.055, 0.045, 0])
        return r, r * np.interp(v, [0.8, 0.9], [1, 0.6])

    color = [0.55, 0.08, 0.06] if side == "l" else [0.1, 0.4, 0.15]
    part = _limb(
        f"arm_{side}", knots * [x, 1, 1], radius, _steps(detail, 20, 44), _stripes("sleeve", color, [0.7, 0.6, 0.3], 7)
    )
    along = np.abs(part.vertices[:, 0])
    out, bend = smoothstep(0.13, 0.25, along), smoothstep(0.42, 0.52, along)
    weights = (("spine", 1 - out), (f"arm_{side}", out * (1 - bend)), (f"forearm_{side}", out * bend))
    return replace(part, skin=_skin(len(along), *weights))


def _leg(detail: float, side: str, x: float) -> Part:
    knots = np.array(
        [[0.09, 0.98, 0], [0.1, 0.7, 0], [0.1, 0.48, 0.01], [0.1, 0.2, 0], [0.1, 0.07, 0.0], [0.1, 0.035, 0.14]]
    )

    def radius(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r = np.interp(
            v, [0, 0.04, 0.25, 0.48, 0.6, 0.8, 0.9, 0.97, 1], [0, 0.09, 0.085, 0.06, 0.062, 0.045, 0.05, 0.035, 0]
        )
        return r, r

    color = [0.12, 0.12, 0.14] if side == "l" else [0.35, 0.3, 0.2]
    part = _limb(
        f"leg_{side}",
        knots * [x, 1, 1],
        radius,
        _steps(detail, 20, 56),
        _stripes("trousers", color, [0.5, 0.2, 0.1], 9),
    )
    y = part.vertices[:, 1]
    down, bend = smoothstep(0.97, 0.84, y), smoothstep(0.54, 0.42, y)
    weights = (("hips", 1 - down), (f"thigh_{side}", down * (1 - bend)), (f"shin_{side}", down * bend))
    return replace(part, skin=_skin(len(y), *weights))
