"""
Light besides the point lights, in the latent model: a colour that comes from everywhere, or an environment.

One coefficient is an ambient term: its radiance on a surface is ``ambient · kd (1 - metallic)``, whatever the view
(Hasselgren et al. 2021, Sect. 4.5: "an ambient material term").

(d + 1)² coefficients are an environment, distant light without shadows, in real spherical harmonics of degree d
(:mod:`..model.light.harmonics`). Its diffuse part is exact up to that degree (Ramamoorthi and Hanrahan 2001); the
glossy one is the environment in the mirrored direction, blurred by ``exp(-(α l)²)`` in band l, times an approximation
of the integral of the BSDF (Karis 2014, "Physically Based Shading on Mobile").

Either can be optimised together with the model.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..bsdfs import microfacet
from ..model.light.harmonics import degree_of, harmonics
from .textures import Texels

#: Convolution of band l with the clamped cosine, over π.
_COSINE = (1.0, 2 / 3, 1 / 4, 0.0, -1 / 24)


def ambient_radiance(ambient: Sequence[mi.Color3f], texels: Texels, n: mi.Vector3f, wi: mi.Vector3f) -> mi.Color3f:
    """
    What a surface shows of the ambient light, without regard to its opacity; differentiable in everything.

    Parameters
    ----------
    ambient : sequence of mi.Color3f
        One coefficient, or those of an environment.
    texels : Texels
    n, wi : mi.Vector3f
        Unit shading normal, and direction to the viewer.
    """
    diffuse = texels.base_color * (1 - texels.metallic)
    if len(ambient) == 1:
        return ambient[0] * diffuse
    degree = degree_of(len(ambient))
    cos_i = dr.dot(n, wi)
    mirrored = 2 * cos_i * n - wi
    alpha = dr.square(texels.roughness)
    irradiance, radiance = mi.Color3f(0), mi.Color3f(0)
    for band, k, towards_n, towards_r in _pairs(degree, n, mirrored):
        irradiance += ambient[k] * (towards_n * _COSINE[band])
        radiance += ambient[k] * (towards_r * dr.exp(-dr.square(alpha * band)))
    f0 = dr.lerp(mi.Color3f(microfacet.DIELECTRIC_F0), texels.base_color, texels.metallic) * (1 - texels.gamma)
    scale, offset = _integrated(texels.roughness, dr.maximum(cos_i, microfacet.MIN_COSINE))
    return diffuse * irradiance + (f0 * scale + offset) * radiance


def _pairs(degree: int, n: mi.Vector3f, r: mi.Vector3f):
    """Band, index and the values of every basis function in two directions."""
    both = zip(harmonics(degree, n.x, n.y, n.z), harmonics(degree, r.x, r.y, r.z), strict=True)
    return [(int(np.sqrt(k)), k, a, b) for k, (a, b) in enumerate(both)]


def _integrated(roughness: mi.Float, cos_i: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Scale and offset of F0 in the directional albedo of the glossy lobe."""
    x, y, z, w = (dr.fma(roughness, a, b) for a, b in ((-1, 1), (-0.0275, 0.0425), (-0.572, 1.04), (0.022, -0.04)))
    a = dr.fma(dr.minimum(dr.square(x), dr.exp2(-9.28 * cos_i)), x, y)
    return dr.fma(a, -1.04, z), dr.fma(a, 1.04, w)
