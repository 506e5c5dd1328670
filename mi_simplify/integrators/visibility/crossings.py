"""
Samples on the curves of a film across which an image jumps, and how these curves move.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Crossings:
    """
    Points on curves across which an image may jump, detached but for the last.

    (x, y) is the film position [pixels], (nx, ny) the unit normal of the curve on the film, ``weight`` the length of
    curve [pixels] that the point stands for, ``step`` how far off the curve [pixels] either side is looked at, ``p``
    the point in the world, ``end0 end1`` positions whose faces count as being there, ``outline`` tells borders of
    a surface from lines inside it, ``motion`` is where the curve lies along its normal [pixels]: only its derivative
    matters. What lies on the low side gains area where it grows.

    Borders of shadows are not looked at from beside: the camera ray meets the border itself, and shadow rays start at
    ``aside`` to either side of there [scene units]. A step on the film that is wide enough for shadow rays would lose
    all borders that nearly coincide with a silhouette.
    """

    view: mi.UInt32
    x: mi.Float
    y: mi.Float
    nx: mi.Float
    ny: mi.Float
    weight: mi.Float
    step: mi.Float
    p: mi.Point3f
    end0: mi.UInt32
    end1: mi.UInt32
    outline: mi.Bool
    motion: mi.Float
    aside: mi.Vector3f | None = None

    def shows(self, low: mi.Bool, high: mi.Bool) -> mi.Bool:
        """
        Whether the jump is that of the curve, of whether rays to either side meet it.

        Behind other surfaces nothing jumps. A line inside a surface shows only where both sides meet that surface.
        """
        return dr.select(self.outline, low | high, low & high)


@dataclass
class Eyes:
    """
    Points or directions that a scene is seen from: lights that cast sharp shadows.

    Parameters
    ----------
    packets : mi.Float
        ``x, y, z, w`` each: a place (w = 1), or the direction *to* a light far away (w = 0); attached where it moves.
    """

    packets: mi.Float
    n: int

    def fetch(self, eye: mi.UInt32) -> mi.Vector4f:
        """Packets of some of them."""
        return dr.gather(mi.Vector4f, self.packets, eye)

    @staticmethod
    def towards(packet: mi.Vector4f, p: mi.Point3f) -> mi.Vector3f:
        """A vector from a point to an eye, of any length."""
        return mi.Vector3f(packet.xyz) - mi.Vector3f(p) * packet.w


def drawn(weight: mi.Float, n_samples: int, seed: mi.UInt32) -> tuple[mi.UInt32, mi.Float, mi.Float, mi.Float]:
    """
    A stratified draw of items in proportion to their weights.

    Returns
    -------
    item : mi.UInt32, width n_samples
    u, v : mi.Float
        Uniform in [0, 1).
    scale : mi.Float
        One over the mean number of samples that a unit of weight gets; 0 where no item has any weight.
    """
    n = dr.width(weight)
    total = dr.cumsum(weight)
    sum_ = dr.gather(mi.Float, total, n - 1)
    lane = dr.arange(mi.UInt32, n_samples)
    r0, r1 = mi.sample_tea_32(lane, seed, 6)
    r2, _ = mi.sample_tea_32(lane, seed + 0x51ED270B, 6)
    target = (mi.Float(lane) + mi.Float(r0) * 2.0**-32) * (1 / n_samples) * sum_
    item = dr.binary_search(0, n - 1, lambda i: dr.gather(mi.Float, total, i) <= target)
    to_unit = 2.0**-32
    return item, mi.Float(r1) * to_unit, mi.Float(r2) * to_unit, sum_ * (1 / n_samples)
