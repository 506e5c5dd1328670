"""
Settings of characters: assets with a skeleton and an animation.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .section import Section


class AnimationSettings(Section):
    """Characters: assets with a skeleton and an animation. Others do not read it."""

    frames: str | None = Field(
        None,
        pattern=r"^-?\d+(\.\d*)?:-?\d+(\.\d*)?(:[1-9]\d*)?$",
        description="`FIRST:LAST` or `FIRST:LAST:STEP`: part of the clip, in the numbers that its file has (USD: time "
        "codes; glTF: frames from 0, 24 a second); none: all of it.",
    )
    held_out: int = Field(
        8, ge=1, le=1000, description="Frames, evenly spread, that the fit does not see and the result is judged in."
    )
    bind_pose_only: bool = Field(
        False, description="Fit in the bind pose alone; weights are carried over from the asset and stay as they are."
    )
    influences: Literal[4, 8] = Field(4, description="Joints that may pull at a vertex of an exported file, at most.")
