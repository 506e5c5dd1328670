"""
What all sections of the configuration share: their strictness, and the types that several of them use.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

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

    def stating(self, given: Mapping[str, Any]) -> Self:
        """
        The same values, of which only those that ``given`` names, nested as in YAML, count as stated by somebody.
        """
        copy = self.model_copy(update={n: v.stating(given.get(n, {})) for n, v in self if isinstance(v, Section)})
        copy.model_fields_set.intersection_update(given)
        return copy

    def started(self, values: Mapping[str, Any]) -> Self:
        """
        With these values, nested as in YAML and valid, for keys that nobody has stated.
        """
        nested = {name: getattr(self, name).started(v) for name, v in values.items() if isinstance(v, Mapping)}
        plain = {name: v for name, v in values.items() if name not in nested and name not in self.model_fields_set}
        return self.model_copy(update=nested | plain)
