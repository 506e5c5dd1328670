"""
What is written beside the model files, in the configuration.
"""

from __future__ import annotations

from pydantic import Field

from .section import Section


class CarriedSettings(Section):
    """Soft self-shadows for the whole clip: precomputed transfer, cast on the asset, in textures of the small model."""

    write: bool = Field(False, description="Write `transfer.npz`, and show it in the report under a turning sky.")
    size: int = Field(128, ge=8, le=512, description="Side of the textures [texels].")
    axes: int = Field(12, ge=1, le=64, description="Sets of textures, of which a frame is a weighted sum; at most.")
    frames: int = Field(32, ge=1, le=1000, description="Frames of the clip that rays are cast in, evenly spread.")
    directions: int = Field(256, ge=1, le=65536, description="Rays of a point.")
    order: int = Field(3, ge=0, le=3, description="Highest band of the spherical harmonics.")
