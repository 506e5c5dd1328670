"""
Light besides the point lights, in the latent model: a colour that comes from everywhere, or an environment.

One coefficient is an ambient term: its radiance on a surface is ``ambient · kd (1 - metallic)``, whatever the view
(Hasselgren et al. 2021, Sect. 4.5: "an ambient material term").

(d + 1)² coefficients are an environment, distant light without shadows, in real spherical harmonics of degree d
(:mod:`..model.light.harmonics`). Its diffuse part is exact up to that degree (Ramamoorthi and Hanrahan 2001); the
glossy one is the environment in the mirrored direction, blurred by ``exp(-(α l)²)`` in band l, times an approximation
of the integral of the BSDF (Karis 2014, "Physically Based Shading on Mobile").

More of them are an environment map, see :mod:`.environment`.

Any of them can be optimised together with the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..bsdfs import microfacet
from ..model.light.environment_map import rows_of_filtered
from ..model.light.harmonics import degree_of, harmonics
from .environment import EnvironmentMap
from .textures import Texels

#: Convolution of band l with the clamped cosine, over π.
_COSINE = (1.0, 2 / 3, 1 / 4, 0.0, -1 / 24)


@dataclass
class Harmonics:
    """
    An ambient term, or an environment in spherical harmonics.

    Parameters
    ----------
    coefficients : tuple of mi.Color3f
    """

    coefficients: tuple[mi.Color3f, ...]

    def radiance(self, texels: Texels, n: mi.Vector3f, wi: mi.Vector3f) -> mi.Color3f:
        """See :func:`ambient_radiance`."""
        diffuse = texels.base_color * (1 - texels.metallic)
        if len(self.coefficients) == 1:
            return self.coefficients[0] * diffuse
        cos_i = dr.dot(n, wi)
        mirrored = 2 * cos_i * n - wi
        alpha = dr.square(texels.roughness)
        radiance = mi.Color3f(0)
        for k, (band, value) in enumerate(_bands(len(self.coefficients), mirrored)):
            radiance += self.coefficients[k] * (value * dr.exp(-dr.square(alpha * band)))
        f0 = dr.lerp(mi.Color3f(microfacet.DIELECTRIC_F0), texels.base_color, texels.metallic) * (1 - texels.gamma)
        scale, offset = _integrated(texels.roughness, dr.maximum(cos_i, microfacet.MIN_COSINE))
        return diffuse * irradiance(self.coefficients, n) + (f0 * scale + offset) * radiance


def irradiance(coefficients: tuple[mi.Color3f, ...], n: mi.Vector3f) -> mi.Color3f:
    """
    What a white diffuse surface of a normal shows of an environment in spherical harmonics.
    """
    bands = enumerate(_bands(len(coefficients), n))
    return sum((coefficients[k] * (value * _COSINE[band]) for k, (band, value) in bands), mi.Color3f(0))


@dataclass
class MapLight:
    """
    An environment map.

    Parameters
    ----------
    glossy : EnvironmentMap
        What the specular lobe sees.
    diffuse : tuple of mi.Color3f
        What diffuse surfaces see of it, in spherical harmonics.
    """

    glossy: EnvironmentMap
    diffuse: tuple[mi.Color3f, ...]

    def radiance(self, texels: Texels, n: mi.Vector3f, wi: mi.Vector3f) -> mi.Color3f:
        """See :func:`ambient_radiance`."""
        # Of the light that the specular lobe of a dielectric takes from the diffuse one, the part that depends on the
        # angle is below 2 % of it.
        passed = 1 - microfacet.DIELECTRIC_F0 * (1 - texels.gamma)
        albedo = texels.base_color * ((1 - texels.metallic) * passed)
        return albedo * irradiance(self.diffuse, n) + self.glossy.reflected(texels, n, wi)


def light_of(packets: mi.Float, first: int, n: int) -> Harmonics | MapLight | None:
    """
    The light that is stored in a buffer; differentiable in it.

    Parameters
    ----------
    packets : mi.Float
        Four floats for each colour.
    first, n : int
        Where it begins, and how many colours it has; none are no light.
    """
    if n == 0:
        return None
    rows = rows_of_filtered(n)
    n_texels = EnvironmentMap.n_texels(rows) if rows else 0
    colors = [mi.Color3f(dr.gather(mi.Vector4f, packets, mi.UInt32(first + k)).xyz) for k in range(n_texels, n)]
    if rows == 0:
        return Harmonics(tuple(colors))
    return MapLight(EnvironmentMap(packets, first, rows), tuple(colors))


def in_packets(ambient: mi.Float | None) -> tuple[mi.Float, int]:
    """
    A light of flat colours, width K·3, as :func:`light_of` reads it, width K·4, and K; differentiable.
    """
    if ambient is None:
        return mi.Float(0), 0
    n = dr.width(ambient) // 3
    color = dr.gather(mi.Color3f, ambient, dr.arange(mi.UInt32, n))
    return dr.ravel(mi.Vector4f(color.x, color.y, color.z, 0)), n


def _bands(n: int, d: mi.Vector3f) -> list[tuple[int, mi.Float]]:
    """Band and value of every basis function in a direction."""
    return [(int(np.sqrt(k)), value) for k, value in enumerate(harmonics(degree_of(n), d.x, d.y, d.z))]


def _integrated(roughness: mi.Float, cos_i: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Scale and offset of F0 in the directional albedo of the glossy lobe."""
    x, y, z, w = (dr.fma(roughness, a, b) for a, b in ((-1, 1), (-0.0275, 0.0425), (-0.572, 1.04), (0.022, -0.04)))
    a = dr.fma(dr.minimum(dr.square(x), dr.exp2(-9.28 * cos_i)), x, y)
    return dr.fma(a, -1.04, z), dr.fma(a, 1.04, w)
