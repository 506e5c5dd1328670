"""
The container of glTF 2.0: GLB chunks, JSON, buffers and accessors as NumPy arrays.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AssetError
from ...machine import memory
from ..resources import Resources, as_utf8, read_bytes
from .meshopt import compression, decompressed

#: Extensions that a file may *require*; those without a word in the reader are harmless to ignore.
SUPPORTED = {
    "KHR_texture_transform", "KHR_mesh_quantization", "KHR_materials_specular", "KHR_materials_ior",
    "KHR_materials_unlit", "KHR_materials_emissive_strength", "KHR_materials_clearcoat", "KHR_materials_sheen",
    "KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_iridescence", "KHR_materials_anisotropy",
    "KHR_materials_dispersion", "KHR_materials_variants", "KHR_materials_pbrSpecularGlossiness", "KHR_lights_punctual",
    "KHR_xmp_json_ld", "EXT_mesh_gpu_instancing", "EXT_texture_webp", "KHR_animation_pointer", "MSFT_lod",
    "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_texture_basisu",
    "EXT_texture_avif", "KHR_materials_diffuse_transmission", "KHR_materials_volume_scatter", "KHR_node_visibility",
}  # fmt: skip

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


class GltfFile:
    """
    A parsed file: ``json`` as it stands, and arrays on request.

    Parameters
    ----------
    path : Path
        A ``.glb`` or ``.gltf`` file; which it is is seen from its content.
    notes : list of str
        Grows by a line for everything that had to be left out.

    Raises
    ------
    AssetError
        Not glTF 2.0, truncated, a buffer missing, or a required extension that is not supported.
    """

    def __init__(self, path: Path, notes: list[str]):
        self.name = path.name
        self.resources = Resources(path, notes)
        data = read_bytes(path, "glTF file")
        self.json, self._binary = self._glb(data) if data[:4] == b"glTF" else (self._parse(data), None)
        version = str(self.get(self.json.get("asset"), "version", ""))
        if not version.startswith("2"):
            raise AssetError(f"{self.name}: glTF version '{version}' is not 2.0; convert the file to glTF 2.0")
        for extension in self.json.get("extensionsRequired", []):
            if extension not in SUPPORTED:
                raise AssetError(
                    f"{self.name}: it requires the unsupported extension {extension}; export the file without it"
                )
        self._buffers: dict[int, bytes] = {}
        self._decompressed: dict[int, bytes] = {}
        self.decoded: dict[int, np.ndarray] = {}
        """Accessors whose data came out of a compressed mesh, shape (N, C) or (N,), as stored."""

    def _parse(self, text: bytes) -> dict[str, Any]:
        try:
            out = json.loads(as_utf8(text).rstrip(b"\0 ").decode())
        except (ValueError, RecursionError) as error:
            raise AssetError(f"{self.name}: its JSON cannot be read ({error}); export the file again") from error
        if not isinstance(out, dict):
            raise AssetError(f"{self.name}: its JSON is no glTF object; export the file again")
        return out

    def _glb(self, data: bytes) -> tuple[dict[str, Any], bytes | None]:
        if len(data) < 20:
            raise AssetError(f"{self.name}: the GLB file is truncated after {len(data)} bytes; copy or export it again")
        length = struct.unpack_from("<I", data, 8)[0]
        if length > len(data) + 3:  # less is padding that was never written
            raise AssetError(
                f"{self.name}: the GLB file is truncated: its header promises {length} bytes, it has {len(data)}; "
                "copy or export it again"
            )
        at, length = 12, min(length, len(data))
        chunks: dict[bytes, bytes] = {}
        while at + 8 <= length:
            size, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + size > length + 3:
                raise AssetError(f"{self.name}: the GLB file is truncated inside a chunk; copy or export it again")
            chunks.setdefault(kind, data[at + 8 : min(at + 8 + size, length)])
            at += 8 + size
            padded = at + -size % 4  # a length counts its padding, but some writers leave it out
            if size % 4 and data[at + 4 : at + 8] != b"BIN\0" and data[padded + 4 : padded + 8] == b"BIN\0":
                at = padded
        if b"JSON" not in chunks:
            raise AssetError(f"{self.name}: the GLB file has no JSON chunk; export it again")
        return self._parse(chunks[b"JSON"]), chunks.get(b"BIN\0")

    @staticmethod
    def get(value: Any, key: str, default: Any = None) -> Any:
        """A member of an object that may be missing."""
        return value.get(key, default) if isinstance(value, dict) else default

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """
        Object ``index`` of a top-level array.

        Raises
        ------
        AssetError
            There is none.
        """
        items = self.json.get(kind, [])
        if not isinstance(index, int) or not isinstance(items, list) or not 0 <= index < len(items):
            raise AssetError(f"{self.name}: it refers to {kind}[{index}], which does not exist; export the file again")
        return items[index]

    def view(self, index: int) -> memoryview:
        """
        The bytes of a buffer view.
        """
        view = self.item("bufferViews", index)
        if (packed := compression(view)) is not None:
            if index not in self._decompressed:
                self._decompressed[index] = decompressed(packed, self.slice(packed, index), index, self.name)
            return memoryview(self._decompressed[index])
        return self.slice(view, index)

    def slice(self, view: dict[str, Any], index: int) -> memoryview:
        """The bytes of a buffer that a view, or the extension that stands for it, names."""
        data = self._buffer(view.get("buffer", 0))
        begin, length = view.get("byteOffset", 0), view["byteLength"]
        if begin < 0 or length < 0 or begin + length > len(data):
            raise AssetError(
                f"{self.name}: bufferViews[{index}] ends at byte {begin + length} of a buffer of {len(data)}; "
                "the file is truncated, copy or export it again"
            )
        return memoryview(data)[begin : begin + length]

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self.item("buffers", index)
            uri = buffer.get("uri")
            if uri is not None:
                data = self.uri_bytes(uri, "buffer")
            elif index == 0 and self._binary is not None:
                data = self._binary
            else:
                raise AssetError(f"{self.name}: buffers[{index}] has no data; export the file again")
            if len(data) < buffer.get("byteLength", 0):
                raise AssetError(
                    f"{self.name}: buffers[{index}] has {len(data)} of {buffer['byteLength']} bytes; "
                    "it is truncated, copy or export it again"
                )
            self._buffers[index] = data
        return self._buffers[index]

    def uri_bytes(self, uri: str, what: str) -> bytes:
        """
        The bytes behind a ``data:`` URI or the name of a file.
        """
        if not uri.startswith("data:"):
            return read_bytes(self.resources.find_url(uri, what), f"{self.name}: {what}")
        head, _, body = uri.partition(",")
        try:
            return base64.b64decode(body, validate=True) if head.endswith(";base64") else body.encode()
        except binascii.Error as error:
            raise AssetError(f"{self.name}: an embedded {what} is no base64 ({error}); export it again") from error

    def accessor(self, index: int) -> np.ndarray:
        """
        An accessor as an array, shape (N,) or (N, C); normalised integers become float32.
        """
        accessor = self.item("accessors", index)
        try:
            dtype, n_columns = np.dtype(_DTYPES[accessor["componentType"]]), _COMPONENTS[accessor["type"]]
        except KeyError as error:
            raise AssetError(f"{self.name}: accessors[{index}] is of an unknown type; export the file again") from error
        count = accessor["count"]
        if index in self.decoded:
            out = self.decoded[index].reshape(-1, n_columns)
        elif accessor.get("bufferView") is None:
            if count > 1 << 26:
                raise AssetError(f"{self.name}: accessors[{index}] declares {count} elements without data")
            memory.require(24 * count * n_columns, f"{self.name}: accessors[{index}]", "export the file with its data")
            out = np.zeros((count, n_columns), dtype)
        else:
            stride = self.item("bufferViews", accessor["bufferView"]).get("byteStride")
            out = self._strided(accessor["bufferView"], accessor.get("byteOffset", 0), stride, count, dtype, n_columns)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            where, values = sparse["indices"], sparse["values"]
            kind = np.dtype(_DTYPES[where["componentType"]])
            n = sparse["count"]
            rows = self._strided(where["bufferView"], where.get("byteOffset", 0), None, n, kind, 1)[:, 0]
            if n and rows.max() >= count:
                raise AssetError(f"{self.name}: accessors[{index}] replaces elements it does not have")
            out = out.copy()
            out[rows] = self._strided(values["bufferView"], values.get("byteOffset", 0), None, n, dtype, n_columns)
        if accessor.get("normalized") and dtype.kind in "iu":
            out = np.maximum(out / np.float32(np.iinfo(dtype).max), -1).astype(np.float32)
        return out[:, 0] if accessor["type"] == "SCALAR" else out

    def _strided(self, view: int, offset: int, stride: int | None, count: int, dtype: np.dtype, n: int) -> np.ndarray:
        data = self.view(view)
        stride = stride or n * dtype.itemsize
        if count < 0 or offset < 0 or (count and offset + stride * (count - 1) + n * dtype.itemsize > len(data)):
            raise AssetError(
                f"{self.name}: an accessor reads {count} elements beyond its buffer view of {len(data)} bytes; "
                "the file is truncated, copy or export it again"
            )
        if not count:
            return np.zeros((0, n), dtype)
        return np.ndarray((count, n), dtype, data, offset, (stride, dtype.itemsize))

    def image(self, index: int) -> np.ndarray:
        """
        An image, decoded; shape (H, W, C), see :func:`..images.decode_image`.
        """
        image = self.item("images", index)
        if image.get("bufferView") is not None:
            view, name = image["bufferView"], image.get("name") or f"images[{index}]"
            return self.resources.embedded_image(("view", view), lambda: bytes(self.view(view)), name)
        uri = image.get("uri")
        if not isinstance(uri, str):
            raise AssetError(f"{self.name}: images[{index}] has no data; export the file again")
        name = f"images[{index}]" if uri.startswith("data:") else uri
        return self.resources.embedded_image(("uri", uri), lambda: self.uri_bytes(uri, "texture"), name)
