"""
One door for models: the reader is chosen by the file's suffix, and whatever is wrong with a file is one clear line.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import AssetError, MemoryLimitError, UserError
from ..machine.runtime import ensure_variant
from ..model.asset import Asset
from ..registry import Registry
from .resources import printable
from .validate import check_asset

Reader = Callable[[Path], Asset]

READERS: Registry[Reader] = Registry("format")


def register_reader(suffix: str, reader: Reader, *, replace: bool = False) -> None:
    """
    Make a model format known to :func:`load_asset`, and so to every command.

    Parameters
    ----------
    suffix : str
        Of its files, lower case, with the dot.
    reader : callable
        ``reader(path) -> Asset`` in the conventions of :mod:`..model.asset`. What is wrong with a file it raises as
        ``AssetError``; arrays need no checks, what cannot be rendered is refused afterwards.

    Raises
    ------
    ValueError
        The suffix is taken.
    """
    READERS.register(suffix, reader, replace=replace)


def load_asset(path: str | Path, *, purpose: str = "asset") -> Asset:
    """
    Read a model file and check that it can be rendered.

    Parameters
    ----------
    path : str or Path
        OBJ (with MTL), PLY, STL, GLB, glTF, USD, USDA, USDC, USDZ, OFF, or a Mitsuba scene (XML); with the extra
        ``formats`` FBX, Collada, 3MF and STEP.
    purpose : str
        What the messages call the file: 'asset', 'reference', 'low-poly mesh', …

    Returns
    -------
    Asset
        In the conventions of :mod:`..model.asset`; ``notes`` tells what was left out or mended. A
        :class:`.mitsuba.read.SceneAsset` for a Mitsuba scene.

    Raises
    ------
    AssetError
        No such file, an unknown format, or something in it cannot be read or is missing.
    MeshError
        No faces, NaN positions, indices out of range, no area.
    MemoryLimitError
        It does not fit into memory, or says that it would not.
    """
    if "://" in str(path):
        raise AssetError(f"the {purpose} '{path}' is an address, not a file; download it and name the file")
    path = Path(path)
    if not path.exists():
        raise AssetError(f"the {purpose} '{path}' does not exist")
    if not path.is_file():
        raise AssetError(f"the {purpose} '{path}' is no file; name the model file in it")
    suffix = path.suffix.lower()
    if suffix not in READERS:
        known = ", ".join(s[1:].upper() for s in READERS)
        raise AssetError(
            f"the {purpose} '{path}' is of an unknown format '{suffix}'; known are {known}; export it as one of these"
        )
    if path.stat().st_size == 0:
        raise AssetError(f"the {purpose} '{path}' is empty")
    try:
        with np.errstate(all="ignore"):  # what is not finite in the end is found by the check
            asset = check_asset(READERS[suffix](path), path.name)
    except UserError as error:
        line = printable(str(error), 600)  # names in a file may hold anything
        if line == str(error):
            raise
        raise type(error)(line) from error
    except MemoryError as error:
        raise MemoryLimitError(f"{path.name}: it needs more memory than there is; simplify the file first") from error
    except _MALFORMED as error:
        what = printable(f"{type(error).__name__}: {error}".splitlines()[0], 200)
        raise AssetError(f"{path.name}: the file is malformed and cannot be read ({what}); export it again") from error
    notes = tuple(printable(note, 400) for note in asset.notes)
    return replace(asset, name=path.stem, source=str(path), notes=notes)


#: What readers run into when a file's parts do not fit together. Other exceptions are defects and keep their traceback.
_MALFORMED = (
    LookupError, TypeError, ValueError, AttributeError, ArithmeticError, struct.error, binascii.Error, RecursionError,
    OSError,
)  # fmt: skip


# Readers are imported when they are needed, since USD and Mitsuba take a while.


def _obj(path: Path) -> Asset:
    from .obj.read import read_obj

    return read_obj(path)


def _ply(path: Path) -> Asset:
    from .ply import read_ply

    return read_ply(path)


def _stl(path: Path) -> Asset:
    from .stl import read_stl

    return read_stl(path)


def _gltf(path: Path) -> Asset:
    from .gltf.read import read_gltf

    return read_gltf(path)


def _other(path: Path) -> Asset:
    from .exchange.by_trimesh import read_by_trimesh

    return read_by_trimesh(path)


def _assimp(path: Path) -> Asset:
    from .exchange.by_assimp import read_by_assimp

    return read_by_assimp(path)


def _step(path: Path) -> Asset:
    from .exchange.step import read_step

    return read_step(path)


def _mitsuba(path: Path) -> Asset:
    ensure_variant()  # before Mitsuba's classes can be named
    from .mitsuba.read import read_mitsuba

    return read_mitsuba(path)


def _usd(path: Path) -> Asset:
    try:
        from .usd.read import read_usd
    except ImportError as error:
        raise AssetError(f"USD files need the package usd-core: pip install usd-core ({error})") from error
    return read_usd(path)


for _read, _suffixes in (
    (_obj, ".obj"), (_ply, ".ply"), (_stl, ".stl"), (_gltf, ".glb .gltf"), (_usd, ".usd .usda .usdc .usdz"),
    (_mitsuba, ".xml"), (_other, ".off .3mf"), (_assimp, ".fbx .dae"),
    (_step, ".step .stp"),
):  # fmt: skip
    for _suffix in _suffixes.split():
        register_reader(_suffix, _read)
