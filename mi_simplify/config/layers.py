"""
A configuration from its layers: defaults < prefiltering < start < preset < YAML file < overrides; and back into YAML.
"""

from __future__ import annotations

import importlib.metadata
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ValidationError

from ..errors import ConfigError
from .presets import PRESETS, STARTS, prefiltering
from .problems import describe, nearest
from .schema import Config, PathMark, asset_first
from .section import SAMPLE_PREFIX as SAMPLE_PREFIX
from .section import names_no_file


def load_config(
    path: str | Path | None = None,
    overrides: Iterable[str | Mapping[str, Any]] = (),
    preset: str | None = None,
) -> Config:
    """
    Build the configuration of a job.

    Parameters
    ----------
    path : path or None
        YAML file; relative paths in it are relative to its folder.
    overrides : iterable of str or mapping
        ``"a.b=value"`` with a YAML value, or nested dicts; later ones win. Relative paths in them
        are relative to the working directory.
    preset : str or None
        One of ``PRESETS``; wins over a ``preset`` key of the layers.

    Returns
    -------
    Config
        Preset, file and overrides count as stated, see ``Section.started``; what else they bring along does not.

    Raises
    ------
    ConfigError
        One line with the dotted path: unknown key (and the nearest one), wrong type, out of range.
    """
    layers = [] if path is None else [_resolve_paths(read_yaml(Path(path)), Path(path).resolve().parent)]
    for item in overrides:
        layer = parse_override(item) if isinstance(item, str) else dict(item)
        layers.append(_resolve_paths(layer, Path.cwd()))
    if preset is not None:
        layers.append({"preset": preset})
    merged: dict[str, Any] = {}
    for layer in layers:
        merged = _merge(merged, layer)
    name = merged.get("preset")
    if name is not None:
        if not isinstance(name, str) or name not in PRESETS:
            hint = nearest(str(name), PRESETS)
            raise ConfigError(f"preset: unknown preset {name!r:.60}{hint}; one of {', '.join(PRESETS)}")
        merged = _merge(PRESETS[name], merged)
    given, initial = merged, merged.get("initial")
    kind = initial.get("kind") if isinstance(initial, Mapping) else None
    if isinstance(kind, str):
        merged = _merge(STARTS.get(kind, {}), merged)
    if str(merged.get("asset")).lower().endswith(".json") and kind in (None, "decimate", "auto"):
        merged = _merge(STARTS["images"], merged)
    reference, optimizer = merged.get("reference"), merged.get("optimizer")
    if isinstance(reference, Mapping) and reference.get("transport") in ("baked", "matched"):
        merged = _merge(STARTS["path traced"], merged)
    target = optimizer.get("target_resolution") if isinstance(optimizer, Mapping) else None
    if isinstance(target, int) and 8 <= target <= 8192:
        merged = _merge(prefiltering(target), merged)
    try:
        return Config.model_validate(merged).stating(given)
    except ValidationError as error:
        raise ConfigError(describe(error)) from None


def parse_override(text: str) -> dict[str, Any]:
    """
    Turn ``"a.b=value"`` into ``{"a": {"b": value}}``; the value follows the rules of YAML.
    """
    key, equals, value = text.partition("=")
    names = [name.strip() for name in key.split(".")]
    if not equals or not all(names):
        raise ConfigError(f"'{text}': an override reads key.subkey=value, for example optimizer.steps=200")
    out: Any = _parse_yaml(value, f"'{text}'")
    for name in reversed(names):
        out = {name: out}
    return out


def dump(config: Config) -> str:
    """
    The resolved configuration as YAML that ``load_config`` reads back; what it ran on is a comment.
    """
    versions = {"python": platform.python_version()}
    for name in ("mi-simplify", "mitsuba", "drjit", "numpy"):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    head = "# Resolved configuration; written with " + ", ".join(f"{k} {v}" for k, v in versions.items()) + ".\n"
    return head + yaml.safe_dump(asset_first(config.model_dump(mode="json")), sort_keys=False, allow_unicode=True)


class _Loader(yaml.SafeLoader):
    """Safe YAML whose numbers are those of YAML 1.2 (``1e-3`` is one) and whose keys are distinct."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen: set[str] = set()
        for key_node, _ in node.value:
            if key_node.value in seen and key_node.tag != "tag:yaml.org,2002:merge":
                raise yaml.MarkedYAMLError(problem=f"'{key_node.value}' is set twice", problem_mark=key_node.start_mark)
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _parse_yaml(text: str, origin: str) -> Any:
    try:
        return yaml.load(text, _Loader)  # a subclass of SafeLoader
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or str(error).split("\n")[0] or type(error).__name__
        raise ConfigError(f"{origin}{where}: not valid YAML: {problem:.200}") from None


def read_yaml(path: Path) -> dict[str, Any]:
    """
    The top level of a YAML file.

    Raises
    ------
    ConfigError
        It cannot be read, is no YAML, or holds no mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such configuration file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a YAML text file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    data = _parse_yaml(text, str(path))
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected sections with keys, got {type(data).__name__}")
    return data


def _merge(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Nested dicts merged key by key into a new one; ``top`` wins."""
    out = dict(base)
    for key, value in top.items():
        below = out.get(key)
        out[key] = _merge(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return out


def _path_keys(model: type[BaseModel] = Config, prefix: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Keys of the schema that are marked as file paths."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _path_keys(field.annotation, (*prefix, name))
        elif any(isinstance(mark, PathMark) for mark in field.metadata) or any(
            isinstance(mark, PathMark) for option in get_args(field.annotation) for mark in get_args(option)
        ):
            yield (*prefix, name)


def _resolve_paths(layer: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The layer with relative paths made absolute."""
    extensions = layer.get("extensions")
    if extensions:
        files = extensions if isinstance(extensions, list | tuple) else [extensions]
        whole = [str(folder / Path(x).expanduser()) if str(x).endswith(".py") else x for x in files]
        layer = {**layer, "extensions": whole}
    for *sections, name in _path_keys():
        node: Any = layer
        for section in sections:
            node = node.get(section) if isinstance(node, Mapping) else None
        value = node.get(name) if isinstance(node, Mapping) else None
        if isinstance(value, str) and value and not names_no_file(value):
            nested: Any = str(folder / Path(value).expanduser())
            for key in (name, *reversed(sections)):
                nested = {key: nested}
            layer = _merge(layer, nested)
    return layer
