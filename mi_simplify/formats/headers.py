"""
How many triangles a file says that it holds, from its first bytes: what is too much is refused before it is read.
"""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path

#: As much as is looked at of a PLY file, whose header is text of any length.
_PLY_HEADER = 1 << 16

#: The longest JSON chunk of a GLB file that is looked at; those of heavy meshes are short.
_GLB_JSON = 1 << 24


def said_triangles(path: str | Path) -> int | None:
    """
    Triangles of a PLY, STL (binary) or GLB file by its header, before it is read.

    Polygons count as one triangle each and meshes once however often they are placed, so that it never says too many.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    int or None
        None where the format has no such count, or the header is not what it should be: that is for the reader to say.
    """
    path = Path(path)
    read = {".ply": _ply, ".stl": _stl, ".glb": _glb}.get(path.suffix.lower())
    try:
        return None if read is None else read(path)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, struct.error, RecursionError):
        return None


def _ply(path: Path) -> int | None:
    with open(path, "rb") as file:
        found = re.search(rb"^element\s+face\s+(\d+)\s*$", file.read(_PLY_HEADER).partition(b"end_header")[0], re.M)
    return int(found[1]) if found else None


def _stl(path: Path) -> int | None:
    with open(path, "rb") as file:
        head = file.read(84)
    (count,) = struct.unpack_from("<I", head, 80)
    return count if path.stat().st_size >= 84 + 50 * count else None  # else it is text, or cut off


def _glb(path: Path) -> int | None:
    with open(path, "rb") as file:
        magic, _, _, length, kind = struct.unpack("<4sIII4s", file.read(20))
        if magic != b"glTF" or kind != b"JSON" or length > _GLB_JSON:
            return None
        content = json.loads(file.read(length))
    accessors, total = content["accessors"], 0
    for mesh in content["meshes"]:
        for primitive in mesh["primitives"]:
            mode, index = primitive.get("mode", 4), primitive.get("indices", primitive["attributes"]["POSITION"])
            corners = accessors[index]["count"]
            total += {4: corners // 3, 5: max(corners - 2, 0), 6: max(corners - 2, 0)}.get(mode, 0)
    return total
