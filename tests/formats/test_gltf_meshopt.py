"""GLB files compressed with meshoptimizer, GLB chunks that are not padded, KTX2, WebP and AVIF textures."""

import io
import json
import struct
import sys

import meshopt
import numpy as np
import pytest
from PIL import Image
from support.tiny_meshes import charted_sphere
from support.tiny_models import QUAD, Glb

from mi_simplify.errors import AssetError
from mi_simplify.formats.load import load_asset

SPHERE = charted_sphere(8)


def compressed(name: str, *, filtered: bool = False) -> Glb:
    """A sphere of which only the compressed bytes are there; normals filtered (octahedral) on request."""
    glb = Glb()
    vertices, faces = SPHERE.vertices.astype("f4"), SPHERE.faces.astype("u4")
    normals = np.concatenate([SPHERE.vertices, np.ones((len(vertices), 1))], axis=1).astype("f4")
    rows = meshopt.encode_filter_oct(normals, 4, 8) if filtered else vertices
    columns = [
        (vertices, vertices, 12, "ATTRIBUTES", "NONE", {"componentType": 5126, "type": "VEC3", "count": len(vertices)}),
        (faces.ravel(), faces.ravel(), 4, "TRIANGLES", "NONE",
         {"componentType": 5125, "type": "SCALAR", "count": faces.size}),
        (normals, rows, rows.nbytes // len(rows), "ATTRIBUTES", "OCTAHEDRAL" if filtered else "NONE",
         {"componentType": 5120 if filtered else 5126, "normalized": filtered, "type": "VEC3", "count": len(vertices)}),
    ]  # fmt: skip
    for _, stored, stride, mode, kind, accessor in columns:
        data = meshopt.encode_gltf_buffer(stored, mode)
        view = {"buffer": 0, "byteLength": len(data), "byteOffset": len(glb.binary), "count": accessor["count"]}
        view |= {"byteStride": stride, "mode": mode, "filter": kind}
        glb.binary += data + b"\0" * (-len(data) % 4)
        glb.json["bufferViews"].append(
            {"buffer": 1, "byteLength": stride * accessor["count"], "extensions": {name: view}}
            | ({"byteStride": stride} if mode == "ATTRIBUTES" else {})
        )
        glb.json["accessors"].append(accessor | {"bufferView": len(glb.json["bufferViews"]) - 1})
    glb.mesh({"attributes": {"POSITION": 0, "NORMAL": 2}, "indices": 1}, name="sphere")
    glb.json["extensionsRequired"] = glb.json["extensionsUsed"] = [name]
    return glb


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@pytest.mark.parametrize("filtered", [False, True])
def test_what_meshopt_encoded_comes_back(tmp_path, name, filtered):
    asset = load_asset(compressed(name, filtered=filtered).save(tmp_path / "a.glb"))
    (part,) = asset.parts
    corners = part.vertices[part.faces]
    # The codec may turn a triangle, so that it begins with another corner.
    np.testing.assert_allclose(corners.mean(1), SPHERE.vertices[SPHERE.faces].mean(1), atol=1e-6)
    assert part.normals is not None
    if filtered:
        assert np.sum(part.normals * part.vertices, axis=1).min() > 0.99
    else:
        np.testing.assert_allclose(part.normals, part.vertices, atol=1e-5)


def test_broken_meshopt(tmp_path):
    glb = compressed("EXT_meshopt_compression")
    glb.binary = glb.binary[:4] + b"\xff" * (len(glb.binary) - 4)
    with pytest.raises(AssetError, match=r"a.glb: bufferViews\[\d\], compressed with meshopt, is broken"):
        load_asset(glb.save(tmp_path / "a.glb"))


@pytest.mark.parametrize("missing", ["after JSON", "after BIN", "counted after BIN"])
def test_chunks_without_padding(tmp_path, missing):
    glb = Glb()
    glb.mesh(glb.quad())
    glb.json["buffers"] = [{"byteLength": len(glb.binary)}]
    text = json.dumps({k: v for k, v in glb.json.items() if v != []}).encode()
    text += b" " * (-len(text) % 4 + (1 if missing == "after JSON" else 0))
    binary = glb.binary.ljust(-(-len(glb.binary) // 4) * 4, b"\0")
    assert len(text) % 4 == (1 if missing == "after JSON" else 0)
    counted, binary = len(binary), binary if missing == "after JSON" else glb.binary
    counted = counted if missing == "counted after BIN" else len(binary)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", counted, b"BIN\0") + binary
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 20 + len(text) + 8 + counted) + body)
    (part,) = load_asset(tmp_path / "a.glb").parts
    np.testing.assert_allclose(part.vertices, QUAD)


def solid_ktx2(color: tuple[int, int, int, int], size: int = 8) -> bytes:
    """A KTX2 file of one colour, in UASTC blocks of mode 8."""
    block = 0x17 | sum(c << (5 + 8 * k) for k, c in enumerate(color))
    data = block.to_bytes(16, "little") * (size // 4) ** 2
    # Data format descriptor: one UASTC sample of four channels, linear.
    sample = struct.pack("<HBBI2I", 0, 127, 3, 0, 0, 0xFFFFFFFF)
    descriptor = struct.pack("<IHHBBBBBBBB8s", 0, 2, 24 + len(sample), 166, 1, 1, 0, 3, 3, 0, 0, bytes([16]) + bytes(7))
    descriptor += sample
    dfd = struct.pack("<I", 4 + len(descriptor)) + descriptor
    first = 80 + 24 + len(dfd)
    at = -(-first // 16) * 16
    header = b"\xabKTX 20\xbb\r\n\x1a\n" + struct.pack("<9I", 0, 1, size, size, 0, 0, 1, 1, 0)
    header += struct.pack("<4I2Q", 104, len(dfd), 0, 0, 0, 0) + struct.pack("<3Q", at, len(data), len(data))
    return (header + dfd).ljust(at, b"\0") + data


def textured(data: bytes, extension: str | None) -> Glb:
    glb = Glb()
    glb.json["images"].append({"bufferView": glb.view(data), "mimeType": "image/x"})
    glb.json["textures"].append({"extensions": {extension: {"source": 0}}} if extension else {"source": 0})
    if extension:
        glb.json["extensionsRequired"] = [extension]
    glb.mesh(glb.quad(glb.material(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})))
    return glb


def test_ktx2_texture(tmp_path, monkeypatch):
    glb = textured(solid_ktx2((200, 100, 50, 255)), "KHR_texture_basisu")
    (part,) = load_asset(glb.save(tmp_path / "a.glb")).parts
    assert part.material.base_color.shape == (8, 8, 4)
    expected = ((np.array([200, 100, 50]) / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(part.material.base_color[3, 3, :3], expected, atol=0.01)
    broken = textured(solid_ktx2((0, 0, 0, 255))[:150], "KHR_texture_basisu")
    with pytest.raises(AssetError, match="a.glb: KTX2 texture .* cannot be read .*ktxdecompress"):
        load_asset(broken.save(tmp_path / "a.glb"))
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    with pytest.raises(AssetError, match=r"is KTX2; pip install 'mi-simplify\[ktx2\]' reads it, or convert"):
        load_asset(glb.save(tmp_path / "a.glb"))


@pytest.mark.parametrize(("kind", "extension"), [("WEBP", "EXT_texture_webp"), ("AVIF", "EXT_texture_avif")])
def test_webp_and_avif(tmp_path, kind, extension):
    stream = io.BytesIO()
    Image.new("RGB", (16, 16), (200, 100, 50)).save(stream, kind, quality=95)
    (part,) = load_asset(textured(stream.getvalue(), extension).save(tmp_path / "a.glb")).parts
    expected = ((np.array([200, 100, 50]) / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(part.material.base_color[8, 8, :3], expected, atol=0.03)
