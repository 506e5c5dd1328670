"""
How the small model is transparent: while it is fitted, and in the files.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .section import Section


class OpacitySettings(Section):
    """Transparency of the small model; opaque ones ignore all of it."""

    layers: int = Field(
        8,
        ge=1,
        le=64,
        description="Surfaces that a camera ray goes through where their opacity is below 1; what lies beyond is "
        "counted and reported.",
    )
    cards: Literal["mask", "blend", "opaque"] = Field(
        "mask",
        description="How cards leave. `mask`: cut out at an opacity of one half, towards which the fit drives them. "
        "`blend`: transparent. `opaque`: quads of the same area without opacity, which renderers of clustered geometry "
        "prefer.",
    )
    steepness: float = Field(
        8.0, ge=1, description="How steeply a mask is cut at the end of the fit; at its start opacity is itself."
    )
