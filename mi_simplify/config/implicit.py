"""
The section ``implicit``: what is not in the distance function itself.
"""

from __future__ import annotations

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
