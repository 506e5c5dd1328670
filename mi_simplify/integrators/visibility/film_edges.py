"""
Edges of a scene's meshes as a film sees them: silhouettes, open edges, creases, and where light begins to graze.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.upload import upload
from ..edges import CREASE, OPEN, EdgeTable
from .crossings import Crossings, Eyes, drawn
from .projections import Projections

#: Samples a pixel of crease gets for one that a pixel of silhouette gets: jumps there are small.
_CREASE_WEIGHT = 0.25

#: Added to the contrast of an edge, so that those of which the image shows nothing are not forgotten.
_LEAST_CONTRAST = 0.2

#: Nearest depth at which edges are followed [scene units].
_NEAR = 1e-3


@dataclass(init=False, eq=False)
class FilmEdges:
    """
    An edge table on the device.

    Parameters
    ----------
    table : EdgeTable
    position_faces : ndarray, shape (F, 3)
    """

    rows: mi.UInt32
    kind: mi.UInt32
    faces: mi.Vector3u
    n_edges: int

    def __init__(self, table: EdgeTable, position_faces: np.ndarray):
        self.n_edges = len(table.ends)
        self.rows = upload(mi.UInt32, np.concatenate([table.ends, table.faces], axis=1).ravel())
        self.kind = upload(mi.UInt32, table.kind)
        self.faces = upload(mi.Vector3u, position_faces)

    def planes(self, positions: mi.Float) -> mi.Float:
        """
        Face planes ``(n, -n·p)`` in packets of four.
        """
        p = [dr.gather(mi.Point3f, positions, i) for i in self.faces]
        n = dr.cross(p[1] - p[0], p[2] - p[0])
        return dr.ravel(mi.Vector4f(n.x, n.y, n.z, -dr.dot(n, mi.Vector3f(p[0]))))

    def touches(self, face: mi.UInt32, end0: mi.UInt32, end1: mi.UInt32) -> mi.Bool:
        """
        Whether a face, where there is one, has one of two positions among its corners.
        """
        exists = face < dr.width(self.faces)
        corners = [dr.gather(mi.UInt32, c, face, exists) for c in self.faces]
        touch = [(c == end0) | (c == end1) for c in corners]
        return (touch[0] | touch[1] | touch[2]) & exists

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
                density *= _contrast(image, projections, s) + _LEAST_CONTRAST
            density = dr.select(s.visible, density, 0)
            weight = density * s.length
            dr.eval(density, weight)
            pair, tau, _, scale = drawn(weight, n_samples, seed)
            view = pair // self.n_edges
            s = self._segment(flat, projections, view, pair - view * self.n_edges)
            density = dr.gather(mi.Float, density, pair)
            _, outline = self._density(planes, projections, lights, s)
            # A point at fraction tau of the clipped segment *on the film*, then its parameter on the edge itself.
            a = tau * s.w0 / dr.maximum(s.w1 + tau * (s.w0 - s.w1), 1e-12)
            along = dr.lerp(s.s0, s.s1, a)
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

    def _density(self, planes: mi.Float, projections: Projections, lights: Eyes | None, s: _Segment):
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
        return dr.select(outline, mi.Float(1), dr.select(inside, mi.Float(_CREASE_WEIGHT), 0)), outline

    def _segment(self, positions: mi.Float, projections: Projections, view: mi.UInt32, edge: mi.UInt32) -> _Segment:
        """
        The part of an edge in front of the camera and inside the window.
        """
        row = dr.gather(mi.Vector4u, self.rows, edge)
        h = [projections.homogeneous(view, dr.gather(mi.Point3f, positions, i)) for i in (row.x, row.y)]
        window = projections.window(view)
        # Distances to the planes of the view volume, linear along the edge (Liang and Barsky 1984).
        margins = [
            [q.w - _NEAR, q.x - window.x * q.z, window.z * q.z - q.x, q.y - window.y * q.z, window.w * q.z - q.y]
            for q in h
        ]
        s0, s1 = mi.Float(0), mi.Float(1)
        for m0, m1 in zip(*margins, strict=True):
            cut = m0 / dr.select(m0 != m1, m0 - m1, 1)
            s0 = dr.select((m0 < 0) & (m1 >= 0), dr.maximum(s0, cut), s0)
            s1 = dr.select((m0 >= 0) & (m1 < 0), dr.minimum(s1, cut), s1)
            s1 = dr.select((m0 < 0) & (m1 < 0), -1, s1)
        visible = s1 > s0
        ends = []
        for s in (s0, s1):
            q = dr.lerp(h[0], h[1], s)
            iw = dr.rcp(dr.maximum(q.z, _NEAR))
            ends += [q.x * iw, q.y * iw, q.z]
        x0, y0, w0, x1, y1, w1 = ends
        length = dr.sqrt(dr.square(x1 - x0) + dr.square(y1 - y0))
        return _Segment(view, edge, row, s0, s1, x0, y0, w0, x1, y1, w1, length, visible & (length > 1e-6))


def _between(positions: mi.Float, row: mi.Vector4u, s: mi.Float) -> mi.Point3f:
    return dr.lerp(*(dr.gather(mi.Point3f, positions, i) for i in (row.x, row.y)), s)


def _contrast(image: mi.Float, projections: Projections, s: _Segment) -> mi.Float:
    """
    Sum over channels of how much the pixels beside the middle of a segment differ.
    """
    window = projections.window(s.view)
    x, y = 0.5 * (s.x0 + s.x1), 0.5 * (s.y0 + s.y1)
    low, high = (
        dr.gather(mi.Vector4f, image, _pixel(projections, window, x + k * s.nx, y + k * s.ny), s.visible)
        for k in (-1, 1)
    )
    return dr.sum(dr.abs(low - high))


def _pixel(projections: Projections, window: mi.Vector4f, x: mi.Float, y: mi.Float) -> mi.UInt32:
    """Nearest pixel of a film that is not cropped."""
    column = mi.UInt32(dr.clip(x, dr.maximum(window.x, 0), dr.minimum(window.z, projections.width) - 1))
    row = mi.UInt32(dr.clip(y, 0, projections.height - 1))
    return row * projections.width + column


@dataclass
class _Segment:
    """
    What a film shows of an edge: fractions ``s0 s1`` of it, film positions [pixels] and W of both ends.
    """

    view: mi.UInt32
    edge: mi.UInt32
    row: mi.Vector4u
    s0: mi.Float
    s1: mi.Float
    x0: mi.Float
    y0: mi.Float
    w0: mi.Float
    x1: mi.Float
    y1: mi.Float
    w1: mi.Float
    length: mi.Float
    visible: mi.Bool

    @property
    def nx(self) -> mi.Float:
        """Unit normal on the film, x."""
        return (self.y1 - self.y0) / dr.maximum(self.length, 1e-12)

    @property
    def ny(self) -> mi.Float:
        """Unit normal on the film, y."""
        return (self.x0 - self.x1) / dr.maximum(self.length, 1e-12)
