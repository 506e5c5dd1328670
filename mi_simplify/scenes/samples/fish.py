"""
The sample ``fish``: one closed surface on a spine of nine joints; it swims, now faster, now slower, and turns.

It faces +Z; back and tail fin are part of the body, so that the surface has genus 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.asset import Asset, Instance, Material
from ...model.rig import Rig, Skin
from .parametric import paint, smoothstep, surface

N_FRAMES, RATE = 240, 24.0

#: Joints of the spine and where they lie, from head to tail.
_SPINE = np.linspace(0.75, -0.85, 9)


def fish(detail: float) -> Asset:
    """
    The fish; ``detail`` 1 has about 8,000 triangles.
    """
    scale = np.sqrt(detail)
    part = surface("body", _position, (max(12, round(64 * scale)), max(16, round(64 * scale))), _material())
    place = np.interp(part.vertices[:, 2], _SPINE[::-1], np.arange(9)[::-1])
    low = np.clip(np.floor(place).astype(np.int64), 0, 7)
    share = np.clip(place - low, 0, 1)
    skin = Skin(np.stack([low, low + 1], 1), np.stack([1 - share, share], 1))
    return Asset((replace(part, skin=skin),), (Instance(0, name="body"),), name="fish", rig=_rig())


def _position(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Around the body by u (0: the back), from mouth to tail by v."""
    z = 1.0 - 2.0 * v
    body = np.sin(np.pi * np.clip(v, 0, 1) ** 0.8) ** 0.75
    tail = smoothstep(0.74, 0.98, v) * np.sqrt(np.clip(1 - v, 0, 1) / 0.26 + 0.0) * 1.1
    wide = 0.17 * body * (1 - 0.75 * smoothstep(0.5, 0.85, v)) + 0.012 * smoothstep(0, 0.05, v) * (v < 1)
    high = 0.26 * body * (1 - 0.65 * smoothstep(0.45, 0.8, v)) + 0.34 * tail
    a = -2 * np.pi * u  # wound so that the outside is the front
    crest = np.exp(-(((np.where(u > 0.5, u - 1, u)) / 0.045) ** 2))
    fin = 0.24 * crest * smoothstep(0.22, 0.38, v) * smoothstep(0.68, 0.6, v)
    sides = sum(np.exp(-(((u - c) / 0.04) ** 2)) for c in (0.33, 0.67)) * np.exp(-(((v - 0.36) / 0.06) ** 2))
    out = wide + 0.3 * sides
    closed = (v > 0) & (v < 1)
    x = np.where(closed, out * np.sin(a), 0.0)
    y = np.where(closed, (high + fin) * np.cos(a) - 0.12 * sides, 0.0)
    return np.stack([x, y, z - 0.18 * sides + 0.1 * tail * np.abs(np.cos(a)) * -1], axis=-1)


def _rig() -> Rig:
    n = len(_SPINE)
    bind = np.tile(np.eye(4), (n, 1, 1))
    bind[:, 2, 3] = _SPINE
    poses = np.empty((N_FRAMES, n, 4, 4))
    clip = 2 * np.pi * np.arange(N_FRAMES) / N_FRAMES  # everything repeats after it
    stroke = 7 * clip + 1.5 * np.sin(2 * clip)
    effort = 1 + 0.6 * np.sin(3 * clip)
    for j in range(n):
        local = np.tile(np.eye(4), (N_FRAMES, 1, 1))
        local[:, 2, 3] = _SPINE[j] - (_SPINE[j - 1] if j else 0)
        turn = np.radians(13) * np.sin(clip + 1.2 * np.sin(2 * clip) - 0.15 * j)
        swing = np.radians(2 + 1.8 * j) * effort * np.sin(stroke - 0.55 * j) + turn
        bend = np.radians(8) * np.sin(2 * clip - 0.3 * j)
        local[:, :3, :3] = _turns(swing, bend)
        poses[:, j] = local if not j else poses[:, j - 1] @ local
    names = tuple(f"spine_{j}" for j in range(n))
    return Rig(names, np.arange(-1, n - 1), bind, poses, np.arange(N_FRAMES, dtype=float), RATE)


def _turns(yaw: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Rotations about +Y, then +X, shape (T, 3, 3)."""
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    c, s = np.cos(yaw), np.sin(yaw)
    about_y = np.stack([np.stack([c, zero, s], -1), np.stack([zero, one, zero], -1), np.stack([-s, zero, c], -1)], 1)
    c, s = np.cos(pitch), np.sin(pitch)
    about_x = np.stack([np.stack([one, zero, zero], -1), np.stack([zero, c, -s], -1), np.stack([zero, s, c], -1)], 1)
    return about_y @ about_x


def _material() -> Material:
    def shade(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        back = np.cos(2 * np.pi * u)[..., None] * 0.5 + 0.5
        bands = smoothstep(0.1, 0.3, np.abs((9 * v) % 1 - 0.5))[..., None]
        rgb = (1 - back) * np.array([0.75, 0.7, 0.6]) + back * (np.array([0.1, 0.25, 0.35]) + 0.3 * bands)
        eye = np.exp(-(((v - 0.12) / 0.02) ** 2) - ((np.minimum(np.abs(u - 0.2), np.abs(u - 0.8))) / 0.03) ** 2)
        return rgb * (1 - 0.9 * eye[..., None]), np.full_like(u, 0.4), np.zeros_like(u)

    return paint((256, 256), shade, "scales")
