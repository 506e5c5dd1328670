"""
Rays that pass edge samples on either side.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .camera import Cameras
from .edge_samples import EdgeSamples
from .edge_set import EdgeSet


@dataclass
class EdgeRays:
    """
    Camera rays that pass edge samples: ray 2i on the low side of sample i, ray 2i + 1, nearly the same, on the high
    side. They pass ``width`` steps off it.
    """

    cameras: Cameras
    samples: EdgeSamples
    width: float = 1.0

    def at(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.Point3f, mi.Vector3f]:
        """View, origin and unit direction of some of the rays."""
        e, i = self.samples, index // 2
        take = lambda a: dr.gather(type(a), a, i)  # noqa: E731
        side = mi.Float(mi.Int32(index - 2 * i) * 2 - 1) * (take(e.step) * self.width)
        view = take(e.view)
        x, y = dr.fma(side, take(e.nx), take(e.x)), dr.fma(side, take(e.ny), take(e.y))
        return view, *self.cameras.ray(view, x, y)

    def seen(self, index: mi.UInt32, face: mi.UInt32, edges: EdgeSet, direction: mi.Vector3f, t: mi.Float) -> mi.Bool:
        """
        Whether hits on faces at distances ``t`` along rays of these directions lie at the edge, not before or behind.
        """
        e, i = self.samples, index // 2
        end0, end1 = (dr.gather(type(a), a, i) for a in (e.end0, e.end1))
        return self.near(index, direction, t) | edges.touches(face, end0, end1)

    def near(self, index: mi.UInt32, direction: mi.Vector3f, t: mi.Float) -> mi.Bool:
        """
        Whether distances ``t`` along rays of these directions are those of the edge.
        """
        e, i = self.samples, index // 2
        view, depth = (dr.gather(type(a), a, i) for a in (e.view, e.depth))
        return dr.abs(t * dr.dot(direction, self.cameras.fetch(view, 3).xyz) - depth) < AT_EDGE * depth


#: A ray meets an edge where its hit is closer to it than this fraction of its depth, or on a face that touches it: a
#: face seen edge-on gets farther away within a step. More than that for all would count what is hidden close behind.
AT_EDGE = 1e-3
