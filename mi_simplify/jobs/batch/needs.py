"""
What an entry is expected to take, so that only as many run at once as fit.
"""

from __future__ import annotations

from pathlib import Path

from ...config import load_config
from ...errors import UserError
from ..footprint import footprint, said_footprint
from .entries import Entry

#: Of an entry that writes its line and nothing else [bytes].
_NOTHING = 1 << 20

#: Bytes of a model file for each triangle, where its header does not count them: few, as in an OBJ file.
_PER_TRIANGLE = 35

#: Memory is asked for in such steps, so that Ray sees few kinds of work [bytes].
_STEP = 128 << 20


def expected_memory(entry: Entry, limit: int | None = None) -> int:
    """
    Peak of the entry's process [bytes]: its limit, or what :func:`..footprint.footprint` reckons of settings and files.

    Settings that cannot be used count as none; the entry ends with an error of its own.
    """
    if entry.command == "none":
        return _NOTHING
    if limit is not None:
        return limit
    asset = {"asset": entry.asset}
    try:
        config = load_config(None, [*entry.layers(), asset], entry.preset or None)
    except UserError:
        config = load_config(None, [asset])
    parts = footprint(config) | {"asset": sum(map(_of_file, (entry.asset, *entry.files)))}
    return -(-sum(parts.values()) // _STEP) * _STEP


def _of_file(name: str) -> int:
    path = Path(name)
    return said_footprint(name, path.stat().st_size // _PER_TRIANGLE) if path.is_file() else 0
