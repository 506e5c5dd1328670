"""
What all sections of the configuration share: their strictness, and the types that several of them use.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

#: ``package.module:name`` or ``path/file.py:name``: code of the user's own.
CODE_NAME = re.compile(r"^(?P<module>[A-Za-z_]\w*(\.[A-Za-z_]\w*)*|.+\.py):(?P<name>[A-Za-z_]\w*)$")

SAMPLE_PREFIX = "sample:"


@dataclass(frozen=True)
class PathMark:
    """
    Marks a key that names a file; a relative one is resolved against the file that holds the key.
    """


def names_no_file(text: str) -> bool:
    """
    Whether an asset's name stands for a sample or for something in an importable module, not for a file; or is an
    address, which readers refuse.
    """
    match = CODE_NAME.match(text)
    is_code = match is not None and not match["module"].endswith(".py")
    return is_code or text.startswith(SAMPLE_PREFIX) or "://" in text


def code_of(text: str) -> str:
    """
    The name in ``module:name``; empty where an asset's name is none of that kind.
    """
    match = CODE_NAME.match(text)
    return "" if match is None or text.startswith(SAMPLE_PREFIX) else match["name"]


FilePath = Annotated[str, Field(min_length=1), PathMark()]


def _as_tuple(value: object) -> object:
    """YAML's lists are Python's lists; nested ones, too."""
    return tuple(_as_tuple(x) for x in value) if isinstance(value, list | tuple) else value


Triple = Annotated[tuple[float, float, float], BeforeValidator(_as_tuple)]
Box = Annotated[tuple[tuple[float, float, float], tuple[float, float, float]], BeforeValidator(_as_tuple)]


def as_list(value: Any) -> Any:
    """
    As a tuple; a single value stands for a list of one.
    """
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def not_empty(value: tuple) -> tuple:
    """
    Refuse an empty list.
    """
    if not value:
        raise ValueError("should hold at least one value")
    return value


def distinct(value: tuple) -> tuple:
    """
    Refuse a list that names something twice.
    """
    if len(set(value)) != len(value):
        raise ValueError("should name nothing twice")
    return value


class Section(BaseModel):
    """
    Frozen, strict about types, and without unknown keys.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
