"""
Edges of a mesh on the device, and what a film shows of one: the ground of both samplers of edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from .edges import EdgeTable

#: Added to the contrast of an edge, so that those of which the image shows nothing are not forgotten.
LEAST_CONTRAST = 0.2

#: Samples a pixel of crease gets for one that a pixel of silhouette gets: jumps there are small.
CREASE_WEIGHT = 0.25

#: Nearest depth at which edges are followed [scene units].
NEAR = 1e-3


@dataclass(init=False, eq=False)
class MeshEdges:
    """
    An edge table on the device.

    Parameters
    ----------
    table : EdgeTable
    position_faces : ndarray, shape (F, 3)
    order : ndarray, shape (E,), optional
        In which the edges stand; as in the table without it.
    """

    rows: mi.UInt32
    kind: mi.UInt32
    faces: mi.Vector3u
    n_edges: int

    def __init__(self, table: EdgeTable, position_faces: np.ndarray, order: np.ndarray | None = None):
        rows, kind = np.concatenate([table.ends, table.faces], axis=1), table.kind
        if order is not None:
            rows, kind = rows[order], kind[order]
        self.n_edges = len(rows)
        self.rows = upload(mi.UInt32, rows.ravel())
        self.kind = upload(mi.UInt32, kind)
        self.faces = upload(mi.Vector3u, position_faces)

    def planes(self, positions: mi.Float) -> mi.Float:
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
        exists = face < dr.width(self.faces)
        corners = [dr.gather(mi.UInt32, c, face, exists) for c in self.faces]
        touch = [(c == end0) | (c == end1) for c in corners]
        return (touch[0] | touch[1] | touch[2]) & exists


@dataclass
class Segment:
    """
    What a film shows of an edge: fractions ``s0 s1`` of it, film positions [pixels] and depths of both ends.

    ``row`` holds its two positions and its two faces.
    """

    view: mi.UInt32
    edge: mi.UInt32
    row: mi.Vector4u
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

    @staticmethod
    def of(
        view: mi.UInt32,
        edge: mi.UInt32,
        row: mi.Vector4u,
        s: tuple[mi.Float, mi.Float],
        ends: Sequence[Sequence[mi.Float]],
    ) -> Segment:
        """
        The segment between two ends ``(x, y, z)``, visible if it has a length.
        """
        (x0, y0, z0), (x1, y1, z1) = ends
        length = dr.sqrt(dr.square(x1 - x0) + dr.square(y1 - y0))
        return Segment(view, edge, row, *s, x0, y0, z0, x1, y1, z1, length, (s[1] > s[0]) & (length > 1e-6))

    @property
    def nx(self) -> mi.Float:
        """Unit normal on the film, x."""
        return (self.y1 - self.y0) / dr.maximum(self.length, 1e-12)

    @property
    def ny(self) -> mi.Float:
        """Unit normal on the film, y."""
        return (self.x0 - self.x1) / dr.maximum(self.length, 1e-12)

    @property
    def middle(self) -> tuple[mi.Float, mi.Float]:
        """Between its ends [pixels]."""
        return 0.5 * (self.x0 + self.x1), 0.5 * (self.y0 + self.y1)

    def fraction(self, tau: mi.Float) -> mi.Float:
        """
        Where on the edge itself a point lies that is at fraction ``tau`` of the segment on the film.
        """
        a = tau * self.z0 / dr.maximum(self.z1 + tau * (self.z0 - self.z1), 1e-12)
        return dr.lerp(self.s0, self.s1, a)


def clipped(margins: Sequence[Sequence[mi.Float]]) -> tuple[mi.Float, mi.Float]:
    """
    Fractions between which an edge is inside all planes, of its ends' distances to them (Liang and Barsky 1984).

    Nothing is left of it where the second fraction is not above the first.
    """
    s0, s1 = mi.Float(0), mi.Float(1)
    for m0, m1 in zip(*margins, strict=True):
        cut = m0 / dr.select(m0 != m1, m0 - m1, 1)
        s0 = dr.select((m0 < 0) & (m1 >= 0), dr.maximum(s0, cut), s0)
        s1 = dr.select((m0 >= 0) & (m1 < 0), dr.minimum(s1, cut), s1)
        s1 = dr.select((m0 < 0) & (m1 < 0), -1, s1)
    return s0, s1


def contrast(image: mi.Float, sides: Sequence[mi.UInt32], segment: Segment) -> mi.Float:
    """
    How much the pixels to either side of the middle of a segment differ, over all channels, and a little more.
    """
    low, high = (dr.gather(mi.Vector4f, image, pixel, segment.visible) for pixel in sides)
    return dr.sum(dr.abs(low - high)) + LEAST_CONTRAST
