"""
The schema told to people and to editors: a Markdown table of every key, and JSON Schema.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from .presets import PRESETS, STARTS
from .schema import Config, asset_first

_LIMITS = {
    "minimum": "≥ {}",
    "exclusiveMinimum": "> {}",
    "maximum": "≤ {}",
    "exclusiveMaximum": "< {}",
}


def json_schema() -> dict[str, Any]:
    """
    JSON Schema of the configuration, for editors that complete and check YAML.
    """
    return Config.model_json_schema()


def markdown() -> str:
    """
    The page docs/config.md: every key with type, range, default and meaning.
    """
    lines = [
        "# Configuration keys",
        "",
        "Generated from the schema by `mi-simplify config-schema`; edit `mi_simplify/config/` instead.",
        "",
        "A run is described by one YAML file. What it leaves out takes the default below; `preset` lies between",
        "the defaults and the file, `--set key=value` lies above it. Unknown keys are errors.",
        "",
        "Lengths are in the normalised frame (the asset's box has side 2 and centre 0), angles in degrees,",
        "colours linear. Relative paths in a file are relative to that file, on the command line to the",
        "working directory.",
    ]
    for title, intro, rows in _sections(Config, ""):
        lines += ["", f"## {title}", "", intro, "", "| key | type | default | meaning |", "| --- | --- | --- | --- |"]
        lines += rows
    for title, intro, sets in (
        ("Presets", "What each preset sets, everything else keeps its default.", PRESETS),
        (
            "Starts",
            "What another `initial.kind`, images, a character or a path traced reference set, below preset and file.",
            STARTS,
        ),
    ):
        lines += ["", f"## {title}", "", intro]
        for name, overrides in sets.items():
            lines += _yaml_block(name, overrides)
    return "\n".join(lines) + "\n"


def _yaml_block(name: str, overrides: dict[str, Any]) -> list[str]:
    """A name and its overrides as YAML."""
    body = yaml.safe_dump(overrides, sort_keys=False).strip() if overrides else "# the defaults"
    return ["", f"`{name}`:", "", "```yaml", body, "```"]


def _sections(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, str, list[str]]]:
    """Title, introduction and table rows of a section, then of those below it."""
    properties = model.model_json_schema()["properties"]
    rows, below = [], []
    for name, field in asset_first(model.model_fields).items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            below.append((field.annotation, f"{prefix}{name}."))
        else:
            rows.append(_row(prefix + name, field, properties[name]))
    yield (prefix.rstrip(".") or "Top level", (model.__doc__ or "").strip(), rows)
    for section, path in below:
        yield from _sections(section, path)


def _row(key: str, field: FieldInfo, schema: dict[str, Any]) -> str:
    default = "required" if field.is_required() else f"`{_plain(field.default)}`"
    meaning = re.sub(r"\s+", " ", field.description or "").replace("|", "\\|")
    return f"| `{key}` | {_type(schema)} | {default} | {meaning} |"


def _plain(value: Any) -> str:
    if isinstance(value, tuple):
        value = list(value)
    return "none" if value is None else yaml.safe_dump(value, default_flow_style=True).split("\n...")[0].strip()


def _type(schema: dict[str, Any]) -> str:
    """A type in a reader's words, limits included."""
    if "anyOf" in schema:
        return ", or ".join("none" if o.get("type") == "null" else _type(o) for o in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{v}`" for v in schema["enum"])
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            first, n = schema["prefixItems"][0], len(schema["prefixItems"])
            return f"{n} lists, each {_type(first)}" if first["type"] == "array" else f"list of {n} numbers"
        return f"list of {_type(schema['items'])}"
    limits = " and ".join(text.format(schema[k]) for k, text in _LIMITS.items() if k in schema)
    name = {"number": "number", "integer": "integer", "boolean": "true or false", "string": "text"}[schema["type"]]
    return f"{name} {limits}".strip()
