"""
A reference renderer for implicit surfaces: sphere tracing in Dr.Jit, direct light, hard shadows on request.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...bsdfs import microfacet
from ...errors import AssetError
from ..implicit.surface import Implicit
from ..views import Views

#: Steps along a ray at most; what has not arrived by then counts as not hit.
MAX_STEPS = 512

#: Rays that are traced at once.
_CHUNK = 1 << 22


class SphereTraced:
    """
    An implicit surface as a :class:`.reference.Reference`, in its own units.

    Radiance is that of :mod:`...bsdfs.microfacet` under the point light of the view, plus ``ambient · base_color``.
    Normals are gradients of the distance, by automatic differentiation.

    Parameters
    ----------
    surface : Implicit
    spp : int
        Samples per pixel.
    shadows : bool
        Whether the surface shadows itself.
    form : {'gltf', 'paper'}
        Mixing of the lobes.
    """

    def __init__(self, surface: Implicit, *, spp: int = 4, shadows: bool = False, form: str = "gltf"):
        self.surface, self.spp, self.shadows, self.form = surface, spp, shadows, microfacet.check_form(form)
        box = surface.box
        self._low, self._high = box
        self._size = float(np.linalg.norm(box[1] - box[0]))
        self._pace = mi.Float(1 / surface.excess)
        dr.make_opaque(self._pace)

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`.reference.Reference`.

        Raises
        ------
        AssetError
            A camera stands inside the surface.
        """
        origins = views.arrays()["origin"]
        inside = self.surface.at(origins) < 0
        if inside.any():
            place = ", ".join(f"{x:.3g}" for x in origins[inside][0])
            raise AssetError(f"{self.surface.name}: a camera at ({place}) is inside the surface; move it out")
        n = views.height * views.width
        out = np.empty((len(views), views.height, views.width, 4), np.float32)
        at_once = max(1, _CHUNK // (n * self.spp))
        for first in range(0, len(views), at_once):
            part = views.take(np.arange(first, min(first + at_once, len(views))))
            image = self._image(part, dr.opaque(mi.UInt32, (seed + 0x9E3779B9 * first) % 2**32))
            out[first : first + len(part)] = image.numpy().reshape(len(part), views.height, views.width, 4)
        return out

    def _image(self, views: Views, seed: mi.UInt32) -> mi.Float:
        """Flat image of some views."""
        spp = self.spp
        n_pixels = len(views) * views.height * views.width
        index = dr.arange(mi.UInt32, n_pixels * spp)
        pixel = index // spp
        column, row = pixel % views.width, pixel // views.width % views.height
        view = pixel // (views.width * views.height)
        # A rank-1 lattice in every pixel, shifted at random, as the latent renderer has it.
        k = mi.Float(index - pixel * spp)
        shift = [mi.Float(x) * 2.0**-32 for x in mi.sample_tea_32(pixel, seed, 6)]
        jx, jy = dr.fma(k, 1 / spp, shift[0]), dr.fma(k, 0.6180339887, shift[1])
        x, y = mi.Float(column) + jx - dr.floor(jx), mi.Float(row) + jy - dr.floor(jy)
        take = lambda array: dr.gather(type(array), array, view)  # noqa: E731
        tan_x = take(views.tan_x)
        sx = dr.fma(x, 2 / views.width, -1) * tan_x
        sy = dr.fma(y, -2 / views.height, 1) * (tan_x * (views.height / views.width))
        origin = take(views.origin)
        direction = dr.normalize(take(views.forward) + take(views.right) * sx + take(views.up) * sy)
        ray = mi.Ray3f(origin, direction)
        cone = tan_x * (2 / views.width)  # side of a pixel at distance 1
        start, end = self._span(ray)
        dr.eval(ray.o, ray.d, cone, start, end, view)

        near = dr.compress(end > start)  # most rays pass the box by
        if dr.width(near) == 0:
            return dr.zeros(mi.Float, n_pixels * 4)
        ray, cone, start, end, view, pixel = (dr.gather(type(a), a, near) for a in (ray, cone, start, end, view, pixel))
        t, hit = self._march(ray, start, end, cone)
        dr.eval(t, hit)
        found = dr.compress(hit)
        image = dr.zeros(mi.Float, n_pixels * 4)
        if dr.width(found) == 0:
            return image
        ray, t, view, pixel = (dr.gather(type(a), a, found) for a in (ray, t, view, pixel))
        value = self._shade(ray, t, take_light(views, view))
        dr.scatter_reduce(dr.ReduceOp.Add, image, value * (1 / spp), pixel)
        dr.eval(image)
        return image

    def _span(self, ray: mi.Ray3f) -> tuple[mi.Float, mi.Float]:
        """Where a ray enters and leaves the box of the surface; the end before the start where it misses it."""
        low, high = mi.Point3f(self._low.tolist()), mi.Point3f(self._high.tolist())
        inverse = dr.rcp(dr.select(dr.abs(ray.d) > 1e-9, ray.d, 1e-9))
        a, b = (low - ray.o) * inverse, (high - ray.o) * inverse
        return dr.maximum(dr.max(dr.minimum(a, b)), 0), dr.min(dr.maximum(a, b))

    def _march(self, ray: mi.Ray3f, start, end, cone) -> tuple[mi.Float, mi.Bool]:
        """
        Sphere tracing (Hart 1996): steps as long as the distance, until a hundredth of a pixel is left of it.
        """
        distance, pace, least = self.surface.distance, self._pace, mi.Float(2e-6 * self._size)
        dr.make_opaque(least)

        def going(t, hit, n, active):
            return active

        def step(t, hit, n, active):
            d = distance(mi.Point3f(ray(t)))
            close = d < dr.maximum(least, 0.01 * cone * t)
            hit |= active & close
            t = dr.select(active & ~close, t + dr.maximum(d * pace, 0.5 * least), t)
            n += 1
            active &= ~close & (t < end) & (n < MAX_STEPS)
            return t, hit, n, active

        with dr.suspend_grad():
            try:
                t, hit, _, _ = dr.while_loop(
                    (mi.Float(start), dr.full(mi.Bool, False, dr.width(start)), mi.UInt32(0), start < end),
                    going, step, labels=("t", "hit", "n", "active"),
                )  # fmt: skip
            except RuntimeError as error:
                text = str(error).strip().splitlines()
                raise AssetError(
                    f"{self.surface.name}: the distance function cannot be traced ({text[-1] if text else ''}); it may "
                    "use Dr.Jit's functions only, without Python's `if` on values, NumPy or printing"
                ) from error
        return t, hit

    def _shade(self, ray: mi.Ray3f, t: mi.Float, light) -> mi.Vector4f:
        """Radiance and coverage where rays meet the surface."""
        position, intensity = light
        p = mi.Point3f(ray(t))
        dr.eval(p)
        n = self.surface.gradient(p)
        n *= dr.rsqrt(dr.maximum(dr.squared_norm(n), 1e-20))
        material = self.surface.surfel(p)
        to_light = position - p
        d2 = dr.squared_norm(to_light)
        wo, wi = to_light * dr.rsqrt(d2), -ray.d
        roughness = dr.maximum(material.roughness, microfacet.MIN_ROUGHNESS)
        value = microfacet.evaluate(
            material.base_color, mi.Float(0), roughness, material.metallic, microfacet.face_viewer(n, wi), wi, wo,
            self.form,
        )  # fmt: skip
        value *= intensity * dr.rcp(d2)
        if self.shadows:
            distance = dr.sqrt(d2)
            away = 2e-3 * self._size
            shadow = mi.Ray3f(p + n * away, wo)
            start, leave = self._span(shadow)
            dr.eval(shadow.o, shadow.d, start, leave, distance, value, n)
            end = dr.minimum(leave, distance)
            dr.eval(end)
            _, dark = self._march(shadow, start, end, mi.Float(0))
            value = dr.select(dark, 0, value)
        ambient = mi.Color3f(*(float(a) for a in self.surface.ambient))
        value += ambient * material.base_color
        return mi.Vector4f(value.x, value.y, value.z, 1)


def take_light(views: Views, view: mi.UInt32) -> tuple[mi.Point3f, mi.Color3f]:
    """
    Position and intensity of the lights of some views.
    """
    return tuple(dr.gather(type(a), a, view) for a in (views.light_position, views.light_intensity))
