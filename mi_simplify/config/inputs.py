"""
The sections ``implicit`` and ``images``: what an asset of these kinds does not say of itself.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .section import Box, FilePath, Section, Triple


class ImplicitSettings(Section):
    """An implicit surface as the asset; its own code is run, see How it works."""

    material: FilePath | None = Field(
        None, description="Its material function, `package.module:NAME` or `file.py:NAME`; none: its own, or grey."
    )
    bounds: Box | None = Field(
        None, description="A box around it, two corners in its own units; none: its own, or it is searched for."
    )
    ambient: Triple | None = Field(
        None, description="Light from everywhere, which adds this times the base colour; none: its own, or black."
    )
    resolution: int = Field(
        192, ge=16, le=1024, description="Cells along its longest side in the isosurface that a first guess is made of."
    )


class ImagesSettings(Section):
    """A `transforms.json` with images and cameras as the asset."""

    light: Literal["auto", "point", "unlit", "environment"] = Field(
        "auto",
        description="What lit them. `point`: the light that each frame names. `unlit`: nothing, their colours are the "
        "base colours. `environment`: something static and unknown, which is found together with the model. `auto`: "
        "what the file says, else `environment`.",
    )
    held_out: FilePath | None = Field(
        None, description="Another such file whose images are never fitted, but judged by; none: those of `every`."
    )
    every: int = Field(8, ge=2, description="One in so many images is never fitted, but judged by.")
    resolution: int = Field(
        96, ge=16, le=512, description="Cells along the longest side of the hull that a first guess is made of."
    )
