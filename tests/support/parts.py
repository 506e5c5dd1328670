"""Parts and assets to bake from: sheets, plain paint, leaves."""

import numpy as np

from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.model.mesh import Mesh

QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
QUAD_UV = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
LOW = Mesh(QUAD, np.arange(4), QUAD_UV, FACES)


def asset_of(*parts: Part) -> Asset:
    return Asset(parts, tuple(Instance(k) for k in range(len(parts))))


def painted(rgb, roughness=0.5, metallic=0.0, **more) -> Material:
    return Material("m", np.float32([[[*rgb, 1]]]), np.float32([[[0, roughness, metallic]]]), **more)


def grid(n, height=lambda x, y: 0 * x):
    """A sheet of 2·n² triangles over [-1, 1]², up along z."""
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-1, 1, n + 1)] * 2, indexing="ij"))
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    f = np.concatenate([np.stack([a, a + n + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + 1], 1)])
    return np.stack([x, y, height(x, y)], 1), f


def turned(rng) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.linalg.det(q)


def leaves(n: int, seed: int = 0, nodes: int = 1, color=(0.2, 0.5, 0.1)) -> Asset:
    """Separate flat pointed leaves of 16 triangles each, anywhere in a box, turned anyhow."""
    rng = np.random.default_rng(seed)
    y = np.linspace(0, 1, 9)
    w = 0.2 * np.sin(np.pi * y) + 0.01
    vertices = np.stack([np.concatenate([-w, w]), np.tile(y, 2), np.zeros(18)], 1) * 0.3
    k = np.arange(8)
    faces = np.concatenate([np.stack([k, k + 9, k + 10], 1), np.stack([k, k + 10, k + 1], 1)])
    uvs = np.stack([vertices[:, 0] + 0.5, 1 - y[np.r_[0:9, 0:9]]], 1).astype(np.float32)
    material = Material("leaf", np.float32([[[*color, 1]]]), np.float32([[[0, 0.8, 0]]]))
    part = Part(vertices, faces, uvs=uvs, material=material, name="leaf")
    instances = []
    for i in range(n):
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = turned(rng), rng.uniform(-1, 1, 3)
        instances.append(Instance(0, m, f"leaf_{i}", f"plant/twig_{i % nodes}"))
    return Asset((part,), tuple(instances), name="leaves")
