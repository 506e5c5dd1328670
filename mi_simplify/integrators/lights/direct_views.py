"""
The ``direct_views`` integrator: many views of a scene in one launch, each under a point light of its own.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...scenes.views import Views
from ..camera import Cameras, film_samples
from ..direct_edge import DirectEdge


class DirectViews(DirectEdge):
    r"""
    ``direct_edge`` for a batch of views (:monosp:`direct_views`)

    A pixel is looked at through the film positions of :func:`..camera.film_samples`, which are those of
    :class:`..deferred.DeferredRenderer` for the same seed and number of samples: of two renderings of nearly the same
    surface, what either has of noise is the same, and is not in their difference.

    .. pluginparameters::

     * - glows
       - |bool|
       - Add what surfaces give off by themselves (:monosp:`own_light`). (Default: false)

    and those of :monosp:`direct_edge`. The scene's own sensors and emitters are not looked at.
    """

    def __init__(self, props):
        super().__init__(props)
        self._own_light = mi.load_dict({"type": "own_light"}) if props.get("glows", False) else None
        self._lights: tuple[Cameras, mi.UInt32] | None = None

    def _light(self, scene, sampler, si, active):
        assert self._lights is not None  # render_views is what calls this
        cameras, view = self._lights
        position = mi.Point3f(cameras.fetch(view, 4).xyz)
        d = position - si.p
        squared = dr.squared_norm(d)
        if self.shadows:
            active = active & ~scene.ray_test(si.spawn_ray_to(position), active)
        return d * dr.rsqrt(squared), mi.Spectrum(cameras.fetch(view, 5).xyz) / squared, active

    def render_views(self, scene: mi.Scene, views: Views, spp: int, seed: int) -> np.ndarray:
        """
        Images of the views.

        Parameters
        ----------
        spp : int
            Samples per pixel.
        seed : int
            Of the film positions, and of nothing else: there is no other chance in this light.

        Returns
        -------
        ndarray, shape (B, height, width, 4), float32
            Linear radiance on black (premultiplied by coverage), and coverage. Not differentiable.
        """
        with dr.suspend_grad():
            cameras = Cameras.of(views)
            pixel, view, x, y = film_samples(cameras, spp, dr.opaque(mi.UInt32, seed))
            origin, direction = cameras.ray(view, x, y)
            ray, self._lights = mi.RayDifferential3f(origin, direction), (cameras, view)
            radiance, _, (coverage,), _ = self.sample(dr.ADMode.Primal, scene, None, ray)
            if self._own_light is not None:
                radiance += self._own_light.sample(scene, None, ray)[0]
            image = dr.zeros(mi.Float, cameras.n_pixels * 4)
            value = mi.Vector4f(*radiance, coverage) * (1 / spp)
            dr.scatter_reduce(dr.ReduceOp.Add, image, value, pixel, mode=dr.ReduceMode.Local)
            return image.numpy().reshape(len(views), views.height, views.width, 4)


mi.register_integrator("direct_views", lambda props: DirectViews(props))
