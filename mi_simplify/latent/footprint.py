"""
Which texels a lookup reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

#: Texels that gradients and optimiser steps are kept for together: two rows of a tile.
BLOCK = 16


@dataclass
class Footprint:
    """
    The texels that a lookup reads: where they are stored, in the order 00, 10, 01, 11, and the fractions towards the
    second column and row, which carry the derivative by the UV.

    Of a trilinear lookup these are the texels of the finer level; ``coarser`` has the others, and ``blend`` the
    fraction towards them, which carries the derivative by the level.
    """

    index: list[mi.UInt32]
    fx: mi.Float
    fy: mi.Float
    coarser: Footprint | None = None
    blend: mi.Float | None = None

    def weighted(self) -> list[tuple[mi.UInt32, mi.Float]]:
        """
        All texels with their detached weights, which sum to one.
        """
        fx, fy = dr.detach(self.fx), dr.detach(self.fy)
        weights = ((1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy)
        own = list(zip(self.index, weights, strict=True))
        if self.coarser is None:
            return own
        blend = dr.detach(self.blend)
        return [(i, w * (1 - blend)) for i, w in own] + [(i, w * blend) for i, w in self.coarser.weighted()]
