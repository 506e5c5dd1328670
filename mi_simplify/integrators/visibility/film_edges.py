"""
Edges of a scene's meshes as a film sees them: silhouettes, open edges, creases, and where light begins to graze.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..edges import CREASE, OPEN
from ..mesh_edges import CREASE_WEIGHT, NEAR, MeshEdges, Segment, clipped, contrast
from .crossings import Crossings, Eyes, drawn
from .projections import Projections


class FilmEdges(MeshEdges):
    """
    Edges seen by the sensors of a scene.
    """

    def turns(self, planes: mi.Float, row: mi.Vector4u, eye: mi.Vector4f) -> mi.Bool:
        """
        Whether one face of an edge is seen from the front and the other from the back, from a homogeneous point.
        """
        side = []
        for face in (row.z, row.w):
            plane = dr.gather(mi.Vector4f, planes, face)
            side.append(dr.dot(plane.xyz, eye.xyz) + plane.w * eye.w > 0)
        return side[0] != side[1]

    def sample(
        self,
        positions: mi.Float,
        projections: Projections,
        n_samples: int,
        seed: mi.UInt32,
        image: mi.Float | None,
        lights: Eyes | None,
    ) -> Crossings:
        """
        Points on the edges in all views, spread along their length on the film.

        Parameters
        ----------
        positions : mi.Float, width P·3
            Welded positions, attached where they move.
        image : mi.Float, optional
            What the film shows, flat RGBA of its pixels. Edges get points in proportion to how much it differs to
            either side of their middle.
        lights : Eyes, optional
            Lights that cast shadows: where a face turns away from one it begins to be in its own shadow.
        """
        attached, flat = positions, dr.detach(positions)
        with dr.suspend_grad():
            planes = self.planes(flat)
            dr.eval(planes)
            pair = dr.arange(mi.UInt32, self.n_edges * projections.n_views)
            view = pair // self.n_edges
            s = self._segment(flat, projections, view, pair - view * self.n_edges)
            density, _ = self._density(planes, projections, lights, s)
            if image is not None:
                density *= contrast(image, _sides(projections, s), s)
            density = dr.select(s.visible, density, 0)
            weight = density * s.length
            dr.eval(density, weight)
            pair, tau, _, scale = drawn(weight, n_samples, seed)
            view = pair // self.n_edges
            s = self._segment(flat, projections, view, pair - view * self.n_edges)
            density = dr.gather(mi.Float, density, pair)
            _, outline = self._density(planes, projections, lights, s)
            along = s.fraction(tau)
            p = _between(flat, s.row, along)
            valid = s.visible & (density > 0)
        with dr.resume_grad():
            film = projections.project(view, _between(attached, s.row, along))
            motion = film.x * s.nx + film.y * s.ny
        return Crossings(
            view=view,
            x=dr.lerp(s.x0, s.x1, tau),
            y=dr.lerp(s.y0, s.y1, tau),
            nx=s.nx,
            ny=s.ny,
            weight=dr.select(valid, scale / density * projections.share, 0),
            step=projections.step(view, projections.homogeneous(view, p)),
            p=p,
            end0=s.row.x,
            end1=s.row.y,
            outline=outline,
            motion=motion,
        )

    def _density(self, planes: mi.Float, projections: Projections, lights: Eyes | None, s: Segment):
        """
        Importance of a pixel of edge length, and whether it is a silhouette or open.
        """
        kind = dr.gather(mi.UInt32, self.kind, s.edge)
        o, f = projections.fetch(s.view, 0), projections.fetch(s.view, 1)
        eye = dr.select(o.w > 0, mi.Vector4f(-f.x, -f.y, -f.z, 0), mi.Vector4f(o.x, o.y, o.z, 1))
        outline = self.turns(planes, s.row, eye) | (kind == OPEN)
        inside = kind == CREASE
        if lights is not None:
            for k in range(lights.n):
                inside |= self.turns(planes, s.row, lights.fetch(mi.UInt32(k)))
        return dr.select(outline, mi.Float(1), dr.select(inside, mi.Float(CREASE_WEIGHT), 0)), outline

    def _segment(self, positions: mi.Float, projections: Projections, view: mi.UInt32, edge: mi.UInt32) -> Segment:
        """
        The part of an edge in front of the camera and inside the window.
        """
        row = dr.gather(mi.Vector4u, self.rows, edge)
        h = [projections.homogeneous(view, dr.gather(mi.Point3f, positions, i)) for i in (row.x, row.y)]
        window = projections.window(view)
        # Distances to the planes of the view volume, linear along the edge.
        s = clipped([
            [q.w - NEAR, q.x - window.x * q.z, window.z * q.z - q.x, q.y - window.y * q.z, window.w * q.z - q.y]
            for q in h
        ])  # fmt: skip
        ends = []
        for fraction in s:
            q = dr.lerp(h[0], h[1], fraction)
            iw = dr.rcp(dr.maximum(q.z, NEAR))
            ends.append((q.x * iw, q.y * iw, q.z))
        return Segment.of(view, edge, row, s, ends)


def _between(positions: mi.Float, row: mi.Vector4u, s: mi.Float) -> mi.Point3f:
    return dr.lerp(*(dr.gather(mi.Point3f, positions, i) for i in (row.x, row.y)), s)


def _sides(projections: Projections, s: Segment) -> list[mi.UInt32]:
    """Pixels to either side of the middle of a segment."""
    window, (x, y) = projections.window(s.view), s.middle
    return [_pixel(projections, window, x + k * s.nx, y + k * s.ny) for k in (-1, 1)]


def _pixel(projections: Projections, window: mi.Vector4f, x: mi.Float, y: mi.Float) -> mi.UInt32:
    """Nearest pixel of a film that is not cropped."""
    column = mi.UInt32(dr.clip(x, dr.maximum(window.x, 0), dr.minimum(window.z, projections.width) - 1))
    row = mi.UInt32(dr.clip(y, 0, projections.height - 1))
    return row * projections.width + column
