"""
What is wrong with a configuration, in one line: the dotted path, what was expected, the nearest key.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..errors import ConfigError
from .schema import Config, asset_first
from .section import Section

S = TypeVar("S", bound=Section)


def nearest(name: str, known: Iterable[str]) -> str:
    """
    The hint at a likely misspelling, or nothing.
    """
    match = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f", did you mean '{match[0]}'?" if match else ""


def dotted_keys(model: type[BaseModel] = Config, prefix: str = "") -> Iterator[str]:
    """
    Every key of the schema, sections left out, in order.
    """
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from dotted_keys(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name


def _unknown_key(location: tuple[str, ...], schema: type[BaseModel]) -> str:
    """The sentence for a key that the schema lacks, with the nearest one that it has."""
    model = schema
    for section in location[:-1]:
        kind = model.model_fields[section].annotation if section in model.model_fields else None
        if not (isinstance(kind, type) and issubclass(kind, BaseModel)):  # within a list
            return f"{'.'.join(location)}: unknown key"
        model = kind
    name = location[-1]
    hint = nearest(name, model.model_fields)
    if not hint:  # perhaps right but in another section
        elsewhere = {key.rpartition(".")[2]: key for key in dotted_keys(schema)}
        match = difflib.get_close_matches(name, list(elsewhere), n=1, cutoff=0.6)
        hint = (
            f", did you mean '{elsewhere[match[0]]}'?"
            if match
            else f"; known here: {', '.join(asset_first(model.model_fields))}"
        )
    return f"{'.'.join(location)}: unknown key{hint}"


def describe(error: ValidationError, schema: type[BaseModel] = Config) -> str:
    """
    One line for all problems that pydantic found in what should be of a schema, at most three of them spelled out.
    """
    lines = []
    for problem in error.errors():
        location = tuple(_cut(str(part)) for part in problem["loc"])
        path = ".".join(location) or "configuration"
        kind, given = problem["type"], problem["input"]
        if kind == "extra_forbidden":
            lines.append(_unknown_key(location, schema))
        elif kind == "missing":
            lines.append(f"{path}: missing, it has no default")
        elif kind in ("model_type", "model_attributes_type"):
            lines.append(f"{path}: is a section, expected keys below it, got {_quoted(given)}")
        elif kind == "value_error":
            lines.append(f"{path}: {problem['ctx']['error']}")
        else:
            expected = re.sub(r"^\w+ should", "should", problem["msg"])
            lines.append(f"{path}: {expected}, got {_quoted(given)}")
    more = f"; and {len(lines) - 3} more" if len(lines) > 3 else ""
    return "; ".join(lines[:3]) + more


def validated(schema: type[S], values: Mapping[str, Any]) -> S:
    """
    A section of these values, nested as in YAML.

    Raises
    ------
    ConfigError
        One line: an unknown key and the nearest one, a wrong type, out of range.
    """
    try:
        return schema.model_validate(dict(values))
    except ValidationError as error:
        raise ConfigError(describe(error, schema)) from None


def _quoted(value: Any) -> str:
    return _cut(repr(value))


def _cut(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
