"""
The section ``images``: captured images as the asset.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .section import FilePath, Section


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
