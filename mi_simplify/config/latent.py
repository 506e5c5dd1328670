"""
What the small model has besides its surface: ambient light (``latent.ambient``) and transparency (``opacity``).
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .section import Section, Triple


class AmbientSettings(Section):
    """Light from everywhere, besides the one point light of a view."""

    kind: Literal["auto", "none", "color", "environment"] = Field(
        "auto",
        description="`color`: a term `color · base colour`, as many renderers have. `environment`: distant light "
        "without shadows, in spherical harmonics of degree 3; it is written as `environment.exr`. `auto`: what "
        "the asset is known to be lit by; none for a model file.",
    )
    rows: Literal[0, 8, 16, 32, 64, 128] = Field(
        0,
        description="Of an `environment`: a latitude-longitude map of this many rows and twice as many columns instead "
        "of harmonics, as sharp as mirrors show it.",
    )
    color: Triple = Field((0.1, 0.1, 0.1), description="Where either starts: the same radiance from everywhere.")
    optimize: bool = Field(True, description="Find it together with the model; off: it stays as it starts.")
    export: Literal["fold", "drop"] = Field(
        "fold",
        description="`fold`: write the term of `color` as emission, so that every viewer shows it. `drop`: leave it "
        "out.",
    )


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
