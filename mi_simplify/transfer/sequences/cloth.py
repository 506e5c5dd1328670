"""
A square of cloth over a moving ball: position-based dynamics (Müller et al. 2007) in NumPy.

Its corners are held; the ball rises and circles below it. Constraints of a grid that do not share a vertex are solved
together, so that a sweep is a handful of array operations and the same on every machine.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..surfaces.image import grid_faces
from .sequence import Sequence

N_SUBSTEPS, N_SWEEPS = 4, 6

#: Seconds between frames, gravity [sides / s²], velocity kept in a second, radius of the ball [sides].
STEP, GRAVITY, KEPT, RADIUS = 1 / 30, -3.0, 0.35, 0.27


def cloth(n_frames: int = 500, n: int = 64, seed: int = 0) -> Sequence:
    """
    Cloth over a ball that circles and pumps below it, in wind, its corners held by springs.

    Parameters
    ----------
    n_frames : int
    n : int
        Vertices a side.
    seed : int
        Of the wind and the ball's way.
    """
    rng = np.random.default_rng(seed)
    g = np.linspace(-0.5, 0.5, n)
    x, z = np.meshgrid(g, -g)
    rest = np.stack([x, np.zeros_like(x), z], axis=2)
    p, v = rest.copy(), np.zeros_like(rest)
    phase = rng.uniform(0, 2 * np.pi, 4)
    frames = np.empty((n_frames, n * n, 3), np.float32)
    sets = list(_constraints(n))
    dt = STEP / N_SUBSTEPS
    for k in range(-30, n_frames):  # a second to fall
        for s in range(N_SUBSTEPS):
            t = (k + s / N_SUBSTEPS) * STEP
            wind = 0.8 * np.array([np.sin(1.3 * t + phase[0]), 0.4 * np.sin(2.1 * t + phase[1]), np.cos(0.9 * t)])
            ripple = 1 + 0.6 * np.sin(9 * x + 3 * t)[..., None]
            v = v * KEPT**dt + dt * (np.array([0, GRAVITY, 0]) + wind * ripple)
            before, p = p, p + dt * v
            ball = np.array([0.22 * np.sin(1.1 * t + phase[2]), -0.33 + 0.2 * np.sin(1.7 * t), 0.22 * np.cos(0.7 * t)])
            held = rest + np.array([0, 0.05 * np.sin(2.3 * t + phase[3]), 0])
            for _ in range(N_SWEEPS):
                for a, b, length, stiffness in sets:
                    d = p[b] - p[a]
                    size = np.linalg.norm(d, axis=2, keepdims=True)
                    move = (0.5 * stiffness) * (size - length / (n - 1)) / np.maximum(size, 1e-9) * d
                    p[a] += move
                    p[b] -= move
                away = p - ball
                size = np.linalg.norm(away, axis=2, keepdims=True)
                p = np.where(size < RADIUS, ball + away * (RADIUS / np.maximum(size, 1e-9)), p)
                for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
                    p[corner] += 0.5 * (0.8 * held[corner] - p[corner])
            v = (p - before) / dt
        if k >= 0:
            frames[k] = p.reshape(-1, 3)
    return Sequence("cloth", grid_faces(n), frames, rest.reshape(-1, 3))


def _constraints(n: int) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice], float, float]]:
    """Pairs of slices of the grid, their distance in cells, and stiffness: edges, diagonals, bends of two cells."""
    for dy, dx, stiffness in ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 0.5), (1, -1, 0.5), (0, 2, 0.3), (2, 0, 0.3)):
        axis, reach = (1, abs(dx)) if dx else (0, dy)
        for start in range(2 * reach if reach == 1 else 4):
            index = np.arange(n - reach)
            chosen = index[(index % (2 * reach)) == start] if start < 2 * reach else index[:0]
            if not len(chosen):
                continue
            along = slice(int(chosen[0]), int(chosen[-1]) + 1, 2 * reach)
            shifted = slice(along.start + reach, along.stop + reach, 2 * reach)
            if axis == 0:
                yield (along, slice(None)), (shifted, slice(None)), float(reach), stiffness
            elif dy == 0:
                yield (slice(None), along), (slice(None), shifted), float(reach), stiffness
            elif dx > 0:
                yield (slice(0, n - 1), along), (slice(1, n), shifted), 2**0.5, stiffness
            else:
                yield (slice(0, n - 1), shifted), (slice(1, n), along), 2**0.5, stiffness
