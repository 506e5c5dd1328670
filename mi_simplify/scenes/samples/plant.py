"""
Two plants of over a million triangles, a flowering shrub and a fern, put together from few parts by a tree of nodes.

Stems bear twigs (fronds), twigs bear leaves (pinnae) and flowers. Twigs of one kind are copies of each other, turned
and scaled, as in the scene descriptions of films; all random numbers come from one seed.
"""

from __future__ import annotations

import numpy as np

from ...model.asset import Asset, Instance, Part
from .parametric import unit
from .plant_parts import flower, leaf, pinna, stalk

#: About how many triangles the plants have in full.
FULL = {"shrub": 1_250_000, "fern": 1_650_000}

_GOLDEN = np.pi * (3 - 5**0.5)


def plant(species: str, share: float = 1.0) -> Asset:
    """
    A plant about two units high, Y up.

    Parameters
    ----------
    species : {'shrub', 'fern'}
    share : float
        Of the full number of triangles, about: fewer leaves, and fewer triangles a leaf.
    """
    detail = share**0.25  # of leaves a twig, of twigs, and of the two sides of a leaf's grid
    builder = _Builder()
    (_shrub if species == "shrub" else _fern)(builder, np.random.default_rng(7), detail)
    return Asset(tuple(builder.parts), tuple(builder.instances), name=species)


class _Builder:
    """Parts, and where they stand in a tree of nodes."""

    def __init__(self) -> None:
        self.parts: list[Part] = []
        self.instances: list[Instance] = []

    def part(self, part: Part) -> int:
        self.parts.append(part)
        return len(self.parts) - 1

    def put(self, module: list[tuple[int, np.ndarray]], to_world: np.ndarray, node: str) -> None:
        """One copy of a twig: all its parts, below a node of their own."""
        for k, (part, local) in enumerate(module):
            self.instances.append(Instance(part, to_world @ local, f"{self.parts[part].name}_{k}", node))


def _frame(origin, along, up, size: float = 1.0) -> np.ndarray:
    """The transform of a part that grows from a point in a direction, its upper side towards ``up``."""
    y = unit(np.asarray(along, float))
    z = unit(np.asarray(up, float) - y * np.dot(up, y))
    out = np.eye(4)
    out[:3, :3] = np.stack([np.cross(y, z), y, z], 1) * size
    out[:3, 3] = origin
    return out


def _jittered(direction: np.ndarray, rng: np.random.Generator, amount: float) -> np.ndarray:
    return unit(direction + amount * rng.normal(size=3))


def _shrub(builder: _Builder, rng: np.random.Generator, detail: float) -> None:
    """Stems from the ground, twigs all around them, leaves in a spiral, flowers near the ends."""
    leaves = [builder.part(leaf(k, detail)) for k in range(4)]
    flowers = [builder.part(flower(k, detail)) for k in range(2)]
    twigs = []
    for k in range(4):
        bend = rng.normal(size=3) * 0.12
        knots = np.array([[0, 0, 0], [0.03, 0.33, 0.05], [0.1, 0.66, 0.02], [0.12, 1.0, 0.1]])
        knots += np.outer([0, 0, 1, 2], bend)
        part, curve = stalk(f"twig_{k}", knots, 0.022, 0.25, detail)
        module = [(builder.part(part), np.eye(4))]
        n = max(4, round(44 * detail))
        for i in range(n):
            s = 0.12 + 0.86 * (i + 0.5) / n
            point, tangent, normal, binormal = curve.frame(s)
            a = i * _GOLDEN + rng.normal() * 0.25
            out = np.cos(a) * normal + np.sin(a) * binormal
            along = _jittered(out + 0.55 * tangent, rng, 0.22)
            up = _jittered(tangent + np.array([0, 0.6, 0]), rng, 0.25)
            size = 0.34 * (1 - 0.45 * s) * np.exp(rng.normal() * 0.16) / detail
            age = int(np.clip(round(3 * (1 - s) + rng.normal() * 0.7), 0, 3))
            module.append((leaves[age], _frame(point, along, up, size)))
        if k != 3:
            point, tangent, *_ = curve.frame(1.0)
            module.append((flowers[k % 2], _frame(point, [1, 0.2, 0.1], _jittered(tangent, rng, 0.2), 0.2)))
        twigs.append(module)
    for k in range(7):
        a = 2 * np.pi * k / 7 + rng.normal() * 0.2
        lean = np.array([np.cos(a), 0, np.sin(a)])
        reach = 0.35 + 0.4 * rng.random()
        tall = 1.5 - 0.5 * reach + 0.15 * rng.normal()
        knots = np.array([lean * 0.04, lean * 0.3 * reach + [0, 0.4 * tall, 0], lean * reach + [0, tall, 0]])
        part, curve = stalk(f"stem_{k}", knots, 0.035, 0.4, detail, (10, 60))
        stem = f"shrub/stem_{k}"
        builder.put([(builder.part(part), np.eye(4))], np.eye(4), stem)
        n = max(3, round(9 * detail))
        for j in range(n):
            s = 0.22 + 0.78 * (j + 0.7) / n
            point, tangent, normal, binormal = curve.frame(s)
            b = j * _GOLDEN + k
            out = np.cos(b) * normal + np.sin(b) * binormal
            along = _jittered(0.9 * out + 0.8 * tangent + 0.3 * lean, rng, 0.15)
            up = _jittered(np.array([0.2, 1, 0.1]), rng, 0.3)
            frame = _frame(point, along, up, 0.62 * np.exp(rng.normal() * 0.12))
            builder.put(twigs[int(rng.integers(4))], frame, f"{stem}/twig_{j}")


def _fern(builder: _Builder, rng: np.random.Generator, detail: float) -> None:
    """Arching fronds from one crown, each with two rows of lobed pinnae."""
    pinnae = [builder.part(pinna(k, detail)) for k in range(3)]
    fronds = []
    for k in range(3):
        sag = 0.25 + 0.22 * k
        y = np.linspace(0, 1, 5)
        knots = np.stack([0.03 * np.sin(5 * y + k), y * (1 - 0.2 * sag * y), sag * y**2.2], 1)  # its upper side is -Z
        part, curve = stalk(f"rachis_{k}", knots, 0.014, 0.2, detail, (6, 40))
        module = [(builder.part(part), np.eye(4))]
        n = max(4, round(27 * detail))
        for i in range(2 * n):
            s = 0.14 + 0.85 * (i // 2 + 0.5 * (i % 2)) / n
            point, tangent, *_ = curve.frame(s)
            side = 1 if i % 2 else -1
            up = unit(np.cross(tangent, [1.0, 0, 0]))
            up = up if up[2] < 0 else -up
            along = _jittered(np.array([side, 0, 0]) + 0.42 * tangent - 0.12 * up, rng, 0.1)
            size = 0.46 * np.sin(np.pi * np.clip(0.16 + 0.82 * s, 0, 1) ** 0.8) ** 0.9 * np.exp(rng.normal() * 0.07)
            kind = int(np.clip(round(3 * s - 0.5 + rng.normal() * 0.4), 0, 2))
            module.append((pinnae[kind], _frame(point, along, _jittered(up, rng, 0.22), size + 0.03)))
        fronds.append(module)
    n = max(5, round(58 * detail))
    for j in range(n):
        a = j * _GOLDEN + rng.normal() * 0.1
        s = (j + 0.5) / n  # the inner ones stand, the outer ones lie
        out = np.array([np.cos(a), 0, np.sin(a)])
        along = _jittered(out * (0.25 + 1.1 * s) + np.array([0, 1.15 - 0.75 * s, 0]), rng, 0.07)
        up = np.array([0, 1.0, 0]) - 0.9 * out
        frame = _frame(0.05 * out * s, along, -up, (0.75 + 0.6 * s) * np.exp(rng.normal() * 0.1))
        builder.put(fronds[int(rng.integers(3))], frame, f"fern/frond_{j}")
