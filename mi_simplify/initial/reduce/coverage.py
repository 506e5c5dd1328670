"""
What pictures show of each part of a surface, by casting rays, and how much of that another surface still shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.meshes import make_mesh
from ...machine.upload import upload

_AXES = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], float)
DIRECTIONS = _AXES[np.isin((_AXES**2).sum(1), (1, 3))]
"""The pictures are orthographic, from the sides and the corners of a cube, turned a little out of the axes."""

_TURN = np.linalg.qr(np.array([[1, 0.1, 0.17], [-0.1, 1, 0.13], [-0.17, -0.13, 1]]))[0]
_SAME_PLACE = 2.0
"""A surface this close in depth is the same to the eye [pixels of the evaluation]."""


@dataclass(frozen=True)
class Pictures:
    """
    First hits of parallel rays.

    Parameters
    ----------
    label : ndarray, shape (K, S, S), int64
        Part that is seen, -1 where none is.
    depth : ndarray, shape (K, S, S), float32
        Along the view [radii of the box around the asset]; infinite where nothing is seen.
    """

    label: np.ndarray
    depth: np.ndarray


class Coverage:
    """
    How much of a picture each part fills, and what is left of that in a reduced surface.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
    label : ndarray, shape (F,)
        Part of each face, 0 … C - 1.
    solid : ndarray of bool, shape (C,)
        Parts that hide what lies behind them; behind the others it is looked for as well.
    resolution : int
        Side of a picture of the evaluation, in whose pixels areas are measured.
    size : int
        Rays along a side of a picture here.
    """

    def __init__(
        self,
        positions: np.ndarray,
        faces: np.ndarray,
        label: np.ndarray,
        solid: np.ndarray,
        resolution: int = 256,
        size: int = 192,
    ):
        corners = positions[np.unique(faces)]
        low, high = corners.min(0), corners.max(0)
        self._centre, self._radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        self._solid, self._size, self._per_ray = solid, size, (resolution / size) ** 2
        self._tolerance = _SAME_PLACE * 2 / resolution
        self._asset = self._pictures(positions, faces, label)
        self._counts = self._count(self._asset)

    @property
    def pixels(self) -> np.ndarray:
        """Pixels of the evaluation that each part fills in the picture that shows most of it, shape (C,)."""
        return self._counts.max(0) * self._per_ray

    @property
    def share(self) -> np.ndarray:
        """Share of what pictures show of the asset that each part fills, in the mean, shape (C,)."""
        return self._counts.sum(0) / max(1, (self._asset[0].label >= 0).sum())

    def left(self, positions: np.ndarray, faces: np.ndarray, label: np.ndarray) -> np.ndarray:
        """
        Share of each part's pixels that a reduced surface shows, shape (C,): 1 where nothing was to be seen of it.

        A pixel is there where the same part is seen, or any surface at the same depth; a part that is too thin to meet
        its own pixels again counts by its area.
        """
        there, area = np.zeros(len(self._solid)), np.zeros(len(self._solid))
        for old, new in zip(self._asset, self._pictures(positions, faces, label), strict=True):
            seen = old.label >= 0
            near = np.zeros_like(seen)
            near[seen] = np.abs(old.depth[seen] - new.depth[seen]) < self._tolerance
            same = seen & (near | (old.label == new.label))
            there += np.bincount(old.label[same], minlength=len(there))
            area += np.bincount(new.label[new.label >= 0], minlength=len(there))
        total = sum(np.bincount(old.label[old.label >= 0], minlength=len(there)) for old in self._asset)
        kept = np.minimum(np.maximum(there, area), total)
        return np.divide(kept, total, out=np.ones(len(there)), where=total > 0)

    def outline_error(self, positions: np.ndarray, faces: np.ndarray, label: np.ndarray) -> float:
        """
        Pixels that only one of asset and reduced surface covers, over those that either does.
        """
        old, new = self._asset[0].label >= 0, self._pictures(positions, faces, label)[0].label >= 0
        return float((old != new).sum() / max(1, (old | new).sum()))

    def _count(self, pictures: list[Pictures]) -> np.ndarray:
        """Rays that meet each part in each picture, with what is not solid or without, where that is more, (K, C)."""
        n = len(self._solid)
        views = len(DIRECTIONS)
        out = np.zeros((views, n), np.int64)
        for p in pictures:
            view, _, _ = np.nonzero(p.label >= 0)
            out = np.maximum(out, np.bincount(view * n + p.label[p.label >= 0], minlength=views * n).reshape(views, n))
        return out

    def _pictures(self, positions: np.ndarray, faces: np.ndarray, label: np.ndarray) -> list[Pictures]:
        """Of everything, and where something is not solid of the rest alone."""
        points = (positions - self._centre) / self._radius
        pictures = [self._cast(points, faces, label)]
        solid = self._solid[label]
        if not self._solid.all() and self._solid.any():
            pictures.append(self._cast(points, faces[solid], label[solid]))
        return pictures

    def _cast(self, points: np.ndarray, faces: np.ndarray, label: np.ndarray) -> Pictures:
        """Pictures of a surface in the unit ball."""
        size, views = self._size, len(DIRECTIONS)
        shape = (views, size, size)
        if not len(faces):
            return Pictures(np.full(shape, -1), np.full(shape, np.inf, np.float32))
        forward = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True) @ _TURN
        right = np.cross(forward, forward[:, [1, 2, 0]] * [1, -1, 1] + [0.1, 0.2, 0.3])
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        axes = np.stack([right, np.cross(right, forward), forward], 1)  # (K, 3, 3)
        scene = mi.load_dict({"type": "scene", "surface": make_mesh("surface", points, faces)})
        lane = dr.arange(mi.UInt32, views * size * size)
        pixel, view = lane % (size * size), lane // (size * size)
        x = (mi.Float(pixel % size) + 0.5) * (2 / size) - 1
        y = (mi.Float(pixel // size) + 0.5) * (2 / size) - 1
        table = upload(mi.Float, axes.ravel())
        u, v, w = (dr.gather(mi.Vector3f, table, 3 * view + k) for k in range(3))
        hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(u * x + v * y - 2 * w), mi.Vector3f(w)))
        found = hit.is_valid()
        face, depth = dr.select(found, hit.prim_index, 0), dr.select(found, hit.t - 2, dr.inf)
        dr.eval(face, depth, found)
        seen = np.where(found.numpy(), label[face.numpy()], -1)
        return Pictures(seen.reshape(shape), depth.numpy().reshape(shape))
