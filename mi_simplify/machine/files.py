"""
Files that appear whole or not at all, whenever the machine stops: written beside their place, then renamed.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
from collections.abc import Callable
from pathlib import Path

from ..errors import OutputError


def write_atomic(path: str | Path, write: bytes | str | Callable[[Path], None]) -> Path:
    """
    Write a file under a temporary name in the same folder, on the disk and not in its cache, then rename it over
    ``path``.

    Parameters
    ----------
    path : str or Path
        In an existing folder; a file that is there is replaced.
    write : bytes, str or callable
        The content (text as UTF-8), or a function that is given the temporary path and fills it.

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        The folder is missing, not writable or full, or a folder has the file's name.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        if callable(write):
            write(temporary)
        else:
            temporary.write_bytes(write.encode() if isinstance(write, str) else write)
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise output_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    return path


def make_folder(path: str | Path) -> Path:
    """
    Create a folder with its parents where it is missing.

    Raises
    ------
    OutputError
        It cannot be created, or a file has its name.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(path, error) from error
    return path


def side_file_stem(path: str | Path) -> str:
    """
    Stem of the files beside ``path``: what OBJ's space-separated lines and USD asset paths can carry.
    """
    return re.sub(r"[^\w.-]+", "_", Path(path).stem) or "model"


def output_error(path: Path, error: OSError) -> OutputError:
    """
    One clear line for what the system says about a file that could not be written.
    """
    what = error.strerror or str(error) or type(error).__name__
    return OutputError(f"cannot write {path}: {what}; choose another output folder or free this one")
