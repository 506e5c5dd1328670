"""
Adam on the packed latent textures: one kernel for moments, step and projection of the texels that were seen.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ...latent.footprint import BLOCK
from ...latent.texel_gradient import TexelGradient
from ...latent.textures import Textures
from ...machine.upload import upload


class TexelAdam:
    """
    Adam (Kingma and Ba 2015) that leaves texels alone which the step's images did not show.

    Moments and bias corrections count a texel's own updates, so that texels seen late start as gently as those
    seen first, and texels never seen stay as they were.

    Parameters
    ----------
    textures : Textures
        Changed in place by :meth:`step`.
    rates : dict
        Learning rate at the start of ``base_color``, ``roughness``, ``metallic``, ``normal``, ``opacity``, ``gamma``;
        0 keeps it.
    min_roughness : float
        Lower limit.
    """

    def __init__(self, textures: Textures, rates: dict[str, float], min_roughness: float, beta1=0.9, beta2=0.99):
        self.textures, self.beta1, self.beta2 = textures, beta1, beta2
        n = dr.width(textures.data) // textures.n_channels
        self.m = dr.opaque(mi.Float, 0, n * textures.n_channels)
        self.v = dr.opaque(mi.Float, 0, n * textures.n_channels)
        self.count = dr.opaque(mi.Float, 0, n)
        self._min_roughness = dr.opaque(mi.Float, min_roughness)
        names = ("base_color",) * 3 + ("roughness", "metallic") + ("normal",) * 3 + ("opacity", "gamma")
        per_channel = [rates.get(name, 0.0) for name in names] + [0.0, 0.0]
        self._rates = [dr.opaque(mi.Float, r) for r in per_channel[: textures.n_channels]]
        self.channels = tuple(k for k, r in enumerate(per_channel[: textures.n_channels]) if r > 0)
        """Those that change."""

    def step(self, grad: TexelGradient, factor: mi.Float) -> None:
        """
        One update of the texels in ``grad`` whose gradient is not zero.

        Parameters
        ----------
        grad : TexelGradient
        factor : mi.Float, width 1, opaque
            Of all rates.
        """
        textures, n = self.textures, self.textures.n_channels
        grad = grad.by_parameters(textures)
        load = lambda buffer, i: dr.gather(mi.ArrayXf, buffer, i, shape=(n, dr.width(i)))  # noqa: E731
        lane = dr.arange(mi.UInt32, dr.width(grad.blocks) * BLOCK)
        lane = dr.compress(dr.any(load(grad.values, lane) != 0))  # half of them, or fewer
        if dr.width(lane) == 0:
            return
        block = lane // BLOCK
        texel = dr.gather(mi.UInt32, grad.blocks, block) * BLOCK + (lane - block * BLOCK)
        g = load(grad.values, lane)
        x, m, v = (load(_same_memory(buffer), texel) for buffer in (textures.data, self.m, self.v))
        count = dr.gather(mi.Float, _same_memory(self.count), texel) + 1
        m = dr.lerp(g, m, self.beta1)
        v = dr.lerp(dr.square(g), v, self.beta2)
        correct1 = dr.rcp(1 - dr.exp2(count * math.log2(self.beta1)))
        correct2 = dr.rcp(1 - dr.exp2(count * math.log2(self.beta2)))
        rates = mi.ArrayXf(self._rates) * factor
        x = self._project(x - rates * (m * correct1) * dr.rsqrt(dr.maximum(v * correct2, 1e-24)))
        for buffer, value in ((textures.data, x), (self.m, m), (self.v, v), (self.count, count)):
            dr.scatter(buffer, value, texel)
        dr.eval(textures.data, self.m, self.v, self.count)
        textures.refresh()

    def step_some(self, texel: mi.UInt32, grad: mi.ArrayXf, factor: mi.Float) -> None:
        """
        One update of some texels of a texture of one level, in :attr:`channels` alone; whose gradient is zero stays.

        Parameters
        ----------
        texel : mi.UInt32, width T
            All different, as they are stored.
        grad : mi.ArrayXf, shape (len(channels), T)
        factor : mi.Float, width 1, opaque
        """
        n, active = self.textures.n_channels, dr.any(grad != 0)
        count = dr.gather(mi.Float, self.count, texel, active) + 1
        correct1 = dr.rcp(1 - dr.exp2(count * math.log2(self.beta1)))
        correct2 = dr.rcp(1 - dr.exp2(count * math.log2(self.beta2)))
        data, first, second = self.textures.data, self.m, self.v
        # What a projection looks at besides: a normal is one as a whole.
        whole = sorted({*self.channels, *(_NORMAL if {*_NORMAL} & {*self.channels} else ())})
        x = {c: dr.gather(mi.Float, data, texel * n + c, active) for c in whole}
        moments = []
        for k, c in enumerate(self.channels):
            m = dr.lerp(grad[k], dr.gather(mi.Float, first, texel * n + c, active), self.beta1)
            v = dr.lerp(dr.square(grad[k]), dr.gather(mi.Float, second, texel * n + c, active), self.beta2)
            x[c] = x[c] - self._rates[c] * factor * (m * correct1) * dr.rsqrt(dr.maximum(v * correct2, 1e-24))
            moments += [(self.m, c, m), (self.v, c, v)]
        projected = self._project(mi.ArrayXf([x.get(c, mi.Float(0)) for c in range(n)]))
        changes = [*moments, *((self.textures.data, c, projected[c]) for c in whole)]
        dr.eval(active, count, *(value for _, _, value in changes))  # all is read before anything is written
        del data, first, second  # a buffer with a second name would be copied before it is written
        for buffer, c, value in changes:
            dr.scatter(buffer, value, texel * n + c, active)
        dr.scatter(self.count, count, texel, active)
        dr.eval(self.textures.data, self.m, self.v, self.count)

    def _project(self, x: mi.ArrayXf) -> mi.ArrayXf:
        """
        Back into range: reflectances and weights in [0, 1], roughness above its limit, unit normals up.
        """
        unit = [dr.clip(x[k], 0, 1) for k in range(self.textures.n_channels)]
        unit[3] = dr.clip(x[3], self._min_roughness, 1)
        normal = mi.Vector3f(x[5], x[6], dr.maximum(x[7], 0.05))
        normal *= dr.rsqrt(dr.maximum(dr.squared_norm(normal), 1e-12))
        unit[5:8] = normal.x, normal.y, normal.z
        return mi.ArrayXf(unit)

    def is_finite(self) -> bool:
        """
        Whether no NaN or infinity has come in; waits for the device.
        """
        # The texels themselves do not tell: NaN, clipped into its range, is a number again.
        return bool(dr.all(dr.isfinite(self.m) & dr.isfinite(self.v))[0])

    def state(self) -> dict:
        """
        Texels, moments and counts: copies, since steps are written in place.
        """
        arrays = {"data": self.textures.data, "m": self.m, "v": self.v, "count": self.count}
        return {name: array.numpy().copy() for name, array in arrays.items()}

    def restore(self, state: dict) -> None:
        """
        Inverse of :meth:`state`.
        """
        self.textures.data, self.m, self.v, self.count = (
            upload(mi.Float, state[name]) for name in ("data", "m", "v", "count")
        )

    def restart(self, data: np.ndarray) -> None:
        """
        Go on from the texels of an earlier state, the moments forgotten.
        """
        zero = np.zeros_like(data)
        self.restore({"data": data, "m": zero, "v": zero, "count": np.zeros(len(data) // self.textures.n_channels)})


#: Channels of the normal.
_NORMAL = (5, 6, 7)


def _same_memory(buffer: mi.Float) -> mi.Float:
    """
    A second array over the memory of a buffer, to be read in the kernel that writes the buffer.

    Every entry is read before it is written, by one lane and no other; Dr.Jit, which cannot know, would copy the buffer
    first. On a GPU this *is* a copy.
    """
    return mi.Float(buffer.numpy())
