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
from .resources import printable
from .validate import check_asset

_READERS = {
    ".obj": "read_obj", ".ply": "read_ply", ".stl": "read_stl", ".glb": "read_gltf", ".gltf": "read_gltf",
    ".usd": "read_usd", ".usda": "read_usd", ".usdc": "read_usd", ".usdz": "read_usd", ".xml": "read_mitsuba",
}  # fmt: skip

#: Suffixes that :func:`load_asset` reads.
SUFFIXES = tuple(_READERS)


def load_asset(path: str | Path, *, purpose: str = "asset") -> Asset:
    """
    Read a model file and check that it can be rendered.

    Parameters
    ----------
    path : str or Path
        OBJ (with MTL), PLY, STL, GLB, glTF, USD, USDA, USDC, USDZ, or a Mitsuba scene (XML).
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
    if suffix not in _READERS:
        known = ", ".join(s[1:].upper() for s in _READERS)
        raise AssetError(
            f"the {purpose} '{path}' is of an unknown format '{suffix}'; known are {known}; export it as one of these"
        )
    if path.stat().st_size == 0:
        raise AssetError(f"the {purpose} '{path}' is empty")
    try:
        with np.errstate(all="ignore"):  # what is not finite in the end is found by the check
            asset = check_asset(_reader(suffix)(path), path.name)
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


def _reader(suffix: str) -> Callable[[Path], Asset]:
    """The reader of a format; imported when needed, since USD takes a while."""
    name = _READERS[suffix]
    if name == "read_obj":
        from .obj.read import read_obj as reader
    elif name == "read_ply":
        from .ply import read_ply as reader
    elif name == "read_stl":
        from .stl import read_stl as reader
    elif name == "read_gltf":
        from .gltf.read import read_gltf as reader
    elif name == "read_mitsuba":
        ensure_variant()  # before Mitsuba's classes can be named
        from .mitsuba.read import read_mitsuba as reader
    else:
        try:
            from .usd.read import read_usd as reader
        except ImportError as error:
            raise AssetError(f"USD files need the package usd-core: pip install usd-core ({error})") from error
    return reader
