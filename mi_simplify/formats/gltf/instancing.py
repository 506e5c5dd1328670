"""
Copies of a model in one GLB file: EXT_mesh_gpu_instancing.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from ...errors import OutputError
from ...machine.files import write_atomic

EXTENSION = "EXT_mesh_gpu_instancing"

_JSON, _BIN = 0x4E4F534A, 0x004E4942


def write_instanced(source: str | Path, placements: np.ndarray, path: str | Path) -> Path:
    """
    Write a GLB file that shows another one's model many times; its meshes and textures are in it once.

    The extension is required, not only used: a viewer without it would show one copy and say nothing.

    Parameters
    ----------
    source : str or Path
        A GLB file whose meshes stand in the root of the scene, untransformed, as :func:`.write.write_glb` writes them.
    placements : ndarray, shape (N, 4, 4)
        Rotation, uniform scale and translation of each copy.
    path : str or Path

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        ``source`` is no such file, or ``path`` cannot be written.
    """
    document, binary = _read(Path(source))
    nodes = document.get("nodes", [])
    moved = [n for n in nodes if {"children", "matrix", "translation", "rotation", "scale", "skin"} & set(n)]
    if moved or not any("mesh" in n for n in nodes):
        raise OutputError(f"{source}: its meshes do not stand in the root of the scene; export it with mi-simplify")
    translation, rotation, scale = _parts(placements)
    attributes = {}
    for name, array in (("TRANSLATION", translation), ("ROTATION", rotation), ("SCALE", scale)):
        data = np.ascontiguousarray(array, "<f4").tobytes()
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)}
        document["bufferViews"].append(view)
        accessor = {
            "bufferView": len(document["bufferViews"]) - 1, "componentType": 5126, "count": len(array),
            "type": f"VEC{array.shape[1]}",
        }  # fmt: skip
        document["accessors"].append(accessor)
        attributes[name] = len(document["accessors"]) - 1
        binary += data
    for node in nodes:
        if "mesh" in node:
            node.setdefault("extensions", {})[EXTENSION] = {"attributes": attributes}
    for key in ("extensionsUsed", "extensionsRequired"):
        document[key] = sorted({*document.get(key, ()), EXTENSION})
    document["buffers"][0]["byteLength"] = len(binary)
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(binary), _BIN) + binary
    return write_atomic(path, struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _read(path: Path) -> tuple[dict, bytes]:
    """JSON and binary chunk of a GLB file that has both."""
    try:
        data = path.read_bytes()
        magic, _, _ = struct.unpack_from("<4sII", data)
        length, kind = struct.unpack_from("<II", data, 12)
        document = json.loads(data[20 : 20 + length])
        size, kind_of_binary = struct.unpack_from("<II", data, 20 + length)
    except (OSError, ValueError, struct.error) as error:
        raise OutputError(f"{path}: cannot be read as a GLB file ({error}); name a model.glb of mi-simplify") from None
    if (magic, kind, kind_of_binary) != (b"glTF", _JSON, _BIN):
        raise OutputError(f"{path}: is no GLB file with a binary chunk; name a model.glb of mi-simplify")
    return document, data[28 + length : 28 + length + size]


def _parts(placements: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translations (N, 3), unit quaternions xyzw (N, 4) and scales (N, 3)."""
    from scipy.spatial.transform import Rotation

    linear = placements[:, :3, :3]
    size = np.cbrt(np.linalg.det(linear))
    rotation = Rotation.from_matrix(linear / size[:, None, None]).as_quat()
    return placements[:, :3, 3], rotation, np.repeat(size[:, None], 3, axis=1)
