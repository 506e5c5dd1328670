"""
How much, in a person's words: a number, a share of what the asset has, bytes, or ``auto``.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from .section import Section

LEAST_TRIANGLES = 4
"""A closed surface has no fewer."""

_SHARE = re.compile(r"^\s*(\d+(?:\.\d+)?|\.\d+)\s*%\s*$")
_BYTES = re.compile(r"^\s*(\d+(?:\.\d+)?|\.\d+)\s*([kMG]?)B?\s*$", re.IGNORECASE)
_DECIMAL = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}


def triangles(value: Any) -> Any:
    """
    A budget of triangles as it is kept: a whole number, or a share such as ``30%``; None stays.

    Raises
    ------
    ValueError
        It is neither.
    """
    if isinstance(value, str) and value.strip().isdecimal():
        value = int(value)
    if isinstance(value, int) and not isinstance(value, bool):
        if value < LEAST_TRIANGLES:
            raise ValueError(f"should be greater than or equal to {LEAST_TRIANGLES}, got {value}")
        return value
    if value is None or (isinstance(value, str) and 0 < 100 * _share(value) <= 100):
        return value
    raise ValueError(f"should be a number of triangles such as 2000, or a share such as 30%, got {value!r:.40}")


def _share(text: str) -> float:
    found = _SHARE.match(text)
    return float(found[1]) / 100 if found else 0.0


def resolved(budget: int | str, of: int) -> int:
    """
    The number that a budget stands for where the whole is ``of``; never fewer than a surface needs.
    """
    return max(LEAST_TRIANGLES, round(_share(budget) * of)) if isinstance(budget, str) else budget


def n_bytes(value: Any) -> Any:
    """
    Bytes of a file as people write them, ``500kB`` or ``1.5 MB`` (powers of 1000); a number, and None, stay.

    Raises
    ------
    ValueError
        It is none.
    """
    found = _BYTES.match(value) if isinstance(value, str) else None
    if found:
        value = round(float(found[1]) * _DECIMAL[found[2].lower()])
    if value is None or (isinstance(value, int) and not isinstance(value, bool) and value > 0):
        return value
    raise ValueError(f"should be a size of a file such as 500kB or 1.5MB, got {value!r:.40}")


def _atlas_size(value: Any) -> Any:
    if value == "auto" or (isinstance(value, int) and not isinstance(value, bool) and 16 <= value <= 8192):
        return value
    raise ValueError(f"should be auto, or a number of texels from 16 to 8192, got {value!r:.40}")


class GoalSettings(Section):
    """The result by what it should reach instead of by its size, at most one of these: the least model that does."""

    psnr: float | None = Field(None, gt=0, lt=100, description="PSNR on held-out views, at least [dB].")
    flip: float | None = Field(None, gt=0, lt=1, description="FLIP on held-out views, at most.")
    screen_size: float | None = Field(
        None,
        ge=16,
        le=2048,
        description="Diameter of the bounding sphere on a screen [pixels] at which nobody sees a difference: FLIP over "
        "what is covered below 0.04, without aliasing; the model is prefiltered for that size.",
    )

    @model_validator(mode="after")
    def _is_one(self) -> GoalSettings:
        given = [name for name, value in self if value is not None]
        if len(given) > 1:
            raise ValueError(f"`{given[0]}` and `{given[1]}` are two goals; name one of them")
        return self


Triangles = Annotated[int | str | None, BeforeValidator(triangles)]
Bytes = Annotated[int | None, BeforeValidator(n_bytes)]
AtlasSize = Annotated[int | Literal["auto"], BeforeValidator(_atlas_size)]
