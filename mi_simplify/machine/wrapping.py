"""
What lies beyond the border of a texture, for lookups that repeat it.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

#: Wrap modes by the number that arrays of them have.
WRAPS = ("repeat", "mirror", "clamp")


def folded(x: mi.Float, size: int | mi.Int32, wrap: str) -> mi.Float:
    """
    The coordinate where a repeating bilinear lookup finds what a lookup of another wrap mode finds at ``x``.

    Parameters
    ----------
    x : mi.Float
        Along one axis; the image fills [0, 1].
    size : int or mi.Int32
        Texels along that axis, whose centres lie at (k + .5)/size.
    wrap : {'repeat', 'mirror', 'clamp'}
    """
    if wrap == "repeat":
        return x
    if wrap == "mirror":
        x = 1 - dr.abs(1 - (x - 2 * dr.floor(0.5 * x)))
    half = 0.5 / mi.Float(size)
    return dr.clip(x, half, 1 - half)
