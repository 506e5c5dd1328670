"""
The curve on which interpolated normals turn away from the viewer: there most BSDFs and smooth emitters turn black.

A face interpolates positions p and normals n linearly over barycentrics b. Towards a viewer at o the curve is the zero
of ``g(b) = Σ_ij b_i b_j n_i·(o - p_j)``, a conic; for parallel projections it is linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.upload import upload
from ..mesh_edges import NEAR
from .crossings import Crossings, drawn
from .projections import Projections

#: Either side is looked at where the cosine between normal and viewer has changed by this much: float32 resolves it.
_COSINE_STEP = 2e-5


@dataclass(init=False, eq=False)
class Horizon:
    """
    Faces whose shading may jump where their interpolated normal turns away from the viewer.

    Parameters
    ----------
    faces : ndarray, shape (F, 3)
        Vertices, of positions and normals alike.
    welded : ndarray, shape (F, 3)
        The same corners as welded positions.
    """

    faces: mi.Vector3u
    welded: mi.Vector3u
    n_faces: int

    def __init__(self, faces: np.ndarray, welded: np.ndarray):
        self.faces, self.welded, self.n_faces = upload(mi.Vector3u, faces), upload(mi.Vector3u, welded), len(faces)

    def sample(
        self, positions: mi.Float, normals: mi.Float, projections: Projections, n_samples: int, seed: mi.UInt32
    ) -> Crossings:
        """
        Points on the curve in all views; attached where positions, normals and the sensor are.

        Parameters
        ----------
        positions, normals : mi.Float, width V·3
        """
        flat_p, flat_n = dr.detach(positions), dr.detach(normals)
        with dr.suspend_grad():
            pair = dr.arange(mi.UInt32, self.n_faces * projections.n_views)
            view = pair // self.n_faces
            face = self._corners(flat_p, flat_n, projections, view, pair - view * self.n_faces)
            weight = dr.select(face.crosses & face.visible, dr.maximum(face.chord, 1e-4), 0)
            dr.eval(weight)
            pair, u, v, scale = drawn(weight, n_samples, seed)
            view = pair // self.n_faces
            index = pair - view * self.n_faces
            face = self._corners(flat_p, flat_n, projections, view, index)
            weight = dr.gather(mi.Float, weight, pair)
            b, found, length, nx, ny, slope, turn = face.point(u, v)
            p = mi.Point3f(dr.fma(face.p[0], b.x, dr.fma(face.p[1], b.y, face.p[2] * b.z)))
            film = projections.project(view, p)
            valid = found & (weight > 0) & projections.in_window(view, film.x, film.y)
            step = dr.maximum(4 * projections.step(view, projections.homogeneous(view, p)), _COSINE_STEP * turn / slope)
        with dr.resume_grad():
            moved = self._corners(positions, normals, projections, view, index)
            moved_p = mi.Point3f(dr.fma(moved.p[0], b.x, dr.fma(moved.p[1], b.y, moved.p[2] * b.z)))
            moved_film = projections.project(view, moved_p)
            # The curve follows the surface, and runs over it as fast as normals and viewer turn.
            motion = moved_film.x * nx + moved_film.y * ny - moved.value(b) / slope
            return Crossings(
                view=view,
                x=film.x,
                y=film.y,
                nx=nx,
                ny=ny,
                weight=dr.select(valid, scale / weight * length * projections.share, 0),
                step=dr.minimum(step, _LARGEST_STEP),
                p=p,
                end0=dr.gather(mi.UInt32, self.welded.x, index),
                end1=dr.gather(mi.UInt32, self.welded.y, index),
                outline=mi.Bool(False),
                motion=dr.select(valid, motion, 0),
            )

    def _corners(
        self, positions: mi.Float, normals: mi.Float, projections: Projections, view: mi.UInt32, face: mi.UInt32
    ) -> _Face:
        """
        Corners, film positions and the conic of faces.
        """
        index = [dr.gather(mi.UInt32, c, face) for c in self.faces]
        p = [dr.gather(mi.Point3f, positions, i) for i in index]
        n = [dr.gather(mi.Vector3f, normals, i) for i in index]
        v = [projections.towards(view, q) for q in p]
        a = {(i, j): 0.5 * (dr.dot(n[i], v[j]) + dr.dot(n[j], v[i])) for i in range(3) for j in range(i, 3)}
        return _Face(p, n, v, [projections.homogeneous(view, q) for q in p], a, projections.window(view))


#: [pixels]; where the curve is nearly a fold of the film, a farther look would leave the face.
_LARGEST_STEP = 0.05


@dataclass
class _Face:
    """
    Corners p, normals n, vectors to the viewer v and homogeneous film positions h of a face; ``a[i, j]`` are the
    control values of its conic, symmetric.
    """

    p: list[mi.Point3f]
    n: list[mi.Vector3f]
    v: list[mi.Vector3f]
    h: list[mi.Vector4f]
    a: dict[tuple[int, int], mi.Float]
    window: mi.Vector4f

    @property
    def crosses(self) -> mi.Bool:
        """Whether the conic may have a zero: its control values, which bound it, differ in sign."""
        values = list(self.a.values())
        low, high = values[0], values[0]
        for x in values[1:]:
            low, high = dr.minimum(low, x), dr.maximum(high, x)
        return (low < 0) & (high > 0)

    @property
    def visible(self) -> mi.Bool:
        """Whether the face is in front of the camera and not all on one outer side of the window."""
        h, w = self.h, self.window
        outside = mi.Bool(False)
        for beyond in (
            [q.x < w.x * q.z for q in h], [q.x > w.z * q.z for q in h],
            [q.y < w.y * q.z for q in h], [q.y > w.w * q.z for q in h],
        ):  # fmt: skip
            outside |= beyond[0] & beyond[1] & beyond[2]
        return ~outside & (h[0].w > NEAR) & (h[1].w > NEAR) & (h[2].w > NEAR)

    @property
    def extent(self) -> mi.Float:
        """Longest side on the film, inside the window [pixels]."""
        w = self.window
        x = [dr.clip(q.x / dr.maximum(q.z, NEAR), w.x, w.z) for q in self.h]
        y = [dr.clip(q.y / dr.maximum(q.z, NEAR), w.y, w.w) for q in self.h]
        sides = [dr.square(x[i] - x[j]) + dr.square(y[i] - y[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
        return dr.sqrt(dr.maximum(dr.maximum(sides[0], sides[1]), sides[2]))

    def _a(self, i: int, j: int) -> mi.Float:
        return self.a[min(i, j), max(i, j)]

    def value(self, b: mi.Vector3f) -> mi.Float:
        """The conic at barycentrics b."""
        c = [b.x, b.y, b.z]
        return sum(self._a(i, j) * c[i] * c[j] for i in range(3) for j in range(3))

    def _turned(self, array: list, k: mi.UInt32) -> list:
        """Items of three in the order k, k + 1, k + 2."""
        pick = lambda i: dr.select(k == 0, array[i], dr.select(k == 1, array[(i + 1) % 3], array[(i + 2) % 3]))  # noqa: E731
        return [pick(i) for i in range(3)]

    def _odd_corner(self) -> tuple[mi.UInt32, mi.Bool]:
        """The corner whose sign differs from those of the others, and whether there is one."""
        plus = [self.a[i, i] > 0 for i in range(3)]
        last = dr.select(plus[2] == plus[0], mi.UInt32(1), mi.UInt32(2))
        return dr.select(plus[1] == plus[2], mi.UInt32(0), last), (plus[0] != plus[1]) | (plus[1] != plus[2])

    def _ends(self, k: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Where the curve cuts the two sides at the odd corner k, as fractions of them."""
        d = self._turned([self.a[0, 0], self.a[1, 1], self.a[2, 2]], k)
        e = self._turned([self.a[1, 2], self.a[0, 2], self.a[0, 1]], k)
        return _root(d[0], e[2], d[1]), _root(d[0], e[1], d[2])

    @property
    def chord(self) -> mi.Float:
        """About the length of the curve on the film: of its chord where it cuts two sides [pixels]."""
        k, is_odd = self._odd_corner()
        s1, s2 = self._ends(k)
        h = self._turned(self.h, k)
        film = [
            mi.Point2f(q.x, q.y) / dr.maximum(q.z, NEAR) for q in (dr.lerp(h[0], h[1], s1), dr.lerp(h[0], h[2], s2))
        ]
        # Not less than a part of the face: where the curve bends it is longer.
        return dr.select(is_odd, dr.maximum(dr.norm(film[1] - film[0]), 0.05 * self.extent), self.extent)

    def _along_chord(self, k: mi.UInt32, is_odd: mi.Bool, tau: mi.Float) -> tuple[mi.Float, mi.Float]:
        """
        The line from corner k through the point of the curve's chord at fraction tau, and its derivative by tau.

        Lines spread evenly over the opposite side would nearly all miss a curve that runs close along a side.
        """
        s1, s2 = self._ends(k)
        a, b = (1 - tau) * s1, tau * s2
        sum_ = dr.maximum(a + b, 1e-20)
        by_tau = s1 * s2 / dr.square(sum_)
        return dr.select(is_odd, b / sum_, tau), dr.select(is_odd, by_tau, 1)

    def point(self, u: mi.Float, v: mi.Float):
        """
        A point of the curve on a line from a corner to the opposite side, at fraction u of the curve's chord.

        The corner is the one whose sign differs from the others', which every such line leaves towards the other sign.
        Where a line meets the curve twice, v chooses.

        Returns
        -------
        b : mi.Vector3f
            Barycentrics.
        found : mi.Bool
        length : mi.Float
            Of curve on the film a unit of u [pixels], times the number of points to choose from.
        nx, ny : mi.Float
            Unit normal of the curve on the film, to where normals face the viewer.
        slope : mi.Float
            Of the conic along it, a pixel.
        turn : mi.Float
            Length of normal times that of the vector to the viewer: what the conic is divided by to be a cosine.
        """
        k, is_odd = self._odd_corner()
        u, du = self._along_chord(k, is_odd, u)
        # The conic along b = (1 - s, s(1 - u), s u), in the order of corners that begins with the odd one.
        d = self._turned([self.a[0, 0], self.a[1, 1], self.a[2, 2]], k)
        e = self._turned([self.a[1, 2], self.a[0, 2], self.a[0, 1]], k)  # opposite to each corner
        g0 = d[0]
        mid = dr.lerp(e[2], e[1], u)
        far = dr.square(1 - u) * d[1] + 2 * u * (1 - u) * e[0] + dr.square(u) * d[2]
        qa, qb, qc = g0 - 2 * mid + far, 2 * (mid - g0), g0
        disc = dr.square(qb) - 4 * qa * qc
        root = dr.safe_sqrt(disc)
        q = -0.5 * (qb + dr.select(qb < 0, -root, root))
        s0 = dr.select(dr.abs(qa) > 1e-12 * dr.abs(q), q / dr.select(qa != 0, qa, 1), -1)
        s1 = dr.select(q != 0, qc / dr.select(q != 0, q, 1), -1)
        in0, in1 = (disc >= 0) & (s0 > 0) & (s0 < 1), (disc >= 0) & (s1 > 0) & (s1 < 1)
        both = in0 & in1
        s = dr.select(both, dr.select(v < 0.5, s0, s1), dr.select(in0, s0, s1))
        found = in0 | in1
        s = dr.select(found, s, 0.5)
        turned = [1 - s, s * (1 - u), s * u]
        back = (3 - k) % 3
        b = mi.Vector3f(*self._turned(turned, back))
        by_u = self._turned([mi.Float(0), -s, s], back)
        by_s = self._turned([mi.Float(-1), 1 - u, u], back)
        c = [b.x, b.y, b.z]
        slopes = [2 * sum(self._a(i, j) * c[j] for j in range(3)) for i in range(3)]
        g_u, g_s = (sum(slopes[i] * w[i] for i in range(3)) for w in (by_u, by_s))
        ds = -g_u / dr.select(g_s != 0, g_s, 1)
        found &= g_s != 0
        along = [by_u[i] + by_s[i] * ds for i in range(3)]
        # Film positions change with b by these columns.
        h = self.h[0] * c[0] + self.h[1] * c[1] + self.h[2] * c[2]
        x, y = h.x / h.z, h.y / h.z
        jx, jy = ([(getattr(q, axis) - at * q.z) / h.z for q in self.h] for axis, at in (("x", x), ("y", y)))
        dx, dy = (sum(j[i] * along[i] for i in range(3)) for j in (jx, jy))
        length = du * dr.sqrt(dr.square(dx) + dr.square(dy))
        # Gradient of the conic on the film: J^-T of that over the two free barycentrics.
        m = [jx[1] - jx[0], jx[2] - jx[0], jy[1] - jy[0], jy[2] - jy[0]]
        g1, g2 = slopes[1] - slopes[0], slopes[2] - slopes[0]
        det = m[0] * m[3] - m[1] * m[2]
        found &= (dr.abs(det) > 1e-12) & (length > 0)
        inv = dr.rcp(dr.select(dr.abs(det) > 1e-12, det, 1))
        gx, gy = (m[3] * g1 - m[2] * g2) * inv, (m[0] * g2 - m[1] * g1) * inv
        slope = dr.sqrt(dr.square(gx) + dr.square(gy))
        found &= slope > 0
        slope = dr.select(found, slope, 1)
        n = self.n[0] * c[0] + self.n[1] * c[1] + self.n[2] * c[2]
        v_ = self.v[0] * c[0] + self.v[1] * c[1] + self.v[2] * c[2]
        turn = dr.norm(n) * dr.norm(v_)
        return b, found, length * dr.select(both, 2, 1), gx / slope, gy / slope, slope, turn


def _root(g0: mi.Float, mid: mi.Float, g1: mi.Float) -> mi.Float:
    """
    The zero in (0, 1) of the quadratic with these control values, whose ends differ in sign.
    """
    a, b = g0 - 2 * mid + g1, 2 * (mid - g0)
    root = dr.safe_sqrt(dr.square(b) - 4 * a * g0)
    root = dr.select(g0 > 0, root, -root)
    # (-b - root) / 2a = 2 g0 / (-b + root): the one of the two forms that does not cancel.
    low, high = root - b, -root - b
    by_g0 = 2 * g0 / dr.select(low != 0, low, 1)
    by_a = high / dr.select(a != 0, 2 * a, 1)
    return dr.clip(dr.select(dr.abs(low) >= dr.abs(high), by_g0, by_a), 0, 1)
