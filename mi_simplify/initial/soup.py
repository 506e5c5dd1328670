"""
All triangles of an asset in one place, with what its textures are looked up by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import MeshError
from ..model.asset import Asset, Material
from ..model.topology import vertex_normals, weld


@dataclass(frozen=True)
class Soup:
    """
    All triangles of an asset in world space, with everything that a baker looks up.

    Parameters
    ----------
    positions : ndarray, shape (P, 3), float64
        Welded positions [world units].
    position_index : ndarray, shape (V,), int64
        Position of each vertex.
    faces : ndarray, shape (F, 3), int64
        Counter-clockwise *vertex* indices.
    uvs : ndarray, shape (V, 2), float32
        Texture coordinates, origin top left; zero where the part has none.
    normals : ndarray, shape (V, 3), float32
        Unit shading normals: the file's, or angle-weighted over welded positions where it has none.
    colors : ndarray, shape (V, 4), float32
        Linear vertex colour and opacity; one where the part has none.
    has_normals : ndarray, shape (V,), bool
        Whether the normal is the file's.
    material_index : ndarray, shape (F,), int64
        Index into ``materials``.
    materials : tuple of Material
    part_index : ndarray, shape (F,), int64
        Index into ``names``.
    names : tuple of str
        Of the instances.
    more_uvs : ndarray, shape (V, 2 K), float32
        Further texture coordinates side by side, as many as any part has.
    """

    positions: np.ndarray
    position_index: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    has_normals: np.ndarray
    material_index: np.ndarray
    materials: tuple[Material, ...]
    part_index: np.ndarray
    names: tuple[str, ...]
    more_uvs: np.ndarray

    @property
    def vertices(self) -> np.ndarray:
        """Positions per vertex, shape (V, 3)."""
        return self.positions[self.position_index]

    @property
    def position_faces(self) -> np.ndarray:
        """Faces over welded positions, shape (F, 3)."""
        return self.position_index[self.faces]

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal over referenced positions [world units]."""
        used = self.positions[np.unique(self.position_faces)]
        return float(np.linalg.norm(np.ptp(used, axis=0))) if len(used) else 0.0


def merge(asset: Asset) -> Soup:
    """
    All instances of an asset as one world-space triangle set, equal coordinates welded, nothing dropped.

    Raises
    ------
    MeshError
        The asset has no triangles.
    """
    parts = [p for p in asset.placed() if len(p.faces)]
    if not parts:
        raise MeshError(f"{asset.name}: no triangles to simplify; check that the file holds a mesh")
    materials: list[Material] = []
    uvs, normals, colors, has_normals, faces, vertices, material_index = [], [], [], [], [], [], []
    start, n_more = 0, max(len(part.more_uvs) for part in parts)
    more_uvs = []
    for part in parts:
        n = len(part.vertices)
        known = [i for i, m in enumerate(materials) if m is part.material]
        if not known:
            materials.append(part.material)
        material_index.append(np.full(len(part.faces), known[0] if known else len(materials) - 1))
        vertices.append(np.asarray(part.vertices, np.float64))
        faces.append(np.asarray(part.faces, np.int64) + start)
        uvs.append(np.zeros((n, 2), np.float32) if part.uvs is None else np.float32(part.uvs))
        missing = np.zeros((n, 2 * (n_more - len(part.more_uvs))), np.float32)
        more_uvs.append(np.concatenate([*part.more_uvs, missing], axis=1))
        colors.append(np.ones((n, 4), np.float32) if part.colors is None else np.float32(part.colors))
        has_normals.append(np.full(n, part.normals is not None))
        if part.normals is None:
            p, index = weld(vertices[-1])
            normals.append(vertex_normals(p, index[part.faces])[index].astype(np.float32))
        else:
            normals.append(np.float32(part.normals))
        start += n
    positions, position_index = weld(np.concatenate(vertices))
    return Soup(
        positions=positions,
        position_index=position_index,
        faces=np.concatenate(faces),
        uvs=np.concatenate(uvs),
        normals=np.concatenate(normals),
        colors=np.concatenate(colors),
        has_normals=np.concatenate(has_normals),
        material_index=np.concatenate(material_index),
        materials=tuple(materials),
        part_index=np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts]),
        names=tuple(p.name or f"part {k}" for k, p in enumerate(parts)),
        more_uvs=np.concatenate(more_uvs),
    )
