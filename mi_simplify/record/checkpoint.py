"""
What a run needs in order to go on after whatever stopped it, in the folder ``checkpoint`` of its results.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..config import Config
from ..errors import OutputError
from ..machine.files import make_folder, write_atomic
from ..model.asset import Asset
from ..model.groups import Group, Groups
from ..model.mesh import Mesh
from ..model.model import Displacement, Model, Morphs, VertexSets
from ..model.rig import Rig
from ..model.rigging import Rigging
from ..model.tree import Nodes, Tree

log = logging.getLogger("mi_simplify")

GUESS, STATE = "guess.npz", "state.npz"


class Checkpoint:
    """
    Two files that appear whole or not at all: the first guess, written once, and the newest state of the fit.

    Both are NumPy archives without pickles; what is no array is JSON in the entry ``plain``.

    Parameters
    ----------
    folder : Path
    config : Config
        With the asset, what a run is recognised by; the asset's file may move, and what is exported may change.
    asset : Asset
        As it was read.
    """

    def __init__(self, folder: Path, config: Config, asset: Asset):
        self.folder, self.every, self._asset = folder, config.export.checkpoint, config.asset
        settings = config.model_dump(mode="json", exclude={"asset": True, "export": True})
        self._identity: dict[str, Any] = {"version": __version__, "asset": fingerprint(asset), "config": settings}
        self._saved, self._failed = time.monotonic(), False
        self._guess: dict[str, Any] = {}

    def begin(self, guess: Model, notes: list[str]) -> None:
        """
        Keep the first guess, from which a run without a state starts again.
        """
        self._guess = {"identity": self._identity, "notes": notes, "model": _as_dict(guess)}
        self._try(GUESS, self._guess)

    def due(self) -> bool:
        """Whether the newest state is older than it should be."""
        return time.monotonic() - self._saved >= self.every

    def save(self, state: dict) -> bool:
        """
        Replace the state.

        Returns
        -------
        bool
            False where it could not be written: a warning says why, and the run goes on.
        """
        # The first guess may be gone with the folder, or have found no room.
        return ((self.folder / GUESS).exists() or self._try(GUESS, self._guess)) and self._try(STATE, state)

    def load(self) -> tuple[Model, list[str], dict | None]:
        """
        First guess, notes on it, and the newest state; None for the state where none was reached.

        Raises
        ------
        OutputError
            It is of another configuration, asset or version, or damaged.
        """
        for leftover in self.folder.glob(".*.npz"):  # a process was killed while it wrote
            leftover.unlink(missing_ok=True)
        self._guess = self._read(GUESS)
        self._recognise(self._guess["identity"])
        model = {**self._guess["model"]}
        model["mesh"] = Mesh(**model["mesh"])
        if model["displacement"] is not None:
            given = model["displacement"]
            model["displacement"] = Displacement(**{**given, "fitted": tuple(given["fitted"])})
        if model["skin"] is not None:
            skin = model["skin"]
            clips = tuple((name, first, last) for name, first, last in skin["rig"]["clips"])
            rig = Rig(**{**skin["rig"], "names": tuple(skin["rig"]["names"]), "clips": clips})
            model["skin"] = Rigging(**{**skin, "rig": rig})
        if model["vertex_sets"] is not None:
            sets = model["vertex_sets"]
            model["vertex_sets"] = VertexSets(tuple(sets["sizes"]), sets["offsets"])
        model["metadata"] = json.loads(model["metadata"])
        if model["morphs"] is not None:
            given = model["morphs"]
            model["morphs"] = Morphs(tuple(given["names"]), tuple(given["weights"]), given["offsets"])
        if model["nodes"] is not None:
            given = model["nodes"]
            tree = Tree(**{**given["tree"], "names": tuple(given["tree"]["names"])})
            placed, joints = (tuple(tuple(row) for row in given[key]) for key in ("placed", "joints"))
            model["nodes"] = Nodes(tree, given["of_position"], placed, joints)
        if model["groups"] is not None:
            kinds = tuple(Group(**kind) for kind in model["groups"]["kinds"])
            model["groups"] = Groups(kinds, model["groups"]["of_face"])
        guess = Model(**model)
        return guess, self._guess["notes"], self._read(STATE) if (self.folder / STATE).exists() else None

    def _read(self, name: str) -> dict:
        try:
            return read_archive(self.folder / name)
        except (OSError, EOFError, ValueError, zipfile.BadZipFile):
            raise OutputError(f"{self.folder} is damaged; pass --overwrite to begin anew") from None

    def _recognise(self, other: dict) -> None:
        """Raise unless the checkpoint is of this run."""
        mine, way_out = self._identity, "or pass --overwrite to begin anew"
        if other["version"] != mine["version"]:
            raise OutputError(
                f"{self.folder} was written by version {other['version']} of mi_simplify, this is {mine['version']}; "
                f"resume with that one, {way_out}"
            )
        there, here = dict(_leaves(other["config"])), dict(_leaves(mine["config"]))
        for key in sorted({*there, *here}):
            if there.get(key) != here.get(key):
                raise OutputError(
                    f"{self.folder} is of another configuration: {key.replace('/', '.')} was {there.get(key)}, now it "
                    f"is {here.get(key)}; resume with the same settings, {way_out}"
                )
        if other["asset"] != mine["asset"]:
            raise OutputError(
                f"{self.folder} is of another asset than {self._asset} is now; name the right one, {way_out}"
            )

    def _try(self, name: str, tree: dict) -> bool:
        """Write an archive; failing is told once, until it succeeds again."""
        try:
            write_archive(make_folder(self.folder) / name, tree)
            self._failed = False
        except OutputError as error:
            if not self._failed:
                log.warning("no checkpoint: %s; the run goes on", str(error).split(";")[0])
            self._failed = True
        self._saved = time.monotonic()
        return not self._failed


def write_archive(path: Path, tree: dict) -> None:
    """
    Write nested dicts of arrays and plain values into one file, which appears whole or not at all.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    arrays: dict[str, Any] = {key: value for key, value in _leaves(tree) if isinstance(value, np.ndarray)}
    plain = json.dumps({key: value for key, value in _leaves(tree) if key not in arrays})

    def write(temporary: Path) -> None:
        with open(temporary, "wb") as file:
            np.savez(file, plain=np.array(plain), **arrays)

    write_atomic(path, write)


def read_archive(path: Path) -> dict:
    """
    Inverse of :func:`write_archive`; no code in the file is run.
    """
    tree: dict[str, Any] = {}
    with np.load(path, allow_pickle=False) as archive:
        leaves = {key: archive[key] for key in archive.files}
    leaves.update(json.loads(str(leaves.pop("plain"))))
    for key, value in leaves.items():
        *folders, name = key.split("/")
        node = tree
        for folder in folders:
            node = node.setdefault(folder, {})
        node[name] = value
    return tree


def fingerprint(asset: Asset) -> str:
    """
    A hash of everything that is rendered of an asset, whatever its file is called.
    """
    digest = hashlib.blake2b(digest_size=16)
    for value in _values((asset.parts, asset.instances, asset.rig)):
        digest.update(value if isinstance(value, bytes) else np.ascontiguousarray(value).data.cast("B"))
    source = Path(asset.source)
    if source.is_file():  # of a scene, what is rendered is more than its parts
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _values(item: Any) -> Iterator[bytes | np.ndarray]:
    """All arrays and plain values of nested dataclasses and tuples."""
    if isinstance(item, np.ndarray):
        yield f"{item.dtype.str}{item.shape}".encode()
        yield item
    elif isinstance(item, tuple):
        for value in item:
            yield from _values(value)
    elif dataclasses.is_dataclass(item):
        yield from _values(tuple(getattr(item, field.name) for field in dataclasses.fields(item)))
    else:
        yield repr(item).encode()


def _as_dict(item: Any) -> dict:
    """A dataclass of arrays and plain values, nested ones as nested dicts."""
    out = {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}
    return {name: _plain(value) for name, value in out.items()} | {
        name: json.dumps(value)
        for name, value in out.items()
        if name == "metadata"  # its keys may have slashes
    }


def _plain(value: Any) -> Any:
    if isinstance(value, tuple) and any(dataclasses.is_dataclass(x) for x in value):
        return [_plain(x) for x in value]
    return _as_dict(value) if dataclasses.is_dataclass(value) else value


def _leaves(tree: dict, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """What nested dicts hold, with keys such as ``fit/vertices/u``."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{name}/")
        else:
            yield prefix + name, value
