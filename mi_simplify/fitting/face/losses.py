"""
What images say of a shape besides their colours: where landmarks are, and how far away every pixel is.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...integrators.camera import Cameras
from ...integrators.gbuffer import fragment, trace
from ...latent.surface import Surface
from ...machine.meshes import MISS
from ...machine.upload import upload


class LandmarkLoss:
    """
    Mean L1 distance of landmarks from where images show them [halves of the film's side].

    Parameters
    ----------
    index : ndarray, shape (L,)
        Their positions in the mesh.
    seen : ndarray, shape (B, L, 2)
        Film positions [pixels].
    """

    def __init__(self, index: np.ndarray, seen: np.ndarray):
        n_views, n = seen.shape[:2]
        self._position = upload(mi.UInt32, np.tile(index, n_views))
        self._view = upload(mi.UInt32, np.repeat(np.arange(n_views), n))
        self._seen = upload(mi.Point2f, seen.reshape(-1, 2))

    def __call__(self, positions: mi.Float, cameras: Cameras) -> mi.Float:
        """Width 1; differentiable in positions, flat, and cameras."""
        at = cameras.project(self._view, dr.gather(mi.Point3f, positions, self._position))
        off = dr.abs(at.x - self._seen.x) / cameras.width + dr.abs(at.y - self._seen.y) / cameras.height
        return dr.mean(off)  # two coordinates, each in halves of the side


class DepthLoss:
    """
    Mean L1 difference of depth along the view axis at the centres of pixels, at most a constant.

    Parameters
    ----------
    depth : ndarray, shape (B, H, W)
        NaN where nothing is known.
    unit : float
        What counts as 1.
    truncation : float
        Difference from which a pixel does not count [in that unit]: hair, glasses, another outline.
    """

    def __init__(self, depth: np.ndarray, unit: float, truncation: float):
        known = np.flatnonzero(np.isfinite(depth))
        self._pixel, self._depth = upload(mi.UInt32, known), upload(mi.Float, depth.ravel()[known])
        self._unit, self._truncation = dr.opaque(mi.Float, unit), dr.opaque(mi.Float, truncation)

    def __call__(self, scene: mi.Scene, surface: Surface, cameras: Cameras, scale: mi.Float) -> mi.Float:
        """
        Width 1; differentiable in surface, cameras and the scale of the depth maps.

        Parameters
        ----------
        scene : mi.Scene
            Holds the positions of the surface; what the rays meet.
        """
        n = cameras.width * cameras.height
        view = self._pixel // n
        row = (self._pixel - view * n) // cameras.width
        x, y = mi.Float(self._pixel % cameras.width) + 0.5, mi.Float(row) + 0.5
        origin, direction = cameras.ray(view, x, y)
        face, _ = trace(scene, origin, direction)
        hit = fragment(surface, face, origin, direction)
        z = dr.dot(hit.p - origin, cameras.fetch(view, 3).xyz) * scale
        off = dr.abs(z - self._depth) / self._unit
        return dr.mean(dr.select((face != MISS) & (off < self._truncation), off, self._truncation))
