"""
An engine of many parts, and balls in space: assemblies from whose pictures a part can get lost.
"""

import numpy as np

from mi_simplify.initial.sphere import sphere
from mi_simplify.model.asset import Asset, Instance, Material, Part


def turned_body(profile, n, wave=lambda angle: 1 + 0 * angle):
    """
    A closed body around the y axis: ``profile`` (M, 2) of radius and height from pole to pole, or closed, upwards
    outside; ``wave`` scales the radius by the angle.
    """
    profile = np.asarray(profile, float)
    ring = bool(profile[0, 0])  # no pole: the profile is closed
    angle = 2 * np.pi * np.arange(n) / n
    r = profile[:, :1] * wave(angle)
    p = np.stack([r * np.cos(angle), np.broadcast_to(profile[:, 1:], r.shape), -r * np.sin(angle)], -1)
    k = np.arange(p.shape[0] * n).reshape(-1, n)
    rows = np.concatenate([k, k[:1]]) if ring else k
    a, b = rows[:-1], np.roll(rows[:-1], -1, axis=1)
    d, c = rows[1:], np.roll(rows[1:], -1, axis=1)
    f = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    p = p.reshape(-1, 3)
    if not ring:  # one position a pole
        f = np.where(f < n, 0, np.where(f >= len(p) - n, len(p) - 1, f))
        f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
        used, f = np.unique(f, return_inverse=True)
        p, f = p[used], f.reshape(-1, 3)
    return p, f


def refined(profile, step):
    """The profile with points at most ``step`` apart."""
    profile = np.asarray(profile, float)
    out = [profile[:1]]
    for a, b in zip(profile[:-1], profile[1:], strict=True):
        n = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        out.append(a + (b - a) * (np.arange(1, n + 1) / n)[:, None])
    return np.concatenate(out)


def engine(detail: float = 1.0, bolts: int = 80) -> Asset:
    """
    Casing, two finned cylinders, two gears, a piston that nobody sees in each cylinder, and bolts around the casing.

    About 115,000 triangles at a detail of 1, a share of ``detail``² of that with less.
    """

    def n(count):
        return max(8, int(round(count * detail)))

    step = 0.02 / detail
    fins = [[0, 0], [0.45, 0]]
    for k in range(8):
        y = 0.1 + 0.1 * k
        fins += [[0.45, y], [0.6, y], [0.6, y + 0.04], [0.45, y + 0.04]]
    fins += [[0.45, 1], [0, 1]]
    cylinder = turned_body(refined(fins, step), n(140))
    hollow = turned_body(refined([[0, 0], [0.25, 0], [0.25, 0.5], [0, 0.5]], step), n(120))
    gear_profile = [[0.1, 0], [0.5, 0], [0.5, 0.12], [0.1, 0.12], [0.1, 0]]
    gear = turned_body(refined(gear_profile, step)[:-1], n(288), lambda t: 1 + 0.08 * np.tanh(4 * np.sin(24 * t)))
    box = [[0, 0], [1.1, 0], [1.1, 0.6], [0, 0.6]]
    casing = turned_body(
        refined(box, step), n(400), lambda t: 1 / (np.abs(np.cos(t)) ** 8 + np.abs(np.sin(t)) ** 8) ** 0.125
    )
    head = [[0, 0], [0.02, 0], [0.02, 0.04], [0.045, 0.04], [0.045, 0.075], [0, 0.075]]
    bolt = turned_body(refined(head, 0.02 / detail), n(24))
    parts, instances = [], []

    def add(name, body, color, *places):
        parts.append(Part(*body, material=Material(name, np.float32([[[*color, 1]]])), name=name))
        for k, place in enumerate(places):
            m = np.eye(4)
            m[:3, :3] = place[1] if len(place) == 2 else np.eye(3)
            m[:3, 3] = place[0] if len(place) == 2 else place
            instances.append(Instance(len(parts) - 1, m, f"{name} {k + 1}"))

    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # the axis y becomes -z
    add("casing", casing, (0.5, 0.5, 0.55), (0, 0, 0))
    add("cylinder", cylinder, (0.6, 0.2, 0.1), (-0.62, 0.61, 0), (0.62, 0.61, 0))
    add("piston", hollow, (0.8, 0.8, 0.8), (-0.62, 0.85, 0), (0.62, 0.85, 0))
    add("gear", gear, (0.7, 0.6, 0.2), ((-0.55, 0.3, 1.25), upright), ((0.55, 0.3, 1.25), upright))
    angle = 2 * np.pi * np.arange(bolts) / max(bolts, 1)
    side = np.stack([np.cos(angle), np.sin(angle)], 1)
    side *= (1.02 / np.abs(side).max(1))[:, None]
    add("bolt", bolt, (0.2, 0.2, 0.25), *np.stack([side[:, 0], np.full(bolts, 0.61), side[:, 1]], 1))
    return Asset(tuple(parts), tuple(instances), name="engine")


def balls(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Separate balls of random sizes and resolutions on a lattice: positions, faces, centres (N, 3) and radii (N,).
    """
    side = int(np.ceil(count ** (1 / 3)))
    cells = rng.permutation(side**3)[:count]
    centres = np.stack([cells % side, cells // side % side, cells // side**2], 1).astype(float)
    radii = 0.45 * rng.random(count) ** 2 + 0.005
    shapes = [sphere(int(k)) for k in rng.integers(8, 120, count)]
    starts = np.cumsum([0] + [len(p) for p, _ in shapes[:-1]])
    positions = np.concatenate([p * r + c for (p, _), r, c in zip(shapes, radii, centres, strict=True)])
    return positions, np.concatenate([f + s for (_, f), s in zip(shapes, starts, strict=True)]), centres, radii
