"""
Per-vertex tangents of a mesh in plain NumPy: the one convention of bake, fit and export.

UV origin top left. ``t`` points along +u on the surface (∂p/∂u), ``w * cross(n, t)`` points *up* the image
(-∂p/∂v), which is the green of a normal map. ``w`` is +1 where the chart, seen with v up, is not mirrored.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .mesh import Mesh


def face_tangents(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """
    Direction of growing u on every face, and the handedness of its texture.

    Returns
    -------
    tangents : ndarray, shape (F, 3), float64
        Unit ∂p/∂u; zero where the face has no area in UV space.
    sign : ndarray, shape (F,), int8
        +1, -1 where the texture is mirrored, 0 where the face has no area in UV space.
    """
    p = mesh.vertices[mesh.faces]
    uv = mesh.uvs[mesh.faces].astype(np.float64)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    sign = -np.sign(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])  # v grows downwards
    t = -sign[:, None] * (d2[:, 1:] * e1 - d1[:, 1:] * e2)
    length = np.linalg.norm(t, axis=1, keepdims=True)
    return np.divide(t, length, out=np.zeros_like(t), where=length > 0), sign.astype(np.int8)


def vertex_tangents(mesh: Mesh, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Tangents as MikkTSpace makes them (Mikkelsen 2008): face tangents in the plane of the vertex normal, by angle.

    Parameters
    ----------
    normals : ndarray, shape (G, 3)
        Unit normals as ``mesh.normals()`` gives them.

    Returns
    -------
    tangents : ndarray, shape (V, 3), float64
        Unit vectors perpendicular to the normal of their vertex.
    w : ndarray, shape (V,), float64
        +1 or -1; where faces of both signs meet in one vertex the larger angle wins (see :func:`split_mirrored`).
    """
    n_vertices, faces = len(mesh.uvs), mesh.faces
    flat, sign = face_tangents(mesh)
    n = np.asarray(normals, np.float64)[mesh.normal_groups]
    corner_n = n[faces]  # (F, 3, 3)

    def in_plane(x: np.ndarray) -> np.ndarray:
        x = x - corner_n * np.einsum("fci,fci->fc", x, corner_n)[..., None]
        length = np.linalg.norm(x, axis=2, keepdims=True)
        return np.divide(x, length, out=np.zeros_like(x), where=length > 1e-20)

    p = mesh.vertices[faces]
    a, b = in_plane(np.roll(p, -1, axis=1) - p), in_plane(np.roll(p, 1, axis=1) - p)
    angle = np.arccos(np.clip(np.einsum("fci,fci->fc", a, b), -1, 1)) * (sign != 0)[:, None]

    turn = np.bincount(faces.ravel(), (angle * sign[:, None]).ravel(), n_vertices)
    w = np.where(turn < 0, -1.0, 1.0)
    angle = angle * (sign[:, None] == w[faces])
    weighted = in_plane(np.repeat(flat[:, None], 3, axis=1)) * angle[..., None]
    t = np.stack([np.bincount(faces.ravel(), weighted[..., i].ravel(), n_vertices) for i in range(3)], axis=1)

    lost = np.linalg.norm(t, axis=1) < 1e-12  # no face with UV area, or tangents that cancel
    helper = np.eye(3)[np.argmin(np.abs(n[lost]), axis=1)]
    t[lost] = np.cross(helper, n[lost])
    t -= n * np.einsum("vi,vi->v", t, n)[:, None]
    return t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-20), w


def split_mirrored(mesh: Mesh) -> Mesh:
    """
    Double the vertices in which a mirrored and an unmirrored face meet, so that ``w`` is one per vertex.

    The welded positions stay as they are; a mesh without such vertices is returned unchanged.
    """
    _, sign = face_tangents(mesh)
    has = np.zeros((2, len(mesh.uvs)), bool)
    for row, s in enumerate((1, -1)):
        has[row, mesh.faces[sign == s].ravel()] = True
    mixed = np.flatnonzero(has.all(0))
    if not len(mixed):
        return mesh
    twin = np.arange(len(mesh.uvs))
    twin[mixed] = len(mesh.uvs) + np.arange(len(mixed))
    faces = np.where((sign == -1)[:, None], twin[mesh.faces], mesh.faces)
    groups = mesh.normal_index
    return replace(
        mesh,
        position_index=np.concatenate([mesh.position_index, mesh.position_index[mixed]]),
        normal_index=None if groups is None else np.concatenate([groups, groups[mixed]]),
        uvs=np.concatenate([mesh.uvs, mesh.uvs[mixed]]),
        faces=faces,
    )
