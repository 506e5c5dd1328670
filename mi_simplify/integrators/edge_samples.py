"""
Samples on the edges that the views see, and rays that pass them on either side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from .camera import Cameras

if TYPE_CHECKING:
    from .edge_set import EdgeSet


@dataclass
class EdgeSamples:
    """
    Points on edges as the films see them; detached.

    ``end0 end1`` are positions, ``s`` the fraction between them, (x, y) the film position [pixels], (nx, ny) the unit
    normal of the edge on the film, ``weight`` the edge length [pixels] that the sample stands for, ``step`` how far off
    the edge [pixels] either side is looked at, ``depth`` is along the view axis, ``outline`` tells silhouettes and open
    edges from creases.
    """

    view: mi.UInt32
    end0: mi.UInt32
    end1: mi.UInt32
    s: mi.Float
    x: mi.Float
    y: mi.Float
    nx: mi.Float
    ny: mi.Float
    weight: mi.Float
    step: mi.Float
    depth: mi.Float
    outline: mi.Bool

    def shows(self, low: mi.Bool, high: mi.Bool) -> mi.Bool:
        """
        Whether the jump across each sample is its own, of whether rays to either side meet the edge.

        Behind other surfaces nothing jumps, not even where an edge of theirs falls onto the same line of the film. A
        crease is inside the surface: where one side of it misses that, a silhouette ran in between.
        """
        return dr.select(self.outline, low | high, low & high)

    def motion(self, cameras: Cameras, positions: mi.Float) -> mi.Float:
        """
        Where the samples lie along the normals of their edges on the film [pixels]; only the derivative matters.

        What lies on the low side gains area where this grows.
        """
        p = dr.lerp(dr.gather(mi.Point3f, positions, self.end0), dr.gather(mi.Point3f, positions, self.end1), self.s)
        film = cameras.project(self.view, p)
        return film.x * self.nx + film.y * self.ny


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
        view, depth, end0, end1 = (dr.gather(type(a), a, i) for a in (e.view, e.depth, e.end0, e.end1))
        is_near = dr.abs(t * dr.dot(direction, self.cameras.fetch(view, 3).xyz) - depth) < AT_EDGE * depth
        return is_near | edges.touches(face, end0, end1)


#: A ray meets an edge where its hit is closer to it than this fraction of its depth, or on a face that touches it: a
#: face seen edge-on gets farther away within a step. More than that for all would count what is hidden close behind.
AT_EDGE = 1e-3
