"""
The gradient of the texels that lookups read: sparse, in blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .footprint import BLOCK, Footprint
from .textures import Textures


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
        blocks = [i // BLOCK for i, _ in footprint.weighted()]
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
        for i, w in footprint.weighted():
            block = i // BLOCK
            target = dr.gather(mi.UInt32, blocks.slot, block) * BLOCK + (i - block * BLOCK)
            # A private copy per thread: atomics on a coherent image cost twenty times as much.
            dr.scatter_reduce(dr.ReduceOp.Add, values, grad * w, target, mode=dr.ReduceMode.Expand)
        return TexelGradient(blocks.blocks, values)

    def spread_out(self, textures: Textures) -> mi.Float:
        """
        Gradient of all texels as they are stored, width n_stored·channels.
        """
        out = dr.zeros(mi.Float, textures.n_stored * textures.n_channels)
        span = BLOCK * textures.n_channels
        lane = dr.arange(mi.UInt32, dr.width(self.blocks) * span)
        block = lane // span
        place = dr.gather(mi.UInt32, self.blocks, block) * span + (lane - block * span)
        dr.scatter(out, dr.gather(mi.Float, self.values, lane), place)
        return out

    def dense(self, textures: Textures, level: int = 0) -> mi.Float:
        """
        Gradient of all texels of a level, row by row, width H·W·channels.
        """
        n, place = textures.n_channels, textures.places(level)
        return dr.ravel(dr.gather(mi.ArrayXf, self.spread_out(textures), place, shape=(n, dr.width(place))))

    def by_parameters(self, textures: Textures) -> TexelGradient:
        """
        The gradient of what is a parameter: with derived levels that of the finest one, through which all are made.
        """
        if textures.mips != "derived" or textures.n_levels == 1:
            return self
        n = textures.n_channels
        load = lambda buffer, i: dr.gather(mi.ArrayXf, buffer, i, shape=(n, dr.width(i)))  # noqa: E731
        stored = self.spread_out(textures)
        total = load(stored, textures.places(textures.n_levels - 1))
        for level in reversed(range(textures.n_levels - 1)):
            height, width = textures.size(level)
            texel = dr.arange(mi.UInt32, height * width)
            row = texel // width
            above = (row // 2) * textures.size(level + 1)[1] + (texel - row * width) // 2
            share = 0.5 if 1 in (height, width) else 0.25  # of two texels, or of four
            flat = dr.ravel(total)
            dr.eval(flat)
            total = load(stored, textures.places(level)) + share * load(flat, above)
        values = dr.zeros(mi.Float, textures.room(0) * n)
        dr.scatter(values, total, textures.places(0))
        dr.eval(values)
        return TexelGradient(dr.arange(mi.UInt32, dr.width(values) // (BLOCK * n)), values)
