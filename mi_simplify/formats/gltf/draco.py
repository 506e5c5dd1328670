"""
Meshes compressed with Draco (KHR_draco_mesh_compression), decoded into the accessors that stand for them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import AssetError
from ...machine import memory
from .file import GltfFile

EXTENSION = "KHR_draco_mesh_compression"

#: Bytes that a decoded element takes at most while it is decoded.
_PER_ELEMENT = 64


def draco_accessors(file: GltfFile) -> dict[int, np.ndarray]:
    """
    What the compressed primitives of a file hold, by the index of the accessor that has no data of its own.

    Returns
    -------
    dict of int to ndarray
        Shape (N, C), or (N,) for the indices of triangles; as stored, integers are not normalised.

    Raises
    ------
    AssetError
        The package DracoPy is not installed, a compressed mesh is broken, or is not what its accessors declare.
    """
    out: dict[int, np.ndarray] = {}
    is_required = EXTENSION in file.json.get("extensionsRequired", [])
    for mesh in file.json.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            packed = (primitive.get("extensions") or {}).get(EXTENSION)
            # Where it has a plain copy as well, that is read.
            if packed is not None and (is_required or _is_bare(file, primitive)):
                out.update(_decoded(file, primitive, packed))
    return out


def _is_bare(file: GltfFile, primitive: dict[str, Any]) -> bool:
    """Whether accessors of a primitive have no data of their own."""
    indices = [*(primitive.get("attributes") or {}).values(), primitive.get("indices")]
    accessors = [file.item("accessors", index) for index in indices if index is not None]
    return any(a.get("bufferView") is None and "sparse" not in a for a in accessors)


def _decoded(file: GltfFile, primitive: dict[str, Any], packed: dict[str, Any]) -> dict[int, np.ndarray]:
    try:
        import DracoPy
    except ImportError:
        raise AssetError(
            f"{file.name}: its meshes are compressed with Draco; pip install 'mi-simplify[draco]' reads them"
        ) from None
    attributes, indices = primitive.get("attributes") or {}, primitive.get("indices")
    counts = {key: file.item("accessors", index)["count"] for key, index in attributes.items()}
    n_corners = 0 if indices is None else file.item("accessors", indices)["count"]
    memory.require(
        _PER_ELEMENT * (sum(counts.values()) + n_corners), f"{file.name}: a compressed mesh", "simplify the file first"
    )
    try:
        mesh = DracoPy.decode(bytes(file.view(packed["bufferView"])))
        rows = {a["unique_id"]: np.asarray(a["data"]) for a in mesh.attributes}
        faces = np.asarray(mesh.faces, np.uint32).ravel()
        out = {attributes[key]: rows[number] for key, number in packed["attributes"].items() if key in attributes}
    except (DracoPy.FileTypeException, AttributeError, KeyError, ValueError, RuntimeError) as error:
        raise AssetError(f"{file.name}: a mesh compressed with Draco is broken ({error}); export it again") from error
    if indices is not None:
        out[indices] = faces
    for index, values in out.items():
        declared = file.item("accessors", index)["count"]
        if len(values) != declared:
            raise AssetError(
                f"{file.name}: a mesh compressed with Draco has {len(values)} elements, but accessors[{index}] "
                f"declares {declared}; export it again"
            )
    return out
