"""
The latent textures in one packed image, so that a lookup is a few wide gathers and a gradient a few wide scatters.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

#: Order of the channels in memory; the last four are there only where opacity or gamma is used.
CHANNELS = ("red", "green", "blue", "roughness", "metallic", "nx", "ny", "nz", "opacity", "gamma", "free0", "free1")


@dataclass
class Texels:
    """
    Material at some surface points: linear base colour, scalars in [0, 1], tangent-space normal (not unit).
    """

    base_color: mi.Color3f
    roughness: mi.Float
    metallic: mi.Float
    normal: mi.Vector3f
    opacity: mi.Float
    gamma: mi.Float


class Textures:
    """
    Packed base colour, roughness, metalness, normal and, on request, opacity and γ.

    Parameters
    ----------
    base_color : ndarray, shape (H, W, 4)
    specular : ndarray, shape (H, W, 3)
        (gamma, roughness, metallic).
    normal : ndarray, shape (H, W, 3)
    extended : bool
        Keep opacity and γ; else they are 1 and 0.
    """

    def __init__(self, base_color: np.ndarray, specular: np.ndarray, normal: np.ndarray, extended: bool = False):
        self.height, self.width = base_color.shape[:2]
        self.n_channels = 12 if extended else 8
        planes = [base_color[..., :3], specular[..., 1:3], normal]
        if extended:
            planes += [base_color[..., 3:4], specular[..., :1], np.zeros((self.height, self.width, 2))]
        self.data = mi.Float(np.concatenate(planes, axis=2).astype(np.float32).ravel())

    @property
    def extended(self) -> bool:
        """Whether opacity and γ are there."""
        return self.n_channels == 12

    def images(self) -> dict[str, np.ndarray]:
        """
        ``base_color`` (H, W, 4), ``specular`` (H, W, 3) and unit ``normal`` (H, W, 3) in NumPy.
        """
        data = self.data.numpy().reshape(self.height, self.width, self.n_channels)
        one, zero = np.ones_like(data[..., :1]), np.zeros_like(data[..., :1])
        opacity, gamma = (data[..., 8:9], data[..., 9:10]) if self.extended else (one, zero)
        normal = data[..., 5:8]
        normal = normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-8)
        return dict(
            base_color=np.concatenate([data[..., :3], opacity], axis=2),
            specular=np.concatenate([gamma, data[..., 3:5]], axis=2),
            normal=normal,
        )

    def corners(self, u: mi.Float, v: mi.Float):
        """
        The four texels around a UV and their bilinear weights, texel centres at ``(k + .5)/N``, repeating.

        Returns
        -------
        index : list of mi.UInt32
            Texel indices ``y·W + x`` in the order 00, 10, 01, 11.
        fx, fy : mi.Float
            Fractions towards the second column and row; they carry the derivative by (u, v).
        """
        x, y = dr.fma(u, self.width, -0.5), dr.fma(v, self.height, -0.5)
        x0, y0 = dr.floor(dr.detach(x)), dr.floor(dr.detach(y))
        fx, fy = x - x0, y - y0
        ix, iy = self._wrap(mi.Int32(x0), self.width), self._wrap(mi.Int32(y0), self.height)
        jx = dr.select(ix + 1 < self.width, ix + 1, 0)
        jy = dr.select(iy + 1 < self.height, iy + 1, 0)
        rows = [iy * self.width, jy * self.width]
        index = [mi.UInt32(r + c) for r in rows for c in (ix, jx)]
        return index, fx, fy

    @staticmethod
    def _wrap(i: mi.Int32, n: int) -> mi.Int32:
        i = i - n * mi.Int32(dr.floor(mi.Float(i) * (1 / n)))
        return dr.clip(i, 0, n - 1)

    def lookup(self, u: mi.Float, v: mi.Float, active=True) -> mi.ArrayXf:
        """
        Bilinear texel values, shape (channels, N); differentiable by (u, v), never by the texels (see TexelTape).
        """
        index, fx, fy = self.corners(u, v)
        data = dr.detach(self.data)
        shape = (self.n_channels, dr.width(u))
        a, b, c, d = (dr.gather(mi.ArrayXf, data, i, active, shape=shape) for i in index)
        return dr.lerp(dr.lerp(a, b, fx), dr.lerp(c, d, fx), fy)

    def unpack(self, value: mi.ArrayXf) -> Texels:
        """
        Name the channels of a lookup.
        """
        extended = self.extended
        return Texels(
            base_color=mi.Color3f(value[0], value[1], value[2]),
            roughness=value[3],
            metallic=value[4],
            normal=mi.Vector3f(value[5], value[6], value[7]),
            opacity=value[8] if extended else mi.Float(1),
            gamma=value[9] if extended else mi.Float(0),
        )
