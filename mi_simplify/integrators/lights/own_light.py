"""
The ``own_light`` integrator: what surfaces give off by themselves, and nothing else.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

#: Transparent surfaces that a ray goes through at most.
_LAYERS = 32


class OwnLight(mi.SamplingIntegrator):
    r"""
    The emission of ``ggx_gamma`` as the camera sees it, through transparent surfaces (:monosp:`own_light`).

    It is added to the image of another integrator: glTF's emission is seen, but lights nothing else, and area lights
    would do both or, with ``hide_emitters``, neither. Not differentiable.
    """

    @dr.syntax
    def sample(self, scene, sampler, ray, medium=None, active=True):
        ray, active = mi.Ray3f(dr.detach(ray)), mi.Bool(active)
        value, through = mi.Color3f(0), mi.Float(1)
        layer, hit = mi.UInt32(0), mi.Bool(False)
        while dr.hint(active, label="own light"):
            si = scene.ray_intersect(ray, active)
            active &= si.is_valid()
            bsdf = si.bsdf()
            passed = bsdf.eval_null_transmission(si, active).x
            emission = bsdf.eval_attribute_3("emission", si, active)
            value += dr.select(active, through * (1 - passed) * emission, 0)
            through *= dr.select(active, passed, 1)
            hit |= active
            ray = dr.select(active, si.spawn_ray(ray.d), ray)
            layer += 1
            active &= (through > 1e-3) & (layer < _LAYERS)
        return value, hit, []

    def to_string(self):
        return "OwnLight[]"


mi.register_integrator("own_light", lambda props: OwnLight(props))
