"""Small meshes that several tests are made on."""

import numpy as np

from mi_simplify.model.mesh import Mesh
from mi_simplify.model.topology import weld

#: How a chart lies in its cell of the atlas: maps (a, b) in [0, 1]², a x b outwards, to (u, v).
LAYS = (
    lambda a, b: (a, 1 - b),  # upright
    lambda a, b: (1 - a, 1 - b),  # mirrored
    lambda a, b: (b, a),  # turned by a quarter
    lambda a, b: (np.abs(2 * a - 1), 1 - b),  # folded: two halves share their texture along the middle
    lambda a, b: (a, b),  # upside down, so mirrored too
    lambda a, b: (1 - a, b),  # turned by a half
)


def charted_sphere(n: int, noise: float = 0.0, seed: int = 0) -> Mesh:
    """
    Closed unit sphere of 12 n² triangles from the six sides of a cube, a chart each, in every way a chart can lie.

    Parameters
    ----------
    n : int
        Even, so that the fold runs along edges.
    noise : float
        Random displacement of the welded positions.
    """
    a, b = (g.ravel() for g in np.meshgrid(*[np.arange(n + 1) / n] * 2, indexing="ij"))
    grid = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    c00, c10, c11, c01 = (g.ravel() for g in (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]))
    quads = np.concatenate([np.stack([c00, c10, c11], 1), np.stack([c00, c11, c01], 1)])
    vertices, uvs, faces = [], [], []
    for k, lay in enumerate(LAYS):
        side = 1 - 2 * (k % 2)
        x, y, z = np.roll(np.eye(3), k // 2, axis=0)
        x = x * side  # keeps (x, y, outward) right-handed
        cube = x * (2 * a - 1)[:, None] + y * (2 * b - 1)[:, None] + side * z
        vertices.append(np.round(cube, 9))
        u, v = lay(a, b)
        uvs.append(np.stack([(0.05 + 0.9 * u + k % 3) / 3, (0.05 + 0.9 * v + k // 3) / 2], 1))
        faces.append(quads + k * len(a))
    positions, index = weld(np.concatenate(vertices))
    positions = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    positions = positions + noise * np.random.default_rng(seed).normal(size=positions.shape)
    return Mesh(positions, index, np.concatenate(uvs).astype(np.float32), np.concatenate(faces).astype(np.int64))
