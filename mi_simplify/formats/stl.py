"""
STL triangle soups, text and binary, welded.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import MeshError
from ..model.asset import Asset, Instance, Part
from ..model.topology import weld
from .resources import read_bytes

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> Asset:
    """
    Read an STL file as one part over welded positions; its facet normals repeat the winding and are dropped.

    Raises
    ------
    MeshError
        The file is truncated, or holds no facets.
    """
    data = read_bytes(path, "STL file")
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else None
    is_binary = count is not None and len(data) == 84 + 50 * count
    if not is_binary and data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096].lower():
        corners = _read_text(data, path.name)
    elif count is not None and len(data) >= 84 + 50 * count:
        corners = np.frombuffer(data, _FACET, count, 84)["corners"].astype(np.float64)
    elif count is not None:
        raise MeshError(
            f"{path.name}: the header promises {count} facets, the file holds {(len(data) - 84) // 50}; "
            "it is truncated, copy or export it again"
        )
    else:
        raise MeshError(f"{path.name}: this is no STL file, or it is cut off")
    if not len(corners):
        raise MeshError(f"{path.name}: there are no faces in it; export the file again")
    positions, index = weld(corners.reshape(-1, 3))
    part = Part(positions, index.reshape(-1, 3), name=path.stem)
    return Asset((part,), (Instance(0, name=path.stem),))


def _read_text(data: bytes, model: str) -> np.ndarray:
    """Corners, shape (F, 3, 3)."""
    lines = re.findall(rb"(?i)^[ \t]*vertex[ \t]+([^\r\n]*)", data, re.MULTILINE)
    try:
        values = np.fromstring(b" ".join(lines), np.float64, sep=" ")
        return values.reshape(-1, 3, 3)
    except ValueError as error:
        raise MeshError(f"{model}: a facet is incomplete or holds something that is no number; repair it") from error
