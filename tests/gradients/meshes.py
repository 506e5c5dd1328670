"""
The meshes of the gradient tests, made by code: each is awkward for visibility gradients in its own way.

All fit the box [-1, 1]³ and come as welded :class:`Mesh`: UV seams split vertices, never positions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mi_simplify.model.mesh import Mesh
from mi_simplify.model.topology import weld


def _mesh(vertices: np.ndarray, uvs: np.ndarray, faces: np.ndarray) -> Mesh:
    positions, index = weld(np.round(np.asarray(vertices, np.float64), 9))
    faces = np.asarray(faces, np.int64)
    p = index[faces]
    faces = faces[(p[:, 0] != p[:, 1]) & (p[:, 1] != p[:, 2]) & (p[:, 2] != p[:, 0])]
    return Mesh(positions, index, np.asarray(uvs, np.float32), faces)


def _grid(n_u: int, n_v: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Rows of a grid of (n_u+1)·(n_v+1) vertices: column, row, and its faces, wound so that ∂u x ∂v points outside.
    """
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n_u + 1), np.arange(n_v + 1)))
    a = (np.arange(n_v)[:, None] * (n_u + 1) + np.arange(n_u)).ravel()
    b, c, d = a + 1, a + n_u + 2, a + n_u + 1
    return i, j, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def sphere(n_u: int = 24, n_v: int = 16, radius: float = 0.9, bump: float = 0.08) -> Mesh:
    """
    Closed and smooth, one chart with a seam from pole to pole; bumps make its silhouette irregular.
    """
    i, j, faces = _grid(n_u, n_v)
    phi, theta = 2 * np.pi * (i % n_u) / n_u, np.pi * j / n_v
    phi = np.where((j == 0) | (j == n_v), 0, phi)  # one pole, not a ring of them
    d = np.stack([np.cos(phi) * np.sin(theta), np.cos(theta), -np.sin(phi) * np.sin(theta)], axis=1)
    r = radius * (1 + bump * np.sin(3 * d[:, 0] + 2) * np.cos(4 * d[:, 1]) + bump * np.sin(5 * d[:, 2] * d[:, 0] + 1))
    return _mesh(d * r[:, None], np.stack([i / n_u, j / n_v], 1), faces[:, ::-1])


def torus(n_u: int = 28, n_v: int = 14, major: float = 0.62, minor: float = 0.3) -> Mesh:
    """
    Closed and concave: seen from the side it hides parts of itself.
    """
    i, j, faces = _grid(n_u, n_v)
    a, b = 2 * np.pi * (i % n_u) / n_u, 2 * np.pi * (j % n_v) / n_v
    r = major + minor * np.cos(b)
    p = np.stack([r * np.cos(a), minor * np.sin(b), -r * np.sin(a)], 1)
    return _mesh(p, np.stack([i / n_u, j / n_v], 1), faces)


def cube(half: float = 0.6) -> Mesh:
    """
    Six charts on eight positions: 24 vertices, every edge is a chart border and a hard one.
    """
    vertices, uvs, faces = [], [], []
    for k in range(6):
        axis, sign = k // 2, 1 - 2 * (k % 2)
        n, s = np.zeros(3), np.zeros(3)
        n[axis], s[(axis + 1) % 3] = sign, 1
        t = np.cross(n, s)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            vertices.append(half * (n + a * s + b * t))
            uvs.append(((k % 3 + 0.5 + 0.4 * a) / 3, (k // 3 + 0.5 + 0.4 * b) / 2))
        faces += [[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]
    return replace(_mesh(np.array(vertices), np.array(uvs), np.array(faces)), normal_index=np.arange(24))


def sheet(n: int = 12) -> Mesh:
    """
    Open and wavy: borders all round, both sides seen, and folds that hide a part of it.
    """
    i, j, faces = _grid(n, n)
    x, y = 1.7 * i / n - 0.85, 1.7 * j / n - 0.85
    z = 0.3 * np.sin(4 * x + 1.5 * y) + 0.1 * np.cos(5 * y)
    return _mesh(np.stack([x, y, z], 1), np.stack([i / n, 1 - j / n], 1), faces)


def tube(sides: int = 6, segments: int = 24, radius: float = 0.03) -> Mesh:
    """
    Closed, long and two pixels thin, slightly bent.
    """
    i, j, faces = _grid(sides, segments + 2)
    a = 2 * np.pi * (i % sides) / sides
    cap = (j == 0) | (j == segments + 2)
    r = np.where(cap, 0.0, radius)
    y = np.clip(j - 1, 0, segments) / segments * 1.9 - 0.95
    x = 0.04 * np.sin(2 * y) + r * np.cos(a)
    z = r * np.sin(a)
    return _mesh(np.stack([x, y, z], 1), np.stack([i / sides, j / (segments + 2)], 1), faces[:, ::-1])


def fin(n: int = 3) -> Mesh:
    """
    Three open sheets that meet in one line: each of its edges has three faces.

    At angles that keep the line's normal away from the sheets' tangents: where they align the tangent flips.
    """
    i, j, faces = _grid(n, n)
    vertices, uvs, all_faces = [], [], []
    for k, angle in enumerate(np.radians([0, 65, 240])):
        r, y = 0.9 * i / n, 1.6 * j / n - 0.8
        vertices.append(np.stack([r * np.cos(angle), y, r * np.sin(angle)], 1))
        uvs.append(np.stack([(k + 0.1 + 0.8 * i / n) / 3, 1 - j / n], 1))
        all_faces.append(faces + k * len(i))
    return _mesh(np.concatenate(vertices), np.concatenate(uvs), np.concatenate(all_faces))


def placed(mesh: Mesh, scale: float, offset, columns: tuple[float, float] = (0.0, 1.0)) -> Mesh:
    """
    The mesh scaled and moved, its UVs squeezed between two columns of the atlas.
    """
    low, high = columns
    uvs = mesh.uvs * np.float32([high - low, 1]) + np.float32([low, 0])
    return replace(mesh, positions=mesh.positions * scale + np.asarray(offset), uvs=uvs)


def joined(pieces: tuple[Mesh, ...]) -> Mesh:
    """
    Several meshes as one, positions behind each other; pieces that touch are not welded.
    """
    if len(pieces) == 1:
        return pieces[0]
    n_p = np.cumsum([0] + [len(m.positions) for m in pieces[:-1]])
    n_v = np.cumsum([0] + [len(m.uvs) for m in pieces[:-1]])
    return Mesh(
        np.concatenate([m.positions for m in pieces]),
        np.concatenate([m.position_index + o for m, o in zip(pieces, n_p, strict=True)]),
        np.concatenate([m.uvs for m in pieces]),
        np.concatenate([m.faces + o for m, o in zip(pieces, n_v, strict=True)]),
    )
