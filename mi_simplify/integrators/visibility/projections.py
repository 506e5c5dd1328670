"""
Sensors of plain Mitsuba scenes as projections onto a film: where a point is seen, and the ray back.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import UserError
from ...machine.upload import upload

#: Points of the aperture that the edges are looked at from; drawn anew for every image, one in each cell of a grid.
_APERTURE_SIDE = 8

_ROWS = 5


@dataclass
class Projections:
    """
    Projective maps from the world onto one film: pinholes (principal point anywhere, seen through a crop window),
    parallel projections, or many points of an aperture, each a pinhole of its own.

    A view maps film position (x, y) [pixels of the whole film, from its top left corner] to the ray ``o + t·(F + (x -
    xc)·R + (y - yc)·U)``; a parallel one to ``o + (x - xc)·R + (y - yc)·U + t·F``. Attached where the sensor is.

    Parameters
    ----------
    packets : mi.Float
        Five packets of four floats a view: ``o, is parallel``, ``F, 0``, ``R, xc``, ``U, yc``, and its window on the
        film ``x0, y0, x1, y1``.
    share : float
        What one view counts: one over the points of an aperture.
    """

    packets: mi.Float
    n_views: int
    width: int
    height: int
    share: float = 1.0

    def fetch(self, view: mi.UInt32, row: int) -> mi.Vector4f:
        """A packet of each view."""
        return dr.gather(mi.Vector4f, self.packets, view * _ROWS + row)

    def window(self, view: mi.UInt32) -> mi.Vector4f:
        """Where camera samples of a view lie on the film: ``x0, y0, x1, y1``."""
        return self.fetch(view, 4)

    def ray(self, view: mi.UInt32, x: mi.Float, y: mi.Float) -> tuple[mi.Point3f, mi.Vector3f]:
        """Origin and unit direction of the ray through a film position."""
        o, f, r, u = (self.fetch(view, row) for row in range(4))
        on_film = r.xyz * (x - r.w) + u.xyz * (y - u.w)
        parallel = o.w > 0
        origin = mi.Point3f(o.xyz + dr.select(parallel, on_film, 0))
        return origin, mi.Vector3f(dr.normalize(f.xyz + dr.select(parallel, 0, on_film)))

    def _duals(self, view: mi.UInt32) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        """Covectors that read the coefficients of F, R and U off a vector."""
        f, r, u = (mi.Vector3f(self.fetch(view, row).xyz) for row in (1, 2, 3))
        across = dr.cross(r, u)
        scale = dr.rcp(dr.dot(f, across))
        return across * scale, dr.cross(u, f) * scale, dr.cross(f, r) * scale

    def homogeneous(self, view: mi.UInt32, p: mi.Point3f) -> mi.Vector4f:
        """
        ``(X, Y, W, depth)``: the film position is (X, Y) / W, and the three are linear along lines in the world.
        """
        o, xc, yc = self.fetch(view, 0), self.fetch(view, 2).w, self.fetch(view, 3).w
        v = mi.Vector3f(p - mi.Point3f(o.xyz))
        depth, x, y = (dr.dot(dual, v) for dual in self._duals(view))
        w = dr.select(o.w > 0, 1, depth)
        return mi.Vector4f(dr.fma(xc, w, x), dr.fma(yc, w, y), w, depth)

    def project(self, view: mi.UInt32, p: mi.Point3f) -> mi.Point2f:
        """Film position of points in front of the camera."""
        h = self.homogeneous(view, p)
        return mi.Point2f(h.x, h.y) * dr.rcp(h.z)

    def shift(self, view: mi.UInt32, p: mi.Point3f, v: mi.Vector3f) -> mi.Vector2f:
        """How the film position of a point changes where it moves by a small vector."""
        h = self.homogeneous(view, p)
        depth, x, y = (dr.dot(dual, v) for dual in self._duals(view))
        w = dr.select(self.fetch(view, 0).w > 0, 0, depth)
        dx = dr.fma(self.fetch(view, 2).w, w, x) - h.x / h.z * w
        dy = dr.fma(self.fetch(view, 3).w, w, y) - h.y / h.z * w
        return mi.Vector2f(dx, dy) / h.z

    def towards(self, view: mi.UInt32, p: mi.Point3f) -> mi.Vector3f:
        """A vector from a point to the viewer, of any length."""
        o = self.fetch(view, 0)
        return dr.select(o.w > 0, -mi.Vector3f(self.fetch(view, 1).xyz), mi.Vector3f(mi.Point3f(o.xyz) - p))

    def in_window(self, view: mi.UInt32, x: mi.Float, y: mi.Float) -> mi.Bool:
        """Whether camera samples are drawn at a film position."""
        w = self.window(view)
        return (x >= w.x) & (y >= w.y) & (x < w.z) & (y < w.w)

    def step(self, view: mi.UInt32, h: mi.Vector4f) -> mi.Float:
        """
        Step off a film position [pixels] that rays in float32 resolve, for a point at the homogeneous position ``h``.

        As in the batched renderer's ``EdgeSet``: a fraction of the film, and of the coordinates that round.
        """
        o, r = self.fetch(view, 0), self.fetch(view, 2)
        magnitude = dr.maximum(dr.max(dr.abs(o.xyz)), h.w)
        pixel = dr.norm(r.xyz) * dr.maximum(h.z, 1e-12)
        return dr.maximum(_STEP_FILM * max(self.width, self.height), _STEP_WORLD * magnitude / pixel)


_STEP_FILM, _STEP_WORLD = 3e-7, 4e-7


def sensor_projections(sensor: mi.Sensor, seed: int = 0) -> Projections:
    """
    The projections of a Mitsuba sensor: `perspective`, `orthographic`, `thinlens`, or a `batch` of them.

    Parameters
    ----------
    seed : int
        Draws the points of an aperture.

    Raises
    ------
    UserError
        The sensor, or one of a batch, is of another kind.
    """
    film, params = sensor.film(), mi.traverse(sensor)
    size, crop, offset = film.size(), film.crop_size(), film.crop_offset()
    border = film.rfilter().border_size() if film.sample_border() else 0
    low = [float(offset[k] - border) for k in (0, 1)]
    high = [float(offset[k] + crop[k] + border) for k in (0, 1)]
    keys = list(params.keys())
    names = [k[: -len("to_world")] for k in keys if k.endswith("to_world")]
    if not names or any(name + "near_clip" not in keys for name in names):
        kind = sensor.class_name() if hasattr(sensor, "class_name") else type(sensor).__name__
        raise UserError(
            f"direct_edge: sensor '{sensor.id()}' ({kind}) has no visibility gradient here;"
            " use `perspective`, `thinlens`, `orthographic`, or a `batch` of them"
        )
    step = int(size[0]) // len(names)
    packets, counts = [], []
    for k, name in enumerate(names):
        window = [max(low[0], k * step) if k else low[0], low[1], high[0], high[1]]
        if k + 1 < len(names):
            window[2] = min(high[0], float((k + 1) * step))
        rows, n = _views(params, name, step if len(names) > 1 else int(size[0]), int(size[1]), seed)
        rows[2][3] = rows[2][3] + k * step
        columns = [mi.Float(c) + dr.zeros(mi.Float, n) for row in (*rows, window) for c in row]
        packets.append(dr.ravel(mi.ArrayXf(columns)))
        counts.append(n)
    if len(set(counts)) > 1:
        raise UserError("direct_edge: a `batch` of `thinlens` and other sensors has no visibility gradient here")
    all_packets = packets[0] if len(packets) == 1 else dr.concat(packets)
    return Projections(all_packets, sum(counts), int(size[0]), int(size[1]), 1 / counts[0])


def _views(params: mi.SceneParameters, name: str, width: int, height: int, seed: int) -> tuple[list[list], int]:
    """
    The first four packets of one sensor's views, by their components, and how many views there are.
    """
    to_world = mi.Matrix4f(params[name + "to_world"].matrix)
    c0, c1, c2, c3 = (mi.Vector3f(to_world[0, k], to_world[1, k], to_world[2, k]) for k in range(4))
    xc, yc = mi.Float(width / 2), mi.Float(height / 2)
    if name + "x_fov" not in params:
        r, u = -c0 * (2 / width), -c1 * (2 / width)  # Mitsuba's camera x axis points left on the image
        return [[*c3, 1.0], [*dr.normalize(c2), 0.0], [*r, xc], [*u, yc]], 1
    left, up, forward = (dr.normalize(c) for c in (c0, c1, c2))
    tan_x = dr.tan(dr.deg2rad(mi.Float(params[name + "x_fov"])) * 0.5)
    r, u = -left * (2 / width * tan_x), -up * (2 / width * tan_x)
    if name + "principal_point_offset_x" in params:
        # Fractions of the film, which are added to a film position before it is mapped to a direction.
        xc -= mi.Float(params[name + "principal_point_offset_x"]) * width
        yc -= mi.Float(params[name + "principal_point_offset_y"]) * height
    if name + "aperture_radius" not in params:
        return [[*c3, 0.0], [*forward, 0.0], [*r, xc], [*u, yc]], 1
    radius, focus = (mi.Float(params[name + key]) for key in ("aperture_radius", "focus_distance"))
    points = upload(mi.Point2f, _aperture_points(seed))
    place = (left * points.x + up * points.y) * radius
    return [[*(c3 + place), 0.0], [*(forward - place / focus), 0.0], [*r, xc], [*u, yc]], dr.width(points)


def _aperture_points(seed: int) -> np.ndarray:
    """
    Points of the unit disk, shape (N, 2), one in each cell of a grid that is mapped to it (Shirley and Chiu 1997).
    """
    rng, n = np.random.default_rng(seed), _APERTURE_SIDE
    cell = np.stack(np.meshgrid(np.arange(n), np.arange(n)), -1).reshape(-1, 2)
    a, b = (2 * (cell + rng.random((n * n, 2))) / n - 1).T
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    angle = np.where(wide, np.pi / 4 * b / a, np.pi / 2 - np.pi / 4 * a / b)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
