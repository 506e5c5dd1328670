"""
Model files behind addresses such as ``https://`` and ``s3://``, through fsspec: told apart by what the store says of
them, and copied beside the results while an entry is made.
"""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote, urlsplit

from ...errors import AssetError, RuntimeUnavailable
from ...machine.files import make_folder, output_error

#: Formats of one file; others name textures beside them, which no store lists.
SELF_CONTAINED = (".glb", ".ply", ".stl", ".usdz")

#: What a store says of a version, in lower case.
_VERSION = ("size", "etag", "content-md5", "digest", "last-modified", "lastmodified", "md5hash", "generation", "mtime")

_T = TypeVar("_T")


def is_address(name: str) -> bool:
    """
    Whether a file is somewhere else.
    """
    return re.match(r"[a-z][a-z0-9+.-]*://", name, re.IGNORECASE) is not None


def file_name(name: str) -> str:
    """
    The name of a file without its folders, and of one behind an address without its query.
    """
    return Path(unquote(urlsplit(name).path) if is_address(name) else name).name


def require_store(address: str) -> None:
    """
    Raise :class:`UserError` unless files behind such addresses can be fetched here: fsspec and what it needs for them.
    """
    if Path(file_name(address)).suffix.lower() not in SELF_CONTAINED:
        raise AssetError(f"{address}: only files that hold all of a model are fetched: {', '.join(SELF_CONTAINED)}")
    _opened(address)


def version_of(address: str) -> str:
    """
    What tells a file from another by the same address, without fetching it: size, tag, time; empty where nobody tells.
    """
    try:
        found = _asked(address, lambda store, path: store.info(path))
    except AssetError:  # its own entry will say so
        return ""
    return json.dumps({key: str(found[key]) for key in sorted(found) if key.lower() in _VERSION})


def fetched(address: str, folder: Path) -> Path:
    """
    A copy of the file in a folder, which is made; one that is there is taken as it is.

    Raises
    ------
    AssetError
        It cannot be fetched.
    OutputError
        The copy cannot be written.
    """
    path = make_folder(folder) / file_name(address)
    if path.is_file():
        return path
    temporary = path.with_name(f".{secrets.token_hex(4)}{path.suffix}")
    try:
        _asked(address, lambda store, there: store.get_file(there, str(temporary)))
        os.replace(temporary, path)
    except OSError as error:
        raise output_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _opened(address: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise RuntimeUnavailable(f"{address} needs fsspec: pip install 'mi-simplify[urls]'") from None
    try:
        return fsspec.core.url_to_fs(address)
    except ImportError as error:
        raise RuntimeUnavailable(f"{address}: {error}; pip install 'mi-simplify[urls]'") from None
    except ValueError as error:
        raise AssetError(f"{address}: {error}; name a file, or an address such as https:// or s3://") from None


def _asked(address: str, question: Callable[[Any, str], _T]) -> _T:
    """What a store answers; each has errors of its own, and all of them are about this one file."""
    store, path = _opened(address)
    try:
        return question(store, path)
    except Exception as error:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):  # of the disk here
            raise
        said = f"{type(error).__name__} {error}"[:200]
        raise AssetError(f"{address}: cannot be fetched: {said}; is it there, and public?") from None
