"""
A glTF file with some of its arrays and images replaced, and everything else as it is.
"""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import AssetError
from ...textures import png
from ..file import GltfFile
from ..meshopt import compression

#: Channels of a material's texture that stand in one image, by the key of its reference.
TEXTURES = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture")


class GltfEdit:
    """
    Collects changes, then writes them into a copy of the file, as GLB.

    What no longer belongs to anything is left out: replaced arrays and images, unless others use them, too.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    AssetError
        See :class:`..file.GltfFile`.
    """

    def __init__(self, path: str | Path):
        self._file = GltfFile(Path(path), [])
        self.json: dict[str, Any] = copy.deepcopy(self._file.json)
        self._new: list[bytes] = []
        self._arrays: dict[int, np.ndarray] = {}

    def primitive(self, mesh: int, index: int) -> dict[str, Any]:
        """The JSON of a primitive, to be changed in place."""
        return self.json["meshes"][mesh]["primitives"][index]

    def values(self, mesh: int, index: int, attribute: str) -> np.ndarray | None:
        """
        An attribute of a primitive as the file has it, without morph targets; None where it has none.

        Raises
        ------
        AssetError
            The primitive is compressed by Draco, which these arrays are not.
        """
        primitive = self.primitive(mesh, index)
        if "KHR_draco_mesh_compression" in (primitive.get("extensions") or {}):
            raise AssetError(
                f"{self._file.name}: its meshes are compressed by Draco and cannot be moved in place; export the file "
                "without compression"
            )
        accessor = primitive["attributes"].get(attribute)
        if accessor is None:
            return None
        return self._arrays[accessor].copy() if accessor in self._arrays else np.array(self._file.accessor(accessor))

    def used(self, mesh: int, index: int) -> np.ndarray:
        """The vertices that a primitive's triangles refer to, ascending."""
        primitive = self.primitive(mesh, index)
        if primitive.get("indices") is None:
            return np.arange(self._file.item("accessors", primitive["attributes"]["POSITION"])["count"])
        corners = self._file.accessor(primitive["indices"]).astype(np.int64)
        return np.unique(corners[: len(corners) // 3 * 3] if primitive.get("mode", 4) == 4 else corners)

    def set_values(self, mesh: int, index: int, attribute: str, values: np.ndarray) -> None:
        """
        Replace an attribute, shape (N, C), stored as float32, in all primitives that share it.
        """
        attributes, values = self.primitive(mesh, index)["attributes"], np.ascontiguousarray(values, "<f4")
        entry = {
            "bufferView": self._view(values.tobytes(), 34962), "componentType": 5126, "count": len(values),
            "type": f"VEC{values.shape[1]}",
        }  # fmt: skip
        if attribute == "POSITION":
            entry |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        if attribute in attributes:
            self.json["accessors"][attributes[attribute]] = entry
        else:
            self.json.setdefault("accessors", []).append(entry)
            attributes[attribute] = len(self.json["accessors"]) - 1
        self._arrays[attributes[attribute]] = values

    def material(self, mesh: int, index: int) -> int:
        """
        The number of a primitive's material; one without any gets that which our readers see in its place.
        """
        primitive = self.primitive(mesh, index)
        if primitive.get("material") is None:
            factors = {"baseColorFactor": [0.5, 0.5, 0.5, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.5}
            self.json.setdefault("materials", []).append({"pbrMetallicRoughness": factors})
            primitive["material"] = len(self.json["materials"]) - 1
        return primitive["material"]

    def set_texture(self, material: int, key: str, pixels: np.ndarray) -> None:
        """
        Replace a texture of a material: its image, the sampler and coordinates stay.

        Parameters
        ----------
        key : str
            One of :data:`TEXTURES`.
        pixels : ndarray, shape (H, W, C), uint8
        """
        owner = self._owner(material, key)
        info, textures = owner.setdefault(key, {}), self.json.setdefault("textures", [])
        old = textures[info["index"]] if "index" in info else {}
        sampler = {"sampler": old["sampler"]} if "sampler" in old else {}
        images = self.json.setdefault("images", [])
        name = f"{self.json['materials'][material].get('name', f'material_{material}')} {key.removesuffix('Texture')}"
        images.append({"name": name, "mimeType": "image/png", "bufferView": self._view(png(pixels), None)})
        textures.append({"source": len(images) - 1, **sampler})
        info["index"] = len(textures) - 1
        info.pop("scale", None)  # of a normal map, which is in the image now

    def set_factors(self, material: int, **factors: Any) -> None:
        """
        Set factors of a material, those of :attr:`pbrMetallicRoughness` by their keys.
        """
        self._owner(material, "baseColorTexture").update(factors)

    def _owner(self, material: int, key: str) -> dict[str, Any]:
        whole = self.json["materials"][material]
        return whole if key == "normalTexture" else whole.setdefault("pbrMetallicRoughness", {})

    def _view(self, content: bytes, target: int | None) -> int:
        views = self.json.setdefault("bufferViews", [])
        views.append({"new": len(self._new), "byteLength": len(content), **({"target": target} if target else {})})
        self._new.append(content)
        return len(views) - 1

    def glb(self) -> bytes:
        """
        The bytes of the changed file: one buffer, images inside.
        """
        document = copy.deepcopy(self.json)
        data = bytearray()

        def stored(content: bytes) -> dict[str, int]:
            place = {"buffer": 0, "byteOffset": len(data), "byteLength": len(content)}
            data.extend(bytes(content) + bytes(-len(content) % 4))
            return place

        _drop_unused(document, "textures", _texture_references)
        _drop_unused(document, "images", lambda d, f: _walk(d.get("textures"), "source", f))
        for image in document.get("images", []):
            if "uri" in image:
                uri = image.pop("uri")
                content = self._file.uri_bytes(uri, "texture")
                image["mimeType"] = "image/png" if content[:4] == b"\x89PNG" else image.get("mimeType", "image/jpeg")
                document.setdefault("bufferViews", []).append({"embedded": content})
                image["bufferView"] = len(document["bufferViews"]) - 1
        _drop_unused(document, "bufferViews", _view_references)
        n_plain = 0
        for view in document.get("bufferViews", []):
            if "embedded" in view:
                view.update(stored(view.pop("embedded")))
            elif "new" in view:
                view.update(stored(self._new[view.pop("new")]))
            elif (packed := compression(view)) is not None:
                packed.update(stored(bytes(self._bytes(packed))))
                view |= {"buffer": 1, "byteOffset": n_plain}
                n_plain += view["byteLength"] + -view["byteLength"] % 4
            else:
                view.update(stored(bytes(self._bytes(view))))
        document["buffers"] = [{"byteLength": len(data)}]
        if n_plain:
            extension = next(x for x in ("EXT_meshopt_compression", "KHR_meshopt_compression") if _uses(document, x))
            document["buffers"].append({"byteLength": n_plain, "extensions": {extension: {"fallback": True}}})
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(data)) + chunks + bytes(data)

    def _bytes(self, view: dict[str, Any]) -> memoryview:
        return self._file.slice(view, -1)


def _uses(document: dict[str, Any], extension: str) -> bool:
    return extension in document.get("extensionsUsed", [])


Change = Callable[[int], int]


def _walk(node: Any, key: str, change: Change) -> None:
    """Give every integer under a key, at any depth, to ``change``, and put what it returns in its place."""
    if isinstance(node, dict):
        for name, value in node.items():
            if name == key and isinstance(value, int):
                node[name] = change(value)
            else:
                _walk(value, key, change)
    elif isinstance(node, list):
        for value in node:
            _walk(value, key, change)


def _texture_references(document: dict[str, Any], change: Change) -> None:
    """All numbers of textures: an ``index`` in whatever of a material is called a texture."""

    def search(node: Any) -> None:
        if isinstance(node, dict):
            for name, value in node.items():
                if name.endswith("Texture") and isinstance(value, dict) and isinstance(value.get("index"), int):
                    value["index"] = change(value["index"])
                search(value)
        elif isinstance(node, list):
            for value in node:
                search(value)

    search(document.get("materials"))
    search(document.get("extensions"))


def _view_references(document: dict[str, Any], change: Change) -> None:
    for part in (value for name, value in document.items() if name != "bufferViews"):
        _walk(part, "bufferView", change)


def _drop_unused(document: dict[str, Any], kind: str, references: Callable[[dict[str, Any], Change], None]) -> None:
    """Leave out what nothing refers to, and number the rest anew."""
    used: set[int] = set()

    def note(index: int) -> int:
        used.add(index)
        return index

    references(document, note)
    kept = sorted(used)
    number = {old: new for new, old in enumerate(kept)}
    references(document, number.__getitem__)
    if kept:
        document[kind] = [document[kind][index] for index in kept]
    else:
        document.pop(kind, None)
