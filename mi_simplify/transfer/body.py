"""
An asset as one surface that follows its clip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.asset import Asset
from ..scenes.shapes import part_normals


@dataclass(frozen=True)
class Body:
    """
    All parts of an asset, one after the other.

    Parameters
    ----------
    asset : Asset
    faces : ndarray, shape (F, 3), int64
    uvs : ndarray, shape (V, 2), float32, or None
        Origin top left; None where a part has none.
    """

    asset: Asset
    faces: np.ndarray
    uvs: np.ndarray | None

    @classmethod
    def of(cls, asset: Asset) -> Body:
        """
        The body of an asset with or without a rig.
        """
        parts = asset.placed()
        starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
        uvs = [p.uvs for p in parts if p.uvs is not None]
        faces = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)])
        return cls(asset, faces, np.concatenate(uvs) if len(uvs) == len(parts) else None)

    @property
    def n_frames(self) -> int:
        """Of its clip; 1 without one."""
        return 1 if self.asset.rig is None else self.asset.rig.n_frames

    def posed(self, frame: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Positions and unit shading normals, shape (V, 3) each, in a frame of the clip, which may have a fraction; -1 is
        the bind pose.
        """
        parts = self.asset.posed(frame).placed()
        normals = np.concatenate([part_normals(p) for p in parts])
        return np.concatenate([p.vertices for p in parts]), _unit(normals)


@dataclass(frozen=True)
class Places:
    """
    Points on a surface, which move with it.

    Parameters
    ----------
    corners : ndarray, shape (N, 3), int64
        Vertices of the triangle of each.
    weights : ndarray, shape (N, 3)
        Barycentric coordinates.
    """

    corners: np.ndarray
    weights: np.ndarray

    def of(self, values: np.ndarray) -> np.ndarray:
        """
        Values (V, C) of the vertices, interpolated: (N, C).
        """
        return np.einsum("nj,njc->nc", self.weights, values[self.corners])

    def posed(self, body: Body, frame: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Positions of the whole body, shape (V, 3), and points and unit normals of the places, shape (N, 3) each.
        """
        positions, normals = body.posed(frame)
        return positions, self.of(positions), _unit(self.of(normals))


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-20)
