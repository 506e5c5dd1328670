"""
What could be there, to judge by the outlines in some images: the visual hull (Laurentini 1994) as a mesh.
"""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import AssetError
from ..formats.captured.read import Captured
from ..machine.upload import upload
from ..model.asset import Asset, Instance, Material, Part
from ..model.marching_cubes import marching_cubes
from ..scenes.references.images import squared

#: Side of the masks that are projected [px].
_MASK = 256

#: What a hull that touches nothing of the outlines may lose to noise and to cameras that are a little off.
_MISSES = 0.02


def visual_hull(captured: Captured, resolution: int, color: np.ndarray) -> Asset:
    """
    Everything that all images show as covered, as a mesh of one colour.

    Parameters
    ----------
    captured : Captured
    resolution : int
        Cells along its longest side.
    color : ndarray, shape (3,)
        Its base colour, linear.

    Raises
    ------
    AssetError
        The outlines have nothing in common, so cameras and images do not fit together; or a camera is inside.
    """
    masks = _Masks(captured)
    box = masks.first_box()
    for _ in range(3):
        cell = (box[1] - box[0]) / 64
        points = _lattice(box[0], cell, [65] * 3)
        found = points[masks.coverage(points) > 0.5 - _MISSES]
        if not len(found):
            raise AssetError(
                f"{captured.source}: nothing is covered in all images; their cameras do not fit them, or the object "
                "leaves them (is 'up' right, are matrices camera-to-world?)"
            )
        box = np.stack([found.min(0) - cell, found.max(0) + cell])
    cell = float((box[1] - box[0]).max()) / resolution
    low = box[0] - cell
    counts = np.ceil((box[1] - box[0]) / cell).astype(int) + 3
    grid = 0.5 - masks.coverage(_lattice(low, np.full(3, cell), counts)).reshape(counts)
    for axis in range(3):  # closed at the border of the grid
        grid[(slice(None),) * axis + ([0, -1],)] = 0.5
    name = Path(captured.source).absolute().parent.name
    positions, faces = marching_cubes(grid, low, [cell] * 3, name)
    inside = masks.coverage(captured.to_world[:, :3, 3]) > 0.5
    if inside.any():
        k = int(np.flatnonzero(inside)[0])
        raise AssetError(f"{captured.source}: the camera of '{captured.names[k]}' is inside the object; leave it out")
    base = np.ones((1, 1, 4), np.float32)
    base[0, 0, :3] = np.clip(color, 0.02, 0.95)
    material = Material(name, base, np.array([[[0, 0.6, 0]]], np.float32))
    part = Part(positions, faces, material=material, name=name)
    return Asset((part,), (Instance(0, name=name),), name=name)


def mean_color(captured: Captured) -> np.ndarray:
    """
    Mean radiance where the images are covered, shape (3,).
    """
    sums = np.sum([image.astype(np.float64).sum((0, 1)) for image in captured.images], axis=0)
    return sums[:3] / max(sums[3], 1e-9)


def _lattice(low: np.ndarray, cell: np.ndarray, counts) -> np.ndarray:
    """Points of a lattice, shape (N, 3), x slowest."""
    return np.stack(np.meshgrid(*(np.arange(c) for c in counts), indexing="ij"), -1).reshape(-1, 3) * cell + low


class _Masks:
    """Coverage of all images as one array on the device, and the cameras in front of it."""

    def __init__(self, captured: Captured):
        self._captured = captured
        self.n = len(captured)
        sizes = np.array([image.shape[1::-1] for image in captured.images], np.float64)
        tan = (np.maximum(captured.center, sizes - captured.center) / captured.focal).max(1)
        masks = [
            squared(image[..., 3:], captured.focal[k], captured.center[k], float(tan[k]), _MASK)
            for k, image in enumerate(captured.images)
        ]
        self._masks = upload(mi.Float, np.nan_to_num(np.stack(masks), nan=-1.0).ravel())
        self._tan = tan
        rotation = captured.to_world[:, :3, :3]
        packets = np.zeros((self.n, 4, 4), np.float32)
        packets[:, 0, :3], packets[:, 0, 3] = captured.to_world[:, :3, 3], 1 / tan
        packets[:, 1, :3], packets[:, 2, :3], packets[:, 3, :3] = rotation[..., 0], rotation[..., 1], -rotation[..., 2]
        self._cameras = upload(mi.Float, packets.ravel())

    def first_box(self) -> np.ndarray:
        """A cube around where the cameras look, within their fields of view."""
        origin, forward = self._captured.to_world[:, :3, 3], -self._captured.to_world[:, :3, 2]
        project = np.eye(3) - forward[:, :, None] * forward[:, None]
        center = np.linalg.lstsq(project.sum(0), (project @ origin[..., None]).sum(0)[:, 0], rcond=None)[0]
        reach = np.linalg.norm(origin - center, axis=1)
        half = float(np.max(reach * np.minimum(self._tan, 1.0))) or 1.0
        return np.stack([center - half, center + half])

    def coverage(self, points: np.ndarray) -> np.ndarray:
        """
        Least coverage of points, shape (N, 3), over the images that show them; 0 where less than half of them do.
        """
        p = upload(mi.Point3f, points)
        masks, cameras, n = self._masks, self._cameras, self.n

        def step(k, least, seen):
            a, b, c, d = (dr.gather(mi.Vector4f, cameras, k * 4 + row) for row in range(4))
            local = p - mi.Point3f(a.xyz)
            z = dr.dot(local, d.xyz)
            x, y = dr.dot(local, b.xyz) * a.w / z, -dr.dot(local, c.xyz) * a.w / z
            x, y = dr.fma(x, 0.5, 0.5) * _MASK - 0.5, dr.fma(y, 0.5, 0.5) * _MASK - 0.5
            shown = (z > 0) & (x > 0) & (y > 0) & (x < _MASK - 1) & (y < _MASK - 1)
            ix, iy = mi.UInt32(dr.select(shown, x, 0)), mi.UInt32(dr.select(shown, y, 0))
            at = (k * _MASK + iy) * _MASK + ix
            fx, fy = x - dr.floor(x), y - dr.floor(y)
            q = [dr.gather(mi.Float, masks, at + o, shown) for o in (0, 1, _MASK, _MASK + 1)]
            value = dr.lerp(dr.lerp(q[0], q[1], fx), dr.lerp(q[2], q[3], fx), fy)
            shown &= dr.minimum(dr.minimum(q[0], q[1]), dr.minimum(q[2], q[3])) >= 0
            least = dr.select(shown, dr.minimum(least, value), least)
            return k + 1, least, seen + dr.select(shown, mi.UInt32(1), 0)

        start = (dr.zeros(mi.UInt32, len(points)), dr.full(mi.Float, 1, len(points)), dr.zeros(mi.UInt32, len(points)))
        _, least, seen = dr.while_loop(start, lambda k, least, seen: k < n, step, labels=("k", "least", "seen"))
        return dr.select(2 * seen >= n, least, 0).numpy()
