"""
The latent textures in one packed image, so that a lookup is a few wide gathers and a gradient a few wide scatters.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..upload import upload

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


@dataclass
class Footprint:
    """
    The texels that a lookup reads: where they are stored, in the order 00, 10, 01, 11, and the fractions towards the
    second column and row, which carry the derivative by the UV.
    """

    index: list[mi.UInt32]
    fx: mi.Float
    fy: mi.Float


#: Texels are stored in square tiles of this side: what one lookup reads lies close together, and so do its neighbours'.
TILE = 8
#: Texels that gradients and optimiser steps are kept for together: two rows of a tile.
BLOCK = 16


@dataclass
class TouchedBlocks:
    """
    The blocks that some lookups read, ascending; where each stands in that list; how many there is room for.
    """

    blocks: mi.UInt32
    slot: mi.UInt32
    room: int

    @staticmethod
    def flags(textures: Textures, footprint: Footprint) -> mi.UInt32:
        """
        One flag a block; a pending side effect of the caller's next kernel.
        """
        flags = dr.zeros(mi.UInt32, textures.n_stored // BLOCK)
        blocks = [i // BLOCK for i in footprint.index]
        for k, block in enumerate(blocks):
            is_new = mi.Bool(True)
            for earlier in blocks[:k]:
                is_new &= block != earlier
            dr.scatter_reduce(dr.ReduceOp.Or, flags, mi.UInt32(1), block, is_new)  # plain ones would be a kernel each
        return flags

    @staticmethod
    def of(textures: Textures, flags: mi.UInt32) -> TouchedBlocks:
        """
        The list; reads its length back.
        """
        blocks = dr.compress(flags != 0)
        slot = dr.empty(mi.UInt32, dr.width(flags))
        dr.scatter(slot, dr.arange(mi.UInt32, dr.width(blocks)), blocks)
        dr.eval(slot)
        return TouchedBlocks(blocks, slot, textures.gradient_room(dr.width(blocks)))


@dataclass
class TexelGradient:
    """
    Gradient of the texels that a step touched, in blocks of :data:`BLOCK` consecutive stored ones.

    Parameters
    ----------
    blocks : mi.UInt32, width K
        Block numbers, ascending.
    values : mi.Float, width K·BLOCK·channels or more
    """

    blocks: mi.UInt32
    values: mi.Float

    @staticmethod
    def collect(textures: Textures, footprint: Footprint, blocks: TouchedBlocks, grad: mi.ArrayXf) -> TexelGradient:
        """
        The transposed lookup: add ``grad``, shape (channels, N), to the texels with their bilinear weights.

        Notes
        -----
        The sum is a pending side effect: evaluate ``values`` with what else the kernel computes. Cost grows with the
        texels touched, not with those there are.
        """
        values = dr.zeros(mi.Float, blocks.room * BLOCK * textures.n_channels)
        fx, fy = dr.detach(footprint.fx), dr.detach(footprint.fy)
        weights = ((1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy)
        for i, w in zip(footprint.index, weights, strict=True):
            block = i // BLOCK
            target = dr.gather(mi.UInt32, blocks.slot, block) * BLOCK + (i - block * BLOCK)
            # A private copy per thread: atomics on a coherent image cost twenty times as much.
            dr.scatter_reduce(dr.ReduceOp.Add, values, grad * w, target, mode=dr.ReduceMode.Expand)
        return TexelGradient(blocks.blocks, values)

    def dense(self, textures: Textures) -> mi.Float:
        """
        Gradient of all texels, row by row, width H·W·channels.
        """
        n = textures.n_channels
        out = dr.zeros(mi.Float, textures.n_stored * n)
        span = BLOCK * n
        lane = dr.arange(mi.UInt32, dr.width(self.blocks) * span)
        block = lane // span
        place = dr.gather(mi.UInt32, self.blocks, block) * span + (lane - block * span)
        dr.scatter(out, dr.gather(mi.Float, self.values, lane), place)
        texel = dr.arange(mi.UInt32, textures.n_texels)
        row = texel // textures.width
        place = textures.place(row, texel - row * textures.width)
        return dr.ravel(dr.gather(mi.ArrayXf, out, place, shape=(n, textures.n_texels)))


@dataclass(init=False, eq=False)
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

    data: mi.Float
    height: int
    width: int
    n_channels: int

    def __init__(self, base_color: np.ndarray, specular: np.ndarray, normal: np.ndarray, extended: bool = False):
        self.height, self.width = base_color.shape[:2]
        self.n_channels = 12 if extended else 8
        planes = [base_color[..., :3], specular[..., 1:3], normal]
        if extended:
            planes += [base_color[..., 3:4], specular[..., :1], np.zeros((self.height, self.width, 2))]
        packed = np.zeros((self.n_stored, self.n_channels), np.float32)
        packed[self.place(*np.indices((self.height, self.width)))] = np.concatenate(planes, axis=2)
        self.data = upload(mi.Float, packed.ravel())
        self._room = 0

    @property
    def n_texels(self) -> int:
        """Texels in all."""
        return self.width * self.height

    @property
    def n_stored(self) -> int:
        """Texels in memory: those of whole tiles."""
        return -(-self.width // TILE) * -(-self.height // TILE) * TILE**2

    def place(self, row, column):
        """
        Where a texel is stored, counted in texels; for NumPy and Dr.Jit integers.
        """
        tile = (row // TILE) * -(-self.width // TILE) + column // TILE
        return (tile * TILE + row % TILE) * TILE + column % TILE

    def gradient_room(self, n_blocks: int) -> int:
        """
        Blocks to make room for where a gradient has ``n_blocks``: hardly ever another number than before.

        Every size of what threads add up in private copies is a kernel of its own, compiled for a third of a second.
        """
        if n_blocks > self._room:
            need = n_blocks + n_blocks // 2
            unit = 1 << max(need.bit_length() - 3, 0)
            self._room = min(-(-need // unit) * unit, self.n_stored // BLOCK)
        return self._room

    @property
    def extended(self) -> bool:
        """Whether opacity and γ are there."""
        return self.n_channels == 12

    def images(self) -> dict[str, np.ndarray]:
        """
        ``base_color`` (H, W, 4), ``specular`` (H, W, 3) and unit ``normal`` (H, W, 3) in NumPy.
        """
        data = self.data.numpy().reshape(-1, self.n_channels)[self.place(*np.indices((self.height, self.width)))]
        one, zero = np.ones_like(data[..., :1]), np.zeros_like(data[..., :1])
        opacity, gamma = (data[..., 8:9], data[..., 9:10]) if self.extended else (one, zero)
        normal = data[..., 5:8]
        normal = normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-8)
        return dict(
            base_color=np.concatenate([data[..., :3], opacity], axis=2),
            specular=np.concatenate([gamma, data[..., 3:5]], axis=2),
            normal=normal,
        )

    def footprint(self, u: mi.Float, v: mi.Float) -> Footprint:
        """
        The four texels around a UV and their bilinear weights, texel centres at ``(k + .5)/N``, repeating.
        """
        x, y = dr.fma(u, self.width, -0.5), dr.fma(v, self.height, -0.5)
        x0, y0 = dr.floor(dr.detach(x)), dr.floor(dr.detach(y))
        ix, iy = self._wrap(mi.Int32(x0), self.width), self._wrap(mi.Int32(y0), self.height)
        jx = dr.select(ix + 1 < self.width, ix + 1, 0)
        jy = dr.select(iy + 1 < self.height, iy + 1, 0)
        index = [self.place(mi.UInt32(r), mi.UInt32(c)) for r in (iy, jy) for c in (ix, jx)]
        return Footprint(index, x - x0, y - y0)

    @staticmethod
    def _wrap(i: mi.Int32, n: int) -> mi.Int32:
        i = i - n * mi.Int32(dr.floor(mi.Float(i) * (1 / n)))
        # The quotient of a multiple of n may come out one off.
        return dr.select(i < 0, i + n, dr.select(i >= n, i - n, i))

    def lookup(self, footprint: Footprint) -> mi.ArrayXf:
        """
        Bilinear texel values, shape (channels, N); differentiable by the UV, never by the texels, for which there is
        :class:`TexelGradient`.
        """
        data = dr.detach(self.data)
        shape = (self.n_channels, dr.width(footprint.index[0]))
        a, b, c, d = (dr.gather(mi.ArrayXf, data, i, shape=shape) for i in footprint.index)
        return dr.lerp(dr.lerp(a, b, footprint.fx), dr.lerp(c, d, footprint.fx), footprint.fy)

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
