"""Files that would fill the memory, and what the fuzzer found; each ends in one clear line."""

import os
import struct
import subprocess
import sys
import time
import zipfile
import zlib

import numpy as np
import pytest
from pxr import UsdUtils
from support.hostile import OBJ, TRIANGLE, refused, with_secret, write
from support.tiny_models import Glb, corner_pixels, png

from mi_simplify.errors import AssetError, MemoryLimitError, UserError
from mi_simplify.formats.images import decode_image
from mi_simplify.formats.load import load_asset
from mi_simplify.machine import memory


@pytest.fixture
def folders(tmp_path):
    """A folder for the model, and one beside it with what it must not see."""
    return with_secret(tmp_path)


# --- memory ----------------------------------------------------------------------------------------------------------


def bomb(width: int, height: int, data: bytes = b"") -> bytes:
    """A grey PNG that declares a size."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def test_png_bombs(tmp_path):
    write(tmp_path / "a.mtl", "newmtl paint\nmap_Kd a.png\n")
    path = write(tmp_path / "a.obj", f"mtllib a.mtl\n{OBJ}")
    write(tmp_path / "a.png", bomb(16000, 16000, zlib.compress(bytes(1000))))
    refused(path, r"texture 'a.png' cannot be read: it is cut off: \d+ bytes cannot hold 16000 x 16000 pixels")
    packer = zlib.compressobj(9)
    whole = b"".join(packer.compress(bytes(16001 * 100)) for _ in range(160)) + packer.flush()
    write(tmp_path / "a.png", bomb(16000, 16000, whole))
    assert (tmp_path / "a.png").stat().st_size < 1e6
    with memory.limited(2 << 30):
        refused(path, "16000 x 16000 pixels needs about 8.6 GB of memory.*-limit 2.0 GB; scale it", MemoryLimitError)


@pytest.mark.parametrize("count", [10**8, 2**31, 2**62])
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_ply_of_billions(tmp_path, count, kind):
    for vertices, faces in ((count, 1), (3, count)):
        text = f"ply\nformat {kind} 1.0\nelement vertex {vertices}\n"
        text += "property float x\nproperty float y\nproperty float z\n"
        text += f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        text += "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
        refused(write(tmp_path / "a.ply", text), "ends before its last vertex or face", UserError, seconds=5)


def test_stl_of_billions(tmp_path):
    refused(write(tmp_path / "a.stl", bytes(80) + b"\xff" * 60), "promises 4294967295 facets", UserError, seconds=5)


@pytest.mark.parametrize("count", [10**7, 10**9, 10**18])
def test_accessors_of_billions(tmp_path, count):
    for key in ("POSITION", "indices"):
        glb = Glb()
        primitive = glb.quad()
        glb.mesh(primitive)
        accessor = glb.json["accessors"][primitive["indices"] if key == "indices" else primitive["attributes"][key]]
        accessor["count"] = count
        refused(glb.save(tmp_path / "a.glb"), "beyond its buffer view", UserError, seconds=5)
        del accessor["bufferView"]
        with memory.limited(1 << 30):
            refused(glb.save(tmp_path / "a.glb"), "without data|of memory|rows for", UserError, seconds=5)


def test_instances_of_instances(tmp_path):
    glb = Glb()
    offsets = glb.accessor(np.zeros((4, 3), np.float32))
    glb.json["accessors"][offsets].update(count=60_000_000)
    del glb.json["accessors"][offsets]["bufferView"]
    glb.mesh(glb.quad())
    glb.nodes({"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": offsets}}}})
    with memory.limited(2 << 30):
        refused(glb.save(tmp_path / "a.glb"), "needs about .* of memory", MemoryLimitError)
    many = Glb()
    grid = many.accessor(np.random.default_rng(0).random((30_000, 3), np.float32))
    many.mesh({"attributes": {"POSITION": grid}})
    many.nodes(*[{"mesh": 0} for _ in range(2000)])
    with memory.limited(4 << 30):
        refused(many.save(tmp_path / "a.glb"), "20,000,000 triangles in 2,000 instances needs", MemoryLimitError)


@pytest.mark.parametrize("depth", [10_000, 50_000])
def test_deep_nodes_and_deep_json(tmp_path, depth):
    glb = Glb()
    glb.mesh(glb.quad())
    glb.nodes(*[{"children": [k + 1]} for k in range(depth)], {"mesh": 0})
    assert load_asset(glb.save(tmp_path / "a.glb")).n_triangles == 2
    glb.json["nodes"][-1]["children"] = [0]
    glb.json["scenes"] = [{"nodes": [0]}]
    refused(glb.save(tmp_path / "a.glb"), "has two parents or lies on a loop")
    text = '{"asset": {"version": "2.0"}, "extras": ' + "[" * depth + "]" * depth + "}"
    refused(write(tmp_path / "a.gltf", text), "JSON cannot be read|no faces", UserError)


def usd_bomb(depth: int) -> str:
    """Every prim refers to the one before it twice."""
    text = "#usda 1.0\n" + TRIANGLE.replace('"T"', '"A0"')
    for k in range(1, depth + 1):
        inside = "".join(f'    def "{x}" (\n        references = </A{k - 1}>\n    )\n    {{\n    }}\n' for x in "xy")
        text += f'def Xform "A{k}"\n{{\n{inside}}}\n'
    return text


def test_usd_references_that_multiply(tmp_path):
    path = write(tmp_path / "a.usda", usd_bomb(30))
    with memory.limited(memory.held() + (1 << 30)):
        refused(path, "memory than the .* to open it|more than .* prims|when it opens", UserError, seconds=90)


def test_point_instancers_that_multiply(tmp_path):
    many = "[" + ", ".join(["(0, 0, 0)"] * 1000) + "]"
    zeros = "[" + ", ".join(["0"] * 1000) + "]"
    text = TRIANGLE
    for k in range(4):
        text = (
            f'def PointInstancer "I{k}"\n{{\npoint3f[] positions = {many}\nint[] protoIndices = {zeros}\n'
            f"rel prototypes = <%s/I{k}/{'T' if k == 0 else f'I{k - 1}'}>\n{text.replace('%s', f'%s/I{k}')}}}\n"
        )
    text = text.replace("%s", "")
    path = write(tmp_path / "a.usda", "#usda 1.0\n" + text)
    with memory.limited(memory.held() + (2 << 30)):
        refused(path, "point instancer 'I2' of 1,000,000,000 instances needs", MemoryLimitError, seconds=60)


def test_usdz_that_is_a_zip_bomb(tmp_path):
    """A package stores its files plainly; one that is packed is refused instead of unpacked."""
    write(tmp_path / "big.usda", b"#usda 1.0\n" + b" " * 200_000_000)
    with zipfile.ZipFile(tmp_path / "a.usdz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(tmp_path / "big.usda", "big.usda")
    (tmp_path / "big.usda").unlink()
    assert (tmp_path / "a.usdz").stat().st_size < 1e6
    refused(tmp_path / "a.usdz", "a.usdz", UserError)


def test_usdz_textures_are_bounded(tmp_path):
    write(tmp_path / "image.png", bomb(16000, 16000, zlib.compress(bytes(1000))))
    text = "#usda 1.0\n" + TRIANGLE.replace("{\n", "{\n    rel material:binding = </M>\n", 1).replace(
        'Mesh "T"\n', 'Mesh "T" (\n    prepend apiSchemas = ["MaterialBindingAPI"]\n)\n'
    )
    text += """def Material "M"
{
    token outputs:surface.connect = </M/s.outputs:surface>
    def Shader "s"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </M/t.outputs:rgb>
        token outputs:surface
    }
    def Shader "t"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./image.png@
        float3 outputs:rgb
    }
}
"""
    write(tmp_path / "a.usda", text)
    UsdUtils.CreateNewUsdzPackage(str(tmp_path / "a.usda"), str(tmp_path / "a.usdz"))
    refused(tmp_path / "a.usdz", "it is cut off: .* bytes cannot hold 16000 x 16000 pixels")


def test_mitsuba_images_and_includes_are_bounded(folders):
    inside, _ = folders
    write(inside / "image.png", bomb(16000, 16000, zlib.compress(bytes(1000))))
    bitmap = (
        '<shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="image.png"/></texture></bsdf></shape>'
    )
    refused(write(inside / "a.xml", f'<scene version="3.0.0">{bitmap}</scene>'), "cut off.*16000 x 16000")
    for k in range(10):
        body = f'<include filename="i{k + 1}.xml"/>' * 10 if k < 9 else '<shape type="sphere"/>'
        write(inside / f"i{k}.xml", f'<scene version="3.0.0">{body}</scene>')
    refused(inside / "i0.xml", "includes more than 256 files")
    write(
        inside / "big.ply",
        "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n",
    )
    mesh = '<shape type="ply"><string name="filename" value="big.ply"/></shape>'
    refused(write(inside / "a.xml", f'<scene version="3.0.0">{mesh}</scene>'), "big.ply", UserError)


def test_a_message_of_the_library_may_be_endless(tmp_path):
    """Brackets that do not close are repeated on every level of its message: found by the fuzzer."""
    write(tmp_path / "below.usda", "#usda 1.0\n" + TRIANGLE.replace("[(0, 0", "[" + "(" * 6000 + "(0, 0"))
    path = write(tmp_path / "a.usda", "#usda 1.0\n(\n    subLayers = [@./below.usda@]\n)\n" + TRIANGLE)
    refused(path, "it refers to '.*below.usda', which cannot be opened: Tuple nesting too deep", UserError)


def test_a_size_that_another_reader_sees_elsewhere(tmp_path):
    """Ours was found further down than the line that Mitsuba reads: found by the fuzzer."""
    data = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 200000000x\n\n-Y 2 +X 2\n" + bytes(100)
    with pytest.raises(AssetError, match="its header has no size"):
        decode_image(data, "a.hdr", "model.obj")


@pytest.mark.parametrize("size", [b"-Y 2 +Y 2", b"+X 2 -Y 2", b"-Y 2 -X 2"])
def test_a_size_that_another_reader_never_finds(size):
    """Mitsuba reads on behind the end of the file, into all of memory: found by the fuzzer."""
    with pytest.raises(AssetError, match="its header has no size"):
        decode_image(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + size + b"\n" + bytes(16), "a.hdr", "model.obj")


def test_special_files_are_no_models(tmp_path):
    os.mkfifo(tmp_path / "a.obj")
    refused(tmp_path / "a.obj", "is no file")
    write(tmp_path / "b.mtl", "newmtl paint\nmap_Kd pipe.png\n")
    os.mkfifo(tmp_path / "pipe.png")
    refused(write(tmp_path / "b.obj", f"mtllib b.mtl\n{OBJ}"), "texture 'pipe.png' does not exist")


def test_the_command_line_ends_in_one_line_with_code_2(folders):
    inside, _ = folders
    path = write(inside / "a.obj", f"mtllib ../secret/paint.mtl\n{OBJ}")
    command = [sys.executable, "-m", "mi_simplify", "simplify", str(path), "-o", str(inside / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1 and done.stderr.startswith("error: a.obj: material library")
    assert not (inside / "out").exists()


def test_materials_that_each_hold_one_large_texture(tmp_path):
    glb = Glb()
    texture = glb.texture(np.zeros((2048, 2048), np.uint8))
    assert len(glb.binary) < 1e5
    for _ in range(100):  # 64 MB each
        glb.material(pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
    primitive = glb.quad()
    glb.mesh(*[{**primitive, "material": k} for k in range(100)])
    with memory.limited(memory.held() + (1 << 30)):
        refused(glb.save(tmp_path / "a.glb"), "of 2048 x 2048 pixels needs about", MemoryLimitError, seconds=60)


def test_one_mesh_that_many_skins_pose(tmp_path):
    glb = Glb()
    points = glb.accessor(np.random.default_rng(0).random((100_000, 3), np.float32))
    joints, weights = glb.accessor(np.zeros((100_000, 4), np.uint8)), glb.accessor(np.ones((100_000, 4), np.float32))
    glb.mesh({"attributes": {"POSITION": points, "JOINTS_0": joints, "WEIGHTS_0": weights}})
    glb.json["skins"] = [{"joints": [0]}]
    glb.nodes({}, *[{"mesh": 0, "skin": 0} for _ in range(1000)])
    with memory.limited(memory.held() + (300 << 20)):
        refused(glb.save(tmp_path / "a.glb"), "needs about", MemoryLimitError, seconds=60)


def test_a_library_is_read_once(tmp_path):
    write(tmp_path / "a.mtl", "newmtl paint\nKd 1 0 0\n" + "# and so on\n" * 20_000)
    path = write(tmp_path / "a.obj", "mtllib a.mtl\n" * 20_000 + OBJ)
    begin = time.monotonic()
    assert load_asset(path).parts[0].material.name == "paint"
    assert time.monotonic() - begin < 10


# --- what the fuzzer found -------------------------------------------------------------------------------------------


def test_numbers_that_no_float_holds(tmp_path):
    """They are mended with a note, or refused; warnings of NumPy would fail this test."""
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 1e300 0\nvt 1 nan\nvt 1 1\nvn 1e30 0 1e30\nusemtl p\nf 1/1/1 2/2/1 3/3/1\n"
    write(tmp_path / "a.mtl", "newmtl p\nKd 1e300 1 1\nPr 1e300\nd 1e300\n")
    asset = load_asset(write(tmp_path / "a.obj", "mtllib a.mtl\n" + text))
    part = asset.parts[0]
    np.testing.assert_allclose(part.normals, [[0.5**0.5, 0, 0.5**0.5]] * 3, atol=1e-6)
    np.testing.assert_array_equal(np.sort(part.uvs, axis=0), [[0, 0], [1, 0], [1, 1]])
    assert np.isfinite(part.material.base_color).all() and "texture coordinates" in asset.notes[-1]


@pytest.mark.parametrize("index", ["nan", "1e300", "inf", "-1", "0.5e10"])
def test_indices_that_are_none(tmp_path, index):
    text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element face 1\nproperty list uchar float vertex_indices\nend_header\n0 0 0 1 0 0 0 1 0 3 0 1 "
    refused(write(tmp_path / "a.ply", text + index + "\n"), "no index|refers to vertex", UserError)


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("NORMAL", np.ones((4, 4), "f4"), r"the normals of part 'quad' have the shape \(4, 4\)"),
        ("TEXCOORD_0", np.ones((4, 3), "f4"), r"the texture coordinates of part 'quad' have the shape \(4, 3\)"),
        ("COLOR_0", np.ones((4, 2), "f4"), r"the colours of part 'quad' have the shape \(4, 2\)"),
    ],
)
def test_attributes_of_a_wrong_width(tmp_path, key, value, match):
    glb = Glb()
    glb.mesh(glb.quad(**{key: value}))
    refused(glb.save(tmp_path / "a.glb"), match, UserError)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_factors_that_are_not_finite(tmp_path, value):
    for pbr in ({"baseColorFactor": [1, value, 1, 1]}, {"roughnessFactor": value}, {"metallicFactor": value}):
        glb = Glb()
        glb.material(name="m", pbrMetallicRoughness=pbr)
        glb.mesh(glb.quad(0))
        refused(glb.save(tmp_path / "a.glb"), f"{next(iter(pbr))} of material 'm' is not finite")


def test_a_skin_that_is_not_finite(tmp_path):
    glb = Glb()
    weights = np.tile(np.float32([np.inf, 0, 0, 0]), (4, 1))
    glb.mesh(glb.quad(JOINTS_0=np.zeros((4, 4), "u1"), WEIGHTS_0=weights))
    glb.json["skins"] = [{"joints": [0]}]
    glb.nodes({}, {"mesh": 0, "skin": 0})
    refused(glb.save(tmp_path / "a.glb"), "the skin of 'node_1' is not finite", UserError)


def test_whatever_a_decoder_raises_is_one_line(monkeypatch):
    def raises(*args, **kwargs):
        raise AssertionError

    monkeypatch.setattr("PIL.Image.open", raises)
    with pytest.raises(AssetError, match="model.obj: texture 'a.png' cannot be read: AssertionError"):
        decode_image(png(corner_pixels()), "a.png", "model.obj")
