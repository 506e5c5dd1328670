"""
An environment map on the device: how glossy surfaces look at it, and how it is filtered for that.

The specular lobe is sampled in a few directions, drawn from the visible normals (Heitz 2018, in the form of Dupuy and
Benyoub 2023); each looks into the level of the map that is as blurred as its share of the lobe is wide (Křivánek and
Colbert 2008, "Real-time Shading with Filtered Importance Sampling"). The directions are the same everywhere, so that
the image has no noise and is a smooth function of normals, roughness and map.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.sparse import csr_array

from ..bsdfs import microfacet
from ..machine.upload import upload
from ..model.light.environment_map import filters, n_levels, rows_of
from .textures import Texels

#: Directions in which a point of a surface looks.
N_DIRECTIONS = 16

#: Width of a level's kernel (together with bilinear lookup between its texels) by the square root of the solid angle
#: that it stands for.
_WIDTH = 0.5


@dataclass
class EnvironmentMap:
    """
    The filtered levels of a map in a buffer, see :func:`..model.light.environment_map.filters`.

    Parameters
    ----------
    packets : mi.Float
        Four floats for each texel.
    first : int
        Where the first texel is, counted in texels.
    rows : int
        Of level 0.
    """

    packets: mi.Float
    first: int
    rows: int

    @staticmethod
    def n_texels(rows: int) -> int:
        """Texels of all levels."""
        return sum(2 * (rows >> level) ** 2 for level in range(n_levels(rows)))

    def lookup(self, direction: mi.Vector3f, level: mi.Float) -> mi.Color3f:
        """
        Radiance from a unit direction, bilinear in each of the two nearest levels; differentiable in everything.

        Parameters
        ----------
        level : mi.Float
            In [0, levels - 1].
        """
        d = direction
        sin = dr.sqrt(dr.maximum(dr.fma(d.x, d.x, dr.square(d.z)), 1e-10))
        u, v = dr.atan2(d.x, -d.z) * (0.5 * dr.inv_pi), dr.atan2(sin, d.y) * dr.inv_pi
        below = dr.minimum(mi.UInt32(dr.maximum(dr.detach(level), 0)), n_levels(self.rows) - 1)
        above = dr.minimum(below + 1, n_levels(self.rows) - 1)
        return dr.lerp(self._bilinear(u, v, below), self._bilinear(u, v, above), level - mi.Float(below))

    def _bilinear(self, u: mi.Float, v: mi.Float, level: mi.UInt32) -> mi.Color3f:
        rows = mi.Int32(mi.UInt32(self.rows) >> level)
        columns = 2 * rows
        x, y = dr.fma(u, mi.Float(columns), -0.5), dr.fma(v, mi.Float(rows), -0.5)
        left, top = mi.Int32(dr.floor(dr.detach(x))), mi.Int32(dr.floor(dr.detach(y)))
        fx, fy = x - mi.Float(left), y - mi.Float(top)
        left = (left + columns) & (columns - 1)  # a power of two; u is in [-1/2, 1/2]
        right = (left + 1) & (columns - 1)
        above, below = dr.maximum(top, 0), dr.minimum(top + 1, rows - 1)
        start = self.first + ((self.rows * self.rows - rows * rows) * 8) // 3
        texel = lambda row, column: dr.gather(  # noqa: E731
            mi.Vector4f, self.packets, mi.UInt32(start + row * columns + column)
        )
        upper = dr.lerp(texel(above, left), texel(above, right), fx)
        lower = dr.lerp(texel(below, left), texel(below, right), fx)
        return mi.Color3f(dr.lerp(upper, lower, fy).xyz)

    def reflected(self, texels: Texels, n: mi.Vector3f, wi: mi.Vector3f) -> mi.Color3f:
        """
        What the specular lobe of a surface shows of the map; differentiable in everything.

        Parameters
        ----------
        texels : Texels
        n, wi : mi.Vector3f
            Unit shading normal, and direction to the viewer, on its side.
        """
        alpha = dr.square(dr.maximum(texels.roughness, microfacet.MIN_ROUGHNESS))
        alpha2 = dr.square(alpha)
        cos_i = dr.maximum(dr.dot(n, wi), 1e-3)
        f0 = dr.lerp(mi.Color3f(microfacet.DIELECTRIC_F0), texels.base_color, texels.metallic) * (1 - texels.gamma)
        # The directions turn with the viewer: a frame of the normal alone jumps somewhere.
        s = wi - n * dr.dot(n, wi)
        squared = dr.squared_norm(s)
        s = dr.select(squared > 1e-6, s * dr.rsqrt(dr.maximum(squared, 1e-6)), mi.coordinate_system(dr.detach(n))[0])
        t = dr.cross(n, s)
        stretched = mi.Vector3f(alpha * dr.dot(s, wi), 0, cos_i)
        stretched *= dr.rsqrt(dr.maximum(dr.squared_norm(stretched), 1e-12))
        g1 = microfacet.smith_g1(alpha2, cos_i)
        out = mi.Color3f(0)
        for across, around in _lattice(N_DIRECTIONS):
            z = dr.fma(1 - across, 1 + stretched.z, -stretched.z)
            r = dr.sqrt(dr.maximum(1 - dr.square(z), 1e-8))
            c = mi.Vector3f(r * float(np.cos(around)), r * float(np.sin(around)), z) + stretched
            h = s * (alpha * c.x) + t * (alpha * c.y) + n * c.z
            h *= dr.rsqrt(dr.maximum(dr.squared_norm(h), 1e-12))
            cos_d = dr.maximum(dr.dot(wi, h), 1e-3)
            wo = 2 * cos_d * h - wi
            cos_o = dr.dot(n, wo)
            # The weight of a visible normal is F G2 / G1; below the horizon it is zero, and falls to it continuously.
            lit = dr.maximum(cos_o, 0)
            weight = microfacet.smith_v(alpha2, cos_i, lit) * (4 * cos_i * lit) / g1
            pdf = microfacet.visible_normal_pdf(alpha2, n, wi, h)
            width = dr.rsqrt(dr.maximum(pdf * N_DIRECTIONS, 1e-6)) * (_WIDTH * self.rows / np.pi)
            level = dr.clip(dr.log2(width), 0, n_levels(self.rows) - 1)
            out += microfacet.schlick(f0, cos_d) * weight * self.lookup(wo, level)
        return out / N_DIRECTIONS


def _lattice(n: int) -> list[tuple[float, float]]:
    """Evenly spread points, the first coordinate in [0, 1), the second an angle."""
    k = np.arange(n)
    return list(zip(((k + 0.5) / n).tolist(), (2 * np.pi * ((k * 0.6180339887) % 1)).tolist(), strict=True))


class MapFilter:
    """
    The map's filters on the device: from its texels to what is looked up, and the way back of a gradient.

    Parameters
    ----------
    rows : int
    """

    def __init__(self, rows: int):
        matrix = filters(rows)
        self._forward, self._backward = _Product(matrix), _Product(matrix.T.tocsr())

    def filtered(self, texels: mi.Float) -> mi.Float:
        """Width 2·rows²·3 to that of the filtered map; detached."""
        return self._forward(texels)

    def gradient(self, grad: mi.Float) -> mi.Float:
        """Derivative by the texels, from that by what is looked up."""
        return self._backward(grad)


class _Product:
    """A sparse matrix times colours."""

    def __init__(self, matrix: csr_array):
        coo = matrix.tocoo()
        self._n = matrix.shape[0]
        self._row, self._column = (upload(mi.UInt32, index.astype(np.uint32)) for index in coo.coords)
        self._weight = upload(mi.Float, coo.data)

    def __call__(self, colors: mi.Float) -> mi.Float:
        out = dr.zeros(mi.Float, self._n * 3)
        for channel in range(3):
            value = dr.gather(mi.Float, colors, self._column * 3 + channel) * self._weight
            dr.scatter_reduce(dr.ReduceOp.Add, out, value, self._row * 3 + channel)
        dr.eval(out)
        return out


def looked_up(ambient: np.ndarray | None) -> mi.Float | None:
    """
    A model's ambient light, shape (K, 3), as the renderers look at it, flat: a map is filtered.
    """
    if ambient is None:
        return None
    flat = upload(mi.Float, np.ravel(np.asarray(ambient, np.float32)))
    rows = rows_of(len(ambient))
    return MapFilter(rows).filtered(flat) if rows else flat
