"""
The container of a GLB file that is written: buffers with the views, accessors and images that point into them.
"""

from __future__ import annotations

import json
import struct

import meshopt
import numpy as np

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
MESHOPT = "EXT_meshopt_compression"

_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


class Container:
    """
    Grows by arrays and images, and becomes the bytes of a file.

    Parameters
    ----------
    compress : bool
        Store arrays by EXT_meshopt_compression.
    """

    def __init__(self, compress: bool = False) -> None:
        self.compress = compress
        self.data = bytearray()
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.images: list[dict] = []
        self.textures: list[dict] = []
        self.extensions: set[str] = set()
        """Extensions that the file uses."""
        self.required: set[str] = set()
        """Those without which it cannot be read."""
        self._n_plain = 0

    def view(self, content: bytes, target: int | None = None, stride: int | None = None) -> int:
        """
        Append bytes, padded to a multiple of 4, and return the view's index.
        """
        place = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)}
        self.views.append({**place, **some("byteStride", stride), **some("target", target)})
        self._append(content)
        return len(self.views) - 1

    def accessor(
        self, array: np.ndarray, target: int | None = None, *, bounds: bool = False, normalized: bool = False,
        packed: np.ndarray | None = None,
    ) -> int:  # fmt: skip
        """
        Append an array of scalars (n,), vectors (n, k) or 4x4 matrices (n, 16) and return the accessor's index.

        Parameters
        ----------
        array : ndarray
            Of one of glTF's component types.
        bounds : bool
            Say the least and greatest values; float32 to decimal and back is exact.
        normalized : bool
            Integers stand for [0, 1] or [-1, 1].
        packed : ndarray, optional
            What is compressed in place of ``array``: octahedral unit vectors.
        """
        kind = array.dtype.str[1:]
        columns = 1 if array.ndim == 1 else array.shape[1]
        entry: dict = {
            "componentType": _COMPONENTS[kind],
            "count": len(array),
            "type": "SCALAR" if array.ndim == 1 else "MAT4" if columns == 16 else f"VEC{columns}",
            **({"normalized": True} if normalized else {}),
        }
        if bounds:
            entry |= {name: np.atleast_1d(f(0)).tolist() for name, f in (("min", array.min), ("max", array.max))}
        aligned, stride = array, None
        if target == ARRAY_BUFFER and columns * array.itemsize % 4:  # elements begin at multiples of four
            spare = -columns % (4 // array.itemsize)
            aligned = np.concatenate([array, np.zeros((len(array), spare), array.dtype)], axis=1)
            stride = aligned.shape[1] * array.itemsize
        index = None
        if self.compress:
            index = self._compressed(np.ascontiguousarray(aligned), target, packed)
        entry["bufferView"] = self.view(aligned.tobytes(), target, stride) if index is None else index
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def image(self, name: str, content: bytes, mime: str, extension: str | None = None) -> dict:
        """
        Append an image and return the texture reference of a material.

        Parameters
        ----------
        extension : str, optional
            What the texture needs to name an image of this kind.
        """
        self.images.append({"name": name, "mimeType": mime, "bufferView": self.view(content)})
        source: dict = {"source": len(self.images) - 1}
        if extension is not None:
            self.extensions.add(extension)
            self.required.add(extension)  # there is no other image to fall back to
            source = {"extensions": {extension: source}}
        self.textures.append({"name": name, "sampler": 0, **source})
        return {"index": len(self.textures) - 1}

    def glb(self, document: dict) -> bytes:
        """
        The bytes of the file that ``document``, its JSON without what the container holds, describes.
        """
        buffers: list[dict] = [{"byteLength": len(self.data)}]
        if self._n_plain:
            buffers.append({"byteLength": self._n_plain, "extensions": {MESHOPT: {"fallback": True}}})
        lists = {
            "textures": self.textures, "images": self.images, "accessors": self.accessors, "bufferViews": self.views,
            "buffers": buffers, "extensionsUsed": sorted(self.extensions), "extensionsRequired": sorted(self.required),
        }  # fmt: skip
        document = document | {name: entries for name, entries in lists.items() if entries}
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text  # "JSON"
        chunks += struct.pack("<II", len(self.data), 0x004E4942) + bytes(self.data)  # "BIN"
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _compressed(self, array: np.ndarray, target: int | None, packed: np.ndarray | None) -> int | None:
        """The view of a compressed array; None where compression gains nothing."""
        stride = array.nbytes // len(array)
        facts = {"byteStride": stride, "count": len(array), "mode": "ATTRIBUTES"}
        if target == ELEMENT_ARRAY_BUFFER:
            facts["mode"] = "TRIANGLES"
            content = meshopt.encode_gltf_buffer(array, "TRIANGLES")
        elif stride % 4 or stride > 256:
            return None
        else:
            content = meshopt.encode_gltf_buffer(array if packed is None else packed, "ATTRIBUTES")
            facts |= {} if packed is None else {"filter": "OCTAHEDRAL"}
        if len(content) >= array.nbytes:
            return None
        place = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)}
        view = {"buffer": 1, "byteOffset": self._n_plain, "byteLength": array.nbytes}
        if target == ARRAY_BUFFER:
            view["byteStride"] = stride
        self.views.append({**view, **some("target", target), "extensions": {MESHOPT: place | facts}})
        self._append(content)
        self._n_plain += array.nbytes + -array.nbytes % 4
        self.extensions.add(MESHOPT)
        self.required.add(MESHOPT)
        return len(self.views) - 1

    def _append(self, content: bytes) -> None:
        self.data += content + bytes(-len(content) % 4)


def some(key: str, value: object) -> dict:
    """
    An entry only where there is a value.
    """
    return {} if value is None else {key: value}
