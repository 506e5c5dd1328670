"""
The edges of a mesh on the device, of which those that the views see are sampled anew in every step.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .camera import Cameras
from .edge_samples import EdgeSamples
from .edges import CREASE, OPEN, EdgeTable, wound_outwards
from .mesh_edges import CREASE_WEIGHT, NEAR, MeshEdges, Segment, clipped, contrast


@dataclass(init=False, eq=False)
class EdgeSet(MeshEdges):
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

    crease_weight: float
    solid_box: tuple[float, ...] | None

    def __init__(
        self,
        table: EdgeTable,
        position_faces: np.ndarray,
        *,
        crease_weight: float = CREASE_WEIGHT,
        positions: np.ndarray | None = None,
        opaque: bool = True,
    ):
        self.crease_weight, self.solid_box, order = crease_weight, None, None
        if positions is not None:
            # Edges of one place one after the other: rays of one vector visit the same boxes, 15 % of tracing them.
            middle = positions[table.ends].mean(1)
            cell = np.floor((middle - middle.min(0)) * (16 / max(np.ptp(middle, axis=0).max(), 1e-30)))
            order = np.lexsort(cell.T)
        super().__init__(table, position_faces, order)
        if opaque and positions is not None and table.closed and wound_outwards(positions, position_faces):
            low, high = positions.min(0), positions.max(0)
            margin = 0.1 * np.linalg.norm(high - low)  # for what the mesh grows by later
            self.solid_box = (*(low - margin).tolist(), *(high + margin).tolist())

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
        planes = self.planes(positions)
        dr.eval(planes)
        pair = dr.arange(mi.UInt32, self.n_edges * cameras.n_views)
        view = pair // self.n_edges
        segment = self.segment(positions, cameras, view, pair - view * self.n_edges)
        density = self.density(planes, cameras, view, segment)
        if image is not None:
            x, y = segment.middle
            sides = [cameras.pixel(view, x + k * segment.nx, y + k * segment.ny) for k in (-1, 1)]
            density *= contrast(image, sides, segment)
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
        segment = self.segment(positions, cameras, view, pair - view * self.n_edges)
        density = dr.gather(mi.Float, density, pair)
        tau = mi.Float(r1) * 2.0**-32
        iz0, iz1 = (dr.rcp(dr.maximum(z, NEAR)) for z in (segment.z0, segment.z1))
        depth = dr.rcp(dr.lerp(iz0, iz1, tau))
        valid = segment.visible & (density > 0)
        return EdgeSamples(
            view=view,
            end0=segment.row.x,
            end1=segment.row.y,
            s=segment.fraction(tau),
            x=dr.lerp(segment.x0, segment.x1, tau),
            y=dr.lerp(segment.y0, segment.y1, tau),
            nx=segment.nx,
            ny=segment.ny,
            weight=dr.select(valid, sum_ / (n_samples * density), 0),
            step=self.step(cameras, view, depth),
            depth=depth,
            outline=self.outline(planes, cameras, view, segment),
        )

    @staticmethod
    def step(cameras: Cameras, view: mi.UInt32, depth: mi.Float) -> mi.Float:
        """
        How far off an edge at a depth either side is looked at [pixels].
        """
        o = cameras.fetch(view, 0)
        magnitude = dr.maximum(dr.max(dr.abs(o.xyz)), depth) / dr.maximum(depth * o.w, 1e-12)
        return max(cameras.width, cameras.height) * dr.maximum(_STEP_FILM, _STEP_WORLD * magnitude)

    def density(self, planes: mi.Float, cameras: Cameras, view: mi.UInt32, segment: Segment) -> mi.Float:
        """
        Importance of a pixel of edge length: 1 for silhouettes and open edges, less for creases, else 0.
        """
        kind = dr.gather(mi.UInt32, self.kind, segment.edge)
        outline, front = self._seen_from(planes, cameras, view, segment, kind)
        weight = dr.select(outline, mi.Float(1), dr.select(kind == CREASE, self.crease_weight, mi.Float(0)))
        if self.solid_box is None:
            return weight
        o = cameras.origin(view)
        low, high = mi.ScalarPoint3f(self.solid_box[:3]), mi.ScalarPoint3f(self.solid_box[3:])
        return dr.select(front | dr.all((o > low) & (o < high)), weight, 0)

    def outline(self, planes: mi.Float, cameras: Cameras, view: mi.UInt32, segment: Segment) -> mi.Bool:
        """
        Whether an edge is a silhouette or open.
        """
        kind = dr.gather(mi.UInt32, self.kind, segment.edge)
        return self._seen_from(planes, cameras, view, segment, kind)[0]

    @staticmethod
    def _seen_from(
        planes: mi.Float, cameras: Cameras, view: mi.UInt32, segment: Segment, kind: mi.UInt32
    ) -> tuple[mi.Bool, mi.Bool]:
        """
        Whether an edge is a silhouette or open, and whether one of its faces at least is seen from the front.
        """
        o = cameras.origin(view)
        plane0, plane1 = (dr.gather(mi.Vector4f, planes, f) for f in (segment.row.z, segment.row.w))
        side0, side1 = (dr.dot(plane.xyz, o) + plane.w > 0 for plane in (plane0, plane1))
        return (side0 != side1) | (kind == OPEN), side0 | side1

    def segment(
        self, positions: mi.Float, cameras: Cameras, view: mi.UInt32, edge: mi.UInt32, margin: float = 0.0
    ) -> Segment:
        """
        The part of an edge in front of the camera and inside the film, or not farther than ``margin`` [pixels] from it.
        """
        row = dr.gather(mi.Vector4u, self.rows, edge)
        p = [dr.gather(mi.Point3f, positions, i) for i in (row.x, row.y)]
        o = cameras.fetch(view, 0)
        axes = [cameras.fetch(view, k).xyz for k in (1, 2, 3)]
        local = [mi.Vector3f(*[dr.dot(q - mi.Point3f(o.xyz), axis) for axis in axes]) for q in p]
        tan_y = o.w * (cameras.height / cameras.width)
        # Distances to the planes of the view frustum, linear along the edge.
        wide, high = o.w * (1 + 2 * margin / cameras.width), tan_y * (1 + 2 * margin / cameras.height)
        s = clipped(
            [[q.z - NEAR, q.z * wide - q.x, q.z * wide + q.x, q.z * high - q.y, q.z * high + q.y] for q in local]
        )
        film = []
        for fraction in s:
            q = dr.lerp(local[0], local[1], fraction)
            iz = dr.rcp(dr.maximum(q.z, NEAR))
            x = dr.fma(q.x * iz / o.w, 0.5, 0.5) * cameras.width
            y = dr.fma(q.y * iz / tan_y, -0.5, 0.5) * cameras.height
            film.append((x, y, q.z))
        return Segment.of(view, edge, row, s, film)


#: Steps to either side of an edge that rays in float32 still resolve: as a fraction of the film, and of the larger of
#: depth and camera coordinates. Half of either loses some jumps in rounding; the outline of a fine mesh zigzags by
#: little more, and what a step crosses besides its edge is an error in proportion to it.
_STEP_FILM, _STEP_WORLD = 3e-7, 2e-7
