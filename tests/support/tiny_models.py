"""Tiny models that the reader tests write: a quad whose texture has a colour in every corner, and a GLB builder."""

import io
import json
import struct
from typing import Any

import numpy as np
from PIL import Image

from mi_simplify.model.asset import Part

#: Colour at each corner of the quad, by position: what a viewer shows when the texture is the right way up.
CORNERS = {(0, 1): (255, 0, 0), (1, 1): (0, 255, 0), (0, 0): (0, 0, 255), (1, 0): (255, 255, 255)}

#: Corners of the quad, counter-clockwise seen from +Z, with UVs whose origin is the *bottom* left (OBJ, PLY, USD).
QUAD = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
QUAD_ST = QUAD[:, :2]
QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def corner_pixels(size: int = 8) -> np.ndarray:
    """Four squares: red top left, green top right, blue bottom left, white bottom right; uint8 sRGB."""
    image = np.zeros((size, size, 3), np.uint8)
    h = size // 2
    image[:h, :h], image[:h, h:] = CORNERS[0, 1], CORNERS[1, 1]
    image[h:, :h], image[h:, h:] = CORNERS[0, 0], CORNERS[1, 0]
    return image


def png(pixels: np.ndarray) -> bytes:
    """PNG bytes of uint8 pixels, shape (H, W) or (H, W, C)."""
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def assert_corner_colors(part: Part) -> None:
    """The texture is the right way up: each corner of the quad shows its colour."""
    image = part.material.base_color
    height, width = image.shape[:2]
    centre = part.uvs.mean(axis=0)
    seen = set()
    for position, uv in zip(part.vertices, part.uvs, strict=True):
        u, v = uv + 0.2 * (centre - uv)  # inside the square of the corner
        texel = image[int(np.floor(v * height)) % height, int(np.floor(u * width)) % width, :3]
        corner = int(round(position[0])), int(round(position[1]))
        np.testing.assert_allclose(texel, np.array(CORNERS[corner]) / 255, atol=1e-6, err_msg=str(corner))
        seen.add(corner)
    assert seen == set(CORNERS)


def face_normals(part: Part) -> np.ndarray:
    """Geometric normals by the winding, shape (F, 3)."""
    p = part.vertices[part.faces]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


class Glb:
    """Builds a glTF file: buffers from arrays, images from bytes, everything else by hand in ``json``."""

    _TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}

    def __init__(self):
        self.binary = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [],
            "materials": [], "textures": [], "images": [], "accessors": [], "bufferViews": [],
        }  # fmt: skip

    def view(self, data: bytes) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, array: np.ndarray, **extra) -> int:
        array = np.ascontiguousarray(array)
        n = 1 if array.ndim == 1 else array.shape[1]
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[n]
        entry = {"bufferView": self.view(array.tobytes()), "count": len(array), "type": kind}
        entry["componentType"] = self._TYPES[array.dtype.str[1:]]
        self.json["accessors"].append({**entry, **extra})
        return len(self.json["accessors"]) - 1

    def texture(self, pixels: np.ndarray) -> int:
        self.json["images"].append({"bufferView": self.view(png(pixels)), "mimeType": "image/png"})
        self.json["textures"].append({"source": len(self.json["images"]) - 1})
        return len(self.json["textures"]) - 1

    def quad(self, material: int | None = None, **attributes: np.ndarray) -> dict:
        """A primitive of the quad; the UV origin of glTF is the top left."""
        given = {
            "POSITION": QUAD.astype("f4"),
            "TEXCOORD_0": np.stack([QUAD_ST[:, 0], 1 - QUAD_ST[:, 1]], 1).astype("f4"),
            **attributes,
        }
        primitive = {"attributes": {k: self.accessor(a) if isinstance(a, np.ndarray) else a for k, a in given.items()}}
        primitive["indices"] = self.accessor(QUAD_FACES.ravel().astype("u2"))
        if material is not None:
            primitive["material"] = material
        return primitive

    def mesh(self, *primitives: dict, name: str = "quad") -> int:
        self.json["meshes"].append({"name": name, "primitives": list(primitives)})
        return len(self.json["meshes"]) - 1

    def material(self, **content) -> int:
        self.json["materials"].append(content)
        return len(self.json["materials"]) - 1

    def nodes(self, *nodes: dict) -> None:
        self.json["nodes"] = list(nodes)
        children = {c for n in nodes for c in n.get("children", [])}
        self.json["scenes"] = [{"nodes": [i for i in range(len(nodes)) if i not in children]}]

    def bytes(self) -> bytes:
        if self.binary:
            self.json["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps({k: v for k, v in self.json.items() if v != []}).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + b"\0" * (-len(self.binary) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text
        if binary:
            body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

    def save(self, path) -> str:
        path.write_bytes(self.bytes())
        return str(path)
