"""
How many triangles and images a file says that it holds, from headers: what is too much is refused before it is read.
"""

from __future__ import annotations

import io
import json
import re
import struct
from pathlib import Path
from typing import Any

from PIL import Image, UnidentifiedImageError

#: As much as is looked at of a PLY file, whose header is text of any length.
_PLY_HEADER = 1 << 16

#: The longest JSON chunk of a GLB file that is looked at; those of heavy meshes are short.
_GLB_JSON = 1 << 24

#: As much of an image as is looked at: headers of JPEG files may follow profiles.
_IMAGE_HEADER = 1 << 18

_WRONG = (OSError, ValueError, LookupError, TypeError, AttributeError, struct.error, RecursionError)
"""What a header that is not what it should be may raise."""


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
    except _WRONG:
        return None


def said_image_bytes(path: str | Path) -> int:
    """
    What the images in a GLB file take as they are read [bytes]: float32, four channels of colours, three of others.

    By their headers, each as often as materials name it as colour, roughness or normals; 0 in other formats, and for
    images that are elsewhere or that Pillow does not know.
    """
    path = Path(path)
    try:
        return _glb_image_bytes(path) if path.suffix.lower() == ".glb" else 0
    except _WRONG:
        return 0


def _ply(path: Path) -> int | None:
    with open(path, "rb") as file:
        found = re.search(rb"^element\s+face\s+(\d+)\s*$", file.read(_PLY_HEADER).partition(b"end_header")[0], re.M)
    return int(found[1]) if found else None


def _stl(path: Path) -> int | None:
    with open(path, "rb") as file:
        head = file.read(84)
    (count,) = struct.unpack_from("<I", head, 80)
    return count if path.stat().st_size >= 84 + 50 * count else None  # else it is text, or cut off


def _glb_json(path: Path) -> tuple[dict[str, Any], int]:
    """The JSON of a GLB file, empty where it is none, and where its buffer begins."""
    with open(path, "rb") as file:
        magic, _, _, length, kind = struct.unpack("<4sIII4s", file.read(20))
        if magic != b"glTF" or kind != b"JSON" or length > _GLB_JSON:
            return {}, 0
        return json.loads(file.read(length)), 28 + length


def _glb(path: Path) -> int | None:
    content, _ = _glb_json(path)
    if not content:
        return None
    accessors, total = content["accessors"], 0
    for mesh in content["meshes"]:
        for primitive in mesh["primitives"]:
            mode, index = primitive.get("mode", 4), primitive.get("indices", primitive["attributes"]["POSITION"])
            corners = accessors[index]["count"]
            total += {4: corners // 3, 5: max(corners - 2, 0), 6: max(corners - 2, 0)}.get(mode, 0)
    return total


def _glb_image_bytes(path: Path) -> int:
    content, start = _glb_json(path)
    total = 0
    with open(path, "rb") as file:
        for material in content.get("materials", ()):
            metal = material.get("pbrMetallicRoughness", {})
            for named, channels in (
                (metal.get("baseColorTexture"), 4), (metal.get("metallicRoughnessTexture"), 3),
                (material.get("normalTexture"), 3),
            ):  # fmt: skip
                source = None if named is None else content["textures"][named["index"]].get("source")
                place = None if source is None else content["images"][source].get("bufferView")
                if place is None:
                    continue
                view = content["bufferViews"][place]
                file.seek(start + view.get("byteOffset", 0))
                head = io.BytesIO(file.read(min(view["byteLength"], _IMAGE_HEADER)))
                try:
                    width, height = Image.open(head).size
                except UnidentifiedImageError:
                    continue
                total += 4 * channels * width * height
    return total
