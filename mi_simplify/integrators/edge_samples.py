"""
Samples on the edges that the views see.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .camera import Cameras


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
