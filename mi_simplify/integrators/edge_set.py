"""
The edges of a mesh on the device, of which those that the views see are sampled anew in every step.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from .camera import Cameras
from .edge_samples import EdgeSamples
from .edges import CREASE, OPEN, EdgeTable, wound_outwards


@dataclass(init=False, eq=False)
class EdgeSet:
    """
    An edge table on the device, with its part of a step.

    Parameters
    ----------
    table : EdgeTable
    position_faces : ndarray, shape (F, 3)
    crease_weight : float
        Samples a pixel of crease gets for one that a pixel of silhouette gets: jumps there are small.
    positions : ndarray, shape (P, 3), optional
    opaque : bool
        Nothing is seen through the mesh at ``positions``: where it is a closed solid and the camera stays out of its
        box, no crease between two back faces is seen, and none is sampled.
    """

    rows: mi.UInt32
    kind: mi.UInt32
    faces: mi.Vector3u
    n_edges: int
    crease_weight: float
    solid_box: tuple[float, ...] | None

    def __init__(
        self,
        table: EdgeTable,
        position_faces: np.ndarray,
        *,
        crease_weight: float = 0.25,
        positions: np.ndarray | None = None,
        opaque: bool = True,
    ):
        self.n_edges, self.crease_weight, self.solid_box = len(table.ends), crease_weight, None
        rows, kind = np.concatenate([table.ends, table.faces], axis=1), table.kind
        if positions is not None:
            # Edges of one place one after the other: rays of one vector visit the same boxes, 15 % of tracing them.
            middle = positions[table.ends].mean(1)
            cell = np.floor((middle - middle.min(0)) * (16 / max(np.ptp(middle, axis=0).max(), 1e-30)))
            order = np.lexsort(cell.T)
            rows, kind = rows[order], kind[order]
        self.rows = upload(mi.UInt32, rows.ravel())
        self.kind = upload(mi.UInt32, kind)
        self.faces = upload(mi.Vector3u, position_faces)
        if opaque and positions is not None and table.closed and wound_outwards(positions, position_faces):
            low, high = positions.min(0), positions.max(0)
            margin = 0.1 * np.linalg.norm(high - low)  # for what the mesh grows by later
            self.solid_box = (*(low - margin).tolist(), *(high + margin).tolist())

    def _planes(self, positions: mi.Float) -> mi.Float:
        """
        Face planes ``(n, -n·p)`` in packets of four; the sign of ``n·o - n·p`` says which side ``o`` is on.
        """
        p = [dr.gather(mi.Point3f, positions, i) for i in self.faces]
        n = dr.cross(p[1] - p[0], p[2] - p[0])
        return dr.ravel(mi.Vector4f(n.x, n.y, n.z, -dr.dot(n, mi.Vector3f(p[0]))))

    def touches(self, face: mi.UInt32, end0: mi.UInt32, end1: mi.UInt32) -> mi.Bool:
        """
        Whether a face, where there is one, has one of two positions among its corners.
        """
        corners = [dr.gather(mi.UInt32, c, face, face < dr.width(c)) for c in self.faces]
        touch = [(c == end0) | (c == end1) for c in corners]
        return (touch[0] | touch[1] | touch[2]) & (face < dr.width(self.faces))

    def sample(
        self, positions: mi.Float, cameras: Cameras, n_samples: int, seed: mi.UInt32, image: mi.Float | None = None
    ) -> EdgeSamples:
        """
        Points on the edges in all views, spread along their length on the film.

        Parameters
        ----------
        positions : mi.Float, width P·3
            Welded positions, detached.
        n_samples : int
            How many points N; constant, so that no kernel is compiled anew.
        image : mi.Float, width B·height·width·4, optional
            What the views show. With it an edge gets points in proportion to how much the image differs to either side
            of its middle, which halves the variance of a gradient; it only says where to look.

        Notes
        -----
        Three kernels: planes of all faces; projected lengths of all (view, edge) pairs; a stratified draw from their
        running sum. Nothing is read back.
        """
        positions = dr.detach(positions)
        planes = self._planes(positions)
        dr.eval(planes)
        pair = dr.arange(mi.UInt32, self.n_edges * cameras.n_views)
        view = pair // self.n_edges
        segment = self._segment(positions, cameras, view, pair - view * self.n_edges)
        density = self._density(planes, cameras, view, segment)
        if image is not None:
            density *= _contrast(image, cameras, view, segment) + _LEAST_CONTRAST
        density = dr.select(segment.visible, density, 0)
        weight = density * segment.length
        dr.eval(density, weight)
        total = dr.cumsum(weight)
        sum_ = dr.gather(mi.Float, total, self.n_edges * cameras.n_views - 1)

        lane = dr.arange(mi.UInt32, n_samples)
        r0, r1 = mi.sample_tea_32(lane, seed, 6)  # four are uneven, see film_samples
        target = (mi.Float(lane) + mi.Float(r0) * 2.0**-32) * (1 / n_samples) * sum_
        n_pairs = self.n_edges * cameras.n_views
        pair = dr.binary_search(0, n_pairs - 1, lambda i: dr.gather(mi.Float, total, i) <= target)
        view = pair // self.n_edges
        segment = self._segment(positions, cameras, view, pair - view * self.n_edges)
        density = dr.gather(mi.Float, density, pair)
        tau = mi.Float(r1) * 2.0**-32
        iz0, iz1 = (dr.rcp(dr.maximum(z, _NEAR)) for z in (segment.z0, segment.z1))
        depth = dr.rcp(dr.lerp(iz0, iz1, tau))
        o = cameras.fetch(view, 0)
        magnitude = dr.maximum(dr.max(dr.abs(o.xyz)), depth) / dr.maximum(depth * o.w, 1e-12)
        # A point at fraction tau of the clipped segment *on the film*, then its parameter on the edge itself.
        a = tau * segment.z0 / dr.maximum(segment.z1 + tau * (segment.z0 - segment.z1), 1e-12)
        valid = segment.visible & (density > 0)
        kind = dr.gather(mi.UInt32, self.kind, segment.edge)
        return EdgeSamples(
            view=view,
            end0=segment.end0,
            end1=segment.end1,
            s=dr.lerp(segment.s0, segment.s1, a),
            x=dr.lerp(segment.x0, segment.x1, tau),
            y=dr.lerp(segment.y0, segment.y1, tau),
            nx=segment.nx,
            ny=segment.ny,
            weight=dr.select(valid, sum_ / (n_samples * density), 0),
            step=max(cameras.width, cameras.height) * dr.maximum(_STEP_FILM, _STEP_WORLD * magnitude),
            depth=depth,
            outline=self._outline(planes, cameras, view, segment, kind)[0],
        )

    def _density(self, planes: mi.Float, cameras: Cameras, view: mi.UInt32, segment: _Segment) -> mi.Float:
        """
        Importance of a pixel of edge length: 1 for silhouettes and open edges, less for creases, else 0.
        """
        kind = dr.gather(mi.UInt32, self.kind, segment.edge)
        outline, front = self._outline(planes, cameras, view, segment, kind)
        weight = dr.select(outline, mi.Float(1), dr.select(kind == CREASE, self.crease_weight, mi.Float(0)))
        if self.solid_box is None:
            return weight
        o = cameras.origin(view)
        low, high = mi.ScalarPoint3f(self.solid_box[:3]), mi.ScalarPoint3f(self.solid_box[3:])
        return dr.select(front | dr.all((o > low) & (o < high)), weight, 0)

    @staticmethod
    def _outline(
        planes: mi.Float, cameras: Cameras, view: mi.UInt32, segment: _Segment, kind: mi.UInt32
    ) -> tuple[mi.Bool, mi.Bool]:
        """
        Whether an edge is a silhouette or open, and whether one of its faces at least is seen from the front.
        """
        o = cameras.origin(view)
        plane0, plane1 = (dr.gather(mi.Vector4f, planes, f) for f in (segment.face0, segment.face1))
        side0, side1 = (dr.dot(plane.xyz, o) + plane.w > 0 for plane in (plane0, plane1))
        return (side0 != side1) | (kind == OPEN), side0 | side1

    def _segment(self, positions: mi.Float, cameras: Cameras, view: mi.UInt32, edge: mi.UInt32) -> _Segment:
        """
        The part of an edge in front of the camera and inside the film.
        """
        row = dr.gather(mi.Vector4u, self.rows, edge)
        p = [dr.gather(mi.Point3f, positions, i) for i in (row.x, row.y)]
        o = cameras.fetch(view, 0)
        axes = [cameras.fetch(view, k).xyz for k in (1, 2, 3)]
        local = [mi.Vector3f(*[dr.dot(q - mi.Point3f(o.xyz), axis) for axis in axes]) for q in p]
        tan_y = o.w * (cameras.height / cameras.width)
        # Distances to the planes of the view frustum, linear along the edge (Liang and Barsky 1984).
        margins = [[q.z - _NEAR, q.z * o.w - q.x, q.z * o.w + q.x, q.z * tan_y - q.y, q.z * tan_y + q.y] for q in local]
        s0, s1 = mi.Float(0), mi.Float(1)
        for m0, m1 in zip(*margins, strict=True):
            cut = m0 / dr.select(m0 != m1, m0 - m1, 1)
            s0 = dr.select((m0 < 0) & (m1 >= 0), dr.maximum(s0, cut), s0)
            s1 = dr.select((m0 >= 0) & (m1 < 0), dr.minimum(s1, cut), s1)
            s1 = dr.select((m0 < 0) & (m1 < 0), -1, s1)
        visible = s1 > s0
        film = []
        for s in (s0, s1):
            q = dr.lerp(local[0], local[1], s)
            iz = dr.rcp(dr.maximum(q.z, _NEAR))
            x = dr.fma(q.x * iz / o.w, 0.5, 0.5) * cameras.width
            y = dr.fma(q.y * iz / tan_y, -0.5, 0.5) * cameras.height
            film.append((x, y, q.z))
        (x0, y0, z0), (x1, y1, z1) = film
        length = dr.sqrt(dr.square(x1 - x0) + dr.square(y1 - y0))
        visible &= length > 1e-6
        return _Segment(edge, row.x, row.y, row.z, row.w, s0, s1, x0, y0, z0, x1, y1, z1, length, visible)


def _contrast(image: mi.Float, cameras: Cameras, view: mi.UInt32, segment: _Segment) -> mi.Float:
    """
    Sum over channels of how much the pixels beside the middle of a segment differ.
    """
    x, y = 0.5 * (segment.x0 + segment.x1), 0.5 * (segment.y0 + segment.y1)
    low, high = (
        dr.gather(mi.Vector4f, image, cameras.pixel(view, x + s * segment.nx, y + s * segment.ny), segment.visible)
        for s in (-1, 1)
    )
    return dr.sum(dr.abs(low - high))


#: Added to the contrast of an edge, so that those of which the image shows nothing are not forgotten.
_LEAST_CONTRAST = 0.2

#: Steps to either side of an edge that rays in float32 still resolve: as a fraction of the film, and of the larger of
#: depth and camera coordinates. Half of either loses some jumps in rounding; the outline of a fine mesh zigzags by
#: little more, and what a step crosses besides its edge is an error in proportion to it.
_STEP_FILM, _STEP_WORLD = 3e-7, 2e-7

#: Nearest depth at which edges are followed [scene units].
_NEAR = 1e-3


@dataclass
class _Segment:
    """
    What a film shows of an edge: fractions ``s0 s1`` of it, film positions [pixels] and depths of both ends.
    """

    edge: mi.UInt32
    end0: mi.UInt32
    end1: mi.UInt32
    face0: mi.UInt32
    face1: mi.UInt32
    s0: mi.Float
    s1: mi.Float
    x0: mi.Float
    y0: mi.Float
    z0: mi.Float
    x1: mi.Float
    y1: mi.Float
    z1: mi.Float
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
