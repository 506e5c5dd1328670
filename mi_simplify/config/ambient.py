"""
The section ``latent.ambient``: light besides the one point light of a view.
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
    color: Triple = Field((0.1, 0.1, 0.1), description="Where either starts: the same radiance from everywhere.")
    optimize: bool = Field(True, description="Find it together with the model; off: it stays as it starts.")
    export: Literal["fold", "drop"] = Field(
        "fold",
        description="`fold`: write the term of `color` as emission, so that every viewer shows it. `drop`: leave it "
        "out.",
    )
