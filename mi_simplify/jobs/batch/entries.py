"""
What is to be made: a folder of models, a list of them, or a manifest, as one entry an asset.
"""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from ... import __version__
from ...config.layers import read_yaml
from ...config.problems import validated
from ...config.section import Section, names_no_file
from ...errors import ConfigError
from ...formats.load import READERS
from .remote import file_name, is_address, require_store, version_of

Command = Literal["simplify", "lod", "bake", "evaluate", "none"]


class Entry(Section):
    """One asset of a batch, and what is done with it."""

    asset: str = Field(description="Model file, relative to the manifest, an address, or `sample:NAME`.")
    name: str = Field("", description="Folder of its results below OUT; the file's name by default.")
    command: Command = Field("simplify", description="`none` writes its line and nothing else.")
    triangles: str = Field("", description="Budget of `simplify`, or budgets of `lod` such as `9000,3000`.")
    preset: str = Field("", description="fast, balanced or best.")
    settings: dict[str, Any] = Field({}, alias="set", description="Configuration keys by dotted path or nested.")
    files: tuple[str, ...] = Field((), description="The low-poly mesh of `bake`, the candidates of `evaluate`.")

    @field_validator("triangles", "name", mode="before")
    @classmethod
    def _as_text(cls, value: Any) -> Any:
        return str(value) if isinstance(value, int) and not isinstance(value, bool) else value

    @field_validator("name")
    @classmethod
    def _is_a_folder_name(cls, value: str) -> str:
        if value and (Path(value).is_absolute() or ".." in Path(value).parts):
            raise ValueError(f"'{value}' leaves the output folder")
        return value

    def fingerprint(self) -> str:
        """
        A hash of the asset's content, of the settings and of this version: what a finished result stands for.
        """
        digest = hashlib.sha256(__version__.encode())
        digest.update(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode())
        for path in (self.asset, *self.files):
            if Path(path).is_file():
                with open(path, "rb") as file:
                    digest.update(hashlib.file_digest(file, "sha256").digest())
            elif is_address(path):
                digest.update(version_of(path).encode())
        return digest.hexdigest()[:32]

    def arguments(self, out: Path) -> list[str]:
        """
        The command line that makes it, without the program's name.
        """
        line = [self.command, self.asset, *self.files, "-o", str(out), "--quiet"]
        if self.triangles:
            line += ["--triangles", self.triangles]
        if self.preset:
            line += ["--preset", self.preset]
        return [*line, *(word for text in self.layers() for word in ("--set", text))]

    def layers(self) -> list[str]:
        """
        Its settings as overrides of a configuration, ``KEY=VALUE``.
        """
        return [
            f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in self.settings.items()
        ]


def read_entries(sources: Iterable[str], patterns: Iterable[str], defaults: Mapping[str, Any]) -> list[Entry]:
    """
    All entries of the sources, in order, each with a name of its own.

    Parameters
    ----------
    sources : iterable of str
        Folders, model files, `sample:NAME`, and manifests (YAML, JSON, CSV).
    patterns : iterable of str
        Globs of the model files of a folder; without them all files that can be read.
    defaults : mapping
        Keys of an entry that count where a manifest does not say otherwise.

    Raises
    ------
    ConfigError
        A manifest cannot be read, a source is not there, a folder holds nothing, two entries have one name.
    AssetError
        An address is of no single file that holds a model.
    RuntimeUnavailable
        There is an address, and no fsspec.
    """
    patterns = list(patterns)
    found: list[Entry] = []
    for source in sources:
        path = Path(source)
        if names_no_file(source):
            found.append(validated(Entry, {**defaults, "asset": source}))
        elif path.is_dir():
            models = _models(path, patterns)
            names = _distinct([p.relative_to(path) for p in models])
            found += [
                validated(Entry, {"name": name, **defaults, "asset": str(p.resolve())})
                for name, p in zip(names, models, strict=True)
            ]
        elif not path.is_file():
            raise ConfigError(f"'{source}' is neither a folder, a model file nor a manifest; name one that exists")
        elif path.suffix.lower() in _MANIFESTS:
            found += _of_manifest(path, defaults)
        else:
            found.append(validated(Entry, {**defaults, "asset": str(path.resolve())}))
    if not found:
        raise ConfigError("there is nothing to do: the manifest holds no assets")
    for name in (name for entry in found for name in (entry.asset, *entry.files) if is_address(name)):
        require_store(name)
    return _named(found)


_MANIFESTS = (".yaml", ".yml", ".json", ".csv")


def _models(folder: Path, patterns: list[str]) -> list[Path]:
    paths = [p for pattern in patterns or ["**/*"] for p in folder.glob(pattern) if p.is_file()]
    if not patterns:
        paths = [p for p in paths if p.suffix.lower() in READERS and p.suffix.lower() != ".xml"]
    if not paths:
        raise ConfigError(f"{folder} holds no model file{' of ' + ', '.join(patterns) if patterns else ''}")
    return sorted(set(paths))


def _of_manifest(path: Path, defaults: Mapping[str, Any]) -> list[Entry]:
    more: Mapping[str, Any] = {}
    if path.suffix.lower() == ".csv":
        rows = _of_table(path)
    else:
        document = read_yaml(path)
        unknown = set(document) - {"assets", "defaults"}
        if unknown or not isinstance(document.get("assets"), list):
            raise ConfigError(f"{path}: expected 'assets', a list, and 'defaults'; see docs/batch.md")
        rows, more = document["assets"], document.get("defaults") or {}
    out = []
    for k, row in enumerate(rows):
        keys = {"asset": row} if isinstance(row, str) else row
        if not isinstance(keys, Mapping) or not isinstance(keys.get("asset"), str):
            raise ConfigError(f"{path}: entry {k + 1}: expected a file name, or a section with 'asset'")
        merged = {**defaults, **more, **keys}
        merged["set"] = {**defaults.get("set", {}), **(more.get("set") or {}), **(keys.get("set") or {})}
        merged["asset"] = _beside(path, merged["asset"])
        merged["files"] = tuple(_beside(path, name) for name in merged.get("files", ()))
        try:
            out.append(validated(Entry, merged))
        except ConfigError as error:
            raise ConfigError(f"{path}: entry {k + 1}: {error}") from None
    return out


def _of_table(path: Path) -> list[dict[str, Any]]:
    """Rows of a CSV file; ``set`` holds KEY=VALUE pairs, ``files`` names, both parted by semicolons."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = [{k: v for k, v in row.items() if k is not None and v} for row in csv.DictReader(file)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    out: list[dict[str, Any]] = []
    for row in rows:
        keys: dict[str, Any] = dict(row)
        if "set" in row:
            pairs = [pair.partition("=") for pair in row["set"].split(";") if pair.strip()]
            keys["set"] = {key.strip(): _value(value) for key, _, value in pairs}
        if "files" in row:
            keys["files"] = [name.strip() for name in row["files"].split(";")]
        out.append(keys)
    return out


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text.strip()


def _beside(manifest: Path, name: str) -> str:
    return name if names_no_file(name) else str((manifest.resolve().parent / Path(name).expanduser()).resolve())


def _distinct(paths: list[Path]) -> list[str]:
    """Names for files: their path without its suffix, with it where two share the rest."""
    stems = [re.sub(r"[^\w.-]+", "_", "-".join(path.with_suffix("").parts)) for path in paths]
    counts = Counter(stems)
    return [
        f"{stem}{path.suffix.replace('.', '-')}" if counts[stem] > 1 else stem
        for stem, path in zip(stems, paths, strict=True)
    ]


def _named(entries: list[Entry]) -> list[Entry]:
    """Entries without a name are called like their file."""
    nameless = [e for e in entries if not e.name]
    names = iter(_distinct([Path(file_name(e.asset).replace(":", "-")) for e in nameless]))
    named = [e if e.name else e.model_copy(update={"name": next(names)}) for e in entries]
    twice = [name for name, n in Counter(e.name for e in named).items() if n > 1]
    if twice:
        raise ConfigError(f"two entries are called '{twice[0]}'; give them names of their own in the manifest")
    return named
