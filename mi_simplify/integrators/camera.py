"""
Pinhole cameras of a batch of views: rays through film positions, and the way back.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..latent.ambient import Harmonics, MapLight, in_packets, light_of
from ..scenes.views import Views

#: Packets of a view.
_ROWS = 6


@dataclass
class Cameras:
    """
    The views' cameras and lights in packets of four floats, so that one sample fetches them in six wide gathers;
    behind them, once for all views, the light besides the point lights.

    Film coordinates are ``(x, y)`` in pixels from the top left corner of the image; the views' images
    lie behind each other, pixel ``(b, y, x)`` at ``(b·height + y)·width + x``.
    """

    packets: mi.Float
    n_views: int
    width: int
    height: int
    n_light: int = 0

    @property
    def n_pixels(self) -> int:
        """Pixels of all views."""
        return self.n_views * self.width * self.height

    @staticmethod
    def of(views: Views) -> Cameras:
        """
        Pack the views; differentiable in camera and light.
        """
        n = len(views)
        rows = [
            [*views.origin, views.tan_x],
            [*views.right, mi.Float(0)],
            [*views.up, mi.Float(0)],
            [*views.forward, views.frame],
            [*views.light_position, mi.Float(0)],
            [*views.light_intensity, mi.Float(0)],
        ]
        columns = [c + dr.zeros(mi.Float, n) for row in rows for c in row]
        packets = dr.ravel(mi.ArrayXf(columns))
        light, n_light = in_packets(views.ambient)
        if n_light:
            packets = dr.concat((packets, light))
        return Cameras(packets, n, views.width, views.height, n_light)

    def fetch(self, view: mi.UInt32, row: int, active=True) -> mi.Vector4f:
        """
        Packet ``row`` (0 origin and tan_x, 1 right, 2 up, 3 forward, 4 light position, 5 light intensity).
        """
        return dr.gather(mi.Vector4f, self.packets, view * _ROWS + row, active)

    def ambient(self) -> Harmonics | MapLight | None:
        """The light besides the point lights, the same in all views."""
        return light_of(self.packets, self.n_views * _ROWS, self.n_light)

    def origin(self, view: mi.UInt32) -> mi.Point3f:
        """Camera position."""
        return mi.Point3f(self.fetch(view, 0).xyz)

    def ray(self, view: mi.UInt32, x: mi.Float, y: mi.Float) -> tuple[mi.Point3f, mi.Vector3f]:
        """
        Origin and unit direction of the ray through film position (x, y) [pixels].
        """
        o = self.fetch(view, 0)
        sx = dr.fma(x, 2 / self.width, -1) * o.w
        sy = dr.fma(y, -2 / self.height, 1) * (o.w * (self.height / self.width))
        d = self.fetch(view, 3).xyz + self.fetch(view, 1).xyz * sx + self.fetch(view, 2).xyz * sy
        return mi.Point3f(o.xyz), mi.Vector3f(dr.normalize(d))

    def pixel_width(self, view: mi.UInt32, direction: mi.Vector3f) -> mi.Float:
        """
        Width of a pixel at distance 1 along the unit direction of a ray [scene units]: its ray differential.
        """
        return dr.dot(direction, self.fetch(view, 3).xyz) * self.fetch(view, 0).w * (2 / self.width)

    def project(self, view: mi.UInt32, p: mi.Point3f) -> mi.Point3f:
        """
        Film position [pixels] and depth along the view axis of a point: ``(x, y, z)``; x, y mean nothing where z <= 0.
        """
        o = self.fetch(view, 0)
        local = p - mi.Point3f(o.xyz)
        z = dr.dot(local, self.fetch(view, 3).xyz)
        iz = dr.rcp(z * o.w)
        x = dr.dot(local, self.fetch(view, 1).xyz) * iz
        y = dr.dot(local, self.fetch(view, 2).xyz) * iz * (self.width / self.height)
        return mi.Point3f(dr.fma(x, 0.5, 0.5) * self.width, dr.fma(y, -0.5, 0.5) * self.height, z)

    def pixel(self, view: mi.UInt32, x: mi.Float, y: mi.Float) -> mi.UInt32:
        """Pixel of the batch at a film position, the nearest one where that is off the film."""
        column, row = (mi.UInt32(dr.clip(c, 0, n - 1)) for c, n in ((x, self.width), (y, self.height)))
        return (view * self.height + row) * self.width + column


def film_samples(
    cameras: Cameras, spp: int, seed: mi.UInt32, index: mi.UInt32 | None = None
) -> tuple[mi.UInt32, mi.UInt32, mi.Float, mi.Float]:
    """
    Pixel, view and film position of samples of a batch, ``spp`` consecutive ones a pixel.

    A rank-1 lattice in every pixel, shifted at random per pixel: as even as a stratified grid for any spp. The same
    seed gives the same positions in every view of this size, whatever else changes.

    Parameters
    ----------
    index : mi.UInt32, optional
        Which samples; all of them if not given.

    Notes
    -----
    Pixels come in tiles of 4x4, one vector of 16 rays each: near rays visit the same boxes and triangles.
    """
    if index is None:
        index = dr.arange(mi.UInt32, cameras.n_pixels * spp)
    place = index // spp if spp > 1 else index
    k = mi.Float(index - place * spp) if spp > 1 else mi.Float(0)
    tile = 4 if cameras.height % 4 == 0 else 1
    strip = place // (tile * cameras.width)
    within = place - strip * (tile * cameras.width)
    column = within // tile
    row = strip * tile + (within - column * tile)
    pixel = row * cameras.width + column
    # The usual four rounds leave the shifts of neighbouring pixels correlated (0.45) and uneven.
    view = row // cameras.height
    shift_x, shift_y = mi.sample_tea_32(pixel - view * (cameras.width * cameras.height), seed, 6)
    to_unit = 2.0**-32
    jx = dr.fma(k, 1 / spp, mi.Float(shift_x) * to_unit)
    jy = dr.fma(k, 0.6180339887, mi.Float(shift_y) * to_unit)
    x = mi.Float(column) + (jx - dr.floor(jx))
    y = mi.Float(row - view * cameras.height) + (jy - dr.floor(jy))
    return pixel, view, x, y


@dataclass
class FilmRays:
    """
    The camera rays of a batch, ``spp`` consecutive ones a pixel, see :func:`film_samples`.
    """

    cameras: Cameras
    spp: int
    seed: mi.UInt32

    def __len__(self) -> int:
        return self.cameras.n_pixels * self.spp

    def at(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.Point3f, mi.Vector3f]:
        """View, origin and unit direction of some of the rays."""
        _, view, x, y = film_samples(self.cameras, self.spp, self.seed, index)
        return view, *self.cameras.ray(view, x, y)

    def source(self, index: mi.UInt32) -> mi.UInt32:
        """The camera rays that some of the rays belong to: they themselves."""
        return index

    def pixel(self, index: mi.UInt32) -> mi.UInt32:
        """Pixel of the batch that some of the rays belong to."""
        return film_samples(self.cameras, self.spp, self.seed, index)[0]

    def weight(self, index: mi.UInt32) -> float | mi.Float:
        """What some of the rays count in their pixels."""
        return 1 / self.spp


@dataclass
class PixelRays:
    """
    One camera ray a pixel, where the pixel is shaded, and how much of the pixel that stands for.

    Parameters
    ----------
    cameras : Cameras
    x, y : mi.Float
        Film positions, one a pixel of the batch; detached.
    coverage : mi.Float
        Share of the pixel's samples of visibility that hit the surface.
    n_traced : int
        How many samples of visibility that were.
    """

    cameras: Cameras
    x: mi.Float
    y: mi.Float
    coverage: mi.Float
    n_traced: int

    def __len__(self) -> int:
        return self.n_traced

    def at(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.Point3f, mi.Vector3f]:
        """View, origin and unit direction of some of the rays."""
        view = index // (self.cameras.width * self.cameras.height)
        x, y = dr.gather(mi.Float, self.x, index), dr.gather(mi.Float, self.y, index)
        return view, *self.cameras.ray(view, x, y)

    def pixel(self, index: mi.UInt32) -> mi.UInt32:
        """Pixel of the batch that some of the rays belong to."""
        return index

    def weight(self, index: mi.UInt32) -> mi.Float:
        """What some of the rays count in their pixels."""
        return dr.gather(mi.Float, self.coverage, index)

    @staticmethod
    def centred(cameras: Cameras) -> PixelRays:
        """
        Through the centres of all pixels, each for the whole of its pixel: images without antialiasing.
        """
        pixel = dr.arange(mi.UInt32, cameras.n_pixels)
        row = pixel // cameras.width
        x, y = mi.Float(pixel - row * cameras.width) + 0.5, mi.Float(row % cameras.height) + 0.5
        return PixelRays(cameras, x, y, dr.opaque(mi.Float, 1, cameras.n_pixels), cameras.n_pixels)

    @staticmethod
    def through_visible(samples: FilmRays, is_hit: mi.Bool) -> tuple[PixelRays, mi.UInt32]:
        """
        Of the samples of each pixel one of those that hit, at random: what the pixel shows is then, on average, what
        shading all of them would show.

        Returns
        -------
        rays : PixelRays
        index : mi.UInt32, width B·height·width
            Of the sample that was chosen; undefined where none hit, and the coverage is 0.
        """
        n, spp, index = samples.cameras.n_pixels, samples.spp, dr.arange(mi.UInt32, len(samples))
        pixel, _, x, y = film_samples(samples.cameras, spp, samples.seed, index)
        lot = (mi.sample_tea_32(index, samples.seed + 1, 6)[0] & 0xFFFF0000) | (index - (index // spp) * spp + 1)
        coverage, best = dr.zeros(mi.Float, n), dr.zeros(mi.UInt32, n)
        dr.scatter_reduce(dr.ReduceOp.Add, coverage, mi.Float(1 / spp), pixel, is_hit)
        dr.scatter_reduce(dr.ReduceOp.Max, best, lot, pixel, is_hit)
        dr.eval(coverage, best)
        is_chosen = is_hit & (dr.gather(mi.UInt32, best, pixel) == lot)
        at_x, at_y, chosen = dr.zeros(mi.Float, n), dr.zeros(mi.Float, n), dr.zeros(mi.UInt32, n)
        for buffer, value in ((at_x, x), (at_y, y), (chosen, index)):
            dr.scatter(buffer, value, pixel, is_chosen)
        return PixelRays(samples.cameras, at_x, at_y, coverage, len(samples)), chosen
