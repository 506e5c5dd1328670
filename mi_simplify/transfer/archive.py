"""
Files of named arrays (npz), opened with one line for whatever is wrong with them.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import AssetError


@contextmanager
def opened(path: str | Path, expected: str, remedy: str) -> Iterator[Mapping[str, np.ndarray]]:
    """
    The arrays of an npz file, each read as it is asked for; no code in the file is run.

    Raises
    ------
    AssetError
        The file is missing, damaged or holds something else than is taken from it; it says what was ``expected``, and
        the ``remedy``.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            yield data
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise AssetError(f"{path}: {expected} expected, it cannot be read ({error}); {remedy}") from None
