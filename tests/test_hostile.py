"""Hostile files: none reads outside its folder, runs code, or fills the memory; each ends in one clear line."""

import json
import os
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from pxr import UsdUtils
from tiny_models import Glb, corner_pixels, png

from mi_simplify import cli, memory
from mi_simplify.config import load_config
from mi_simplify.errors import AssetError, ConfigError, MemoryLimitError, UserError
from mi_simplify.scenes.images import decode_image
from mi_simplify.scenes.load import load_asset

OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nusemtl paint\nf 1/1 2/2 3/3\n"
OUTSIDE = "outside the model's folder.*MI_SIMPLIFY_ASSET_ROOT"


@pytest.fixture
def folders(tmp_path):
    """A folder for the model, and one beside it with what it must not see."""
    inside, secret = tmp_path / "model", tmp_path / "secret"
    (inside / "x").mkdir(parents=True)
    secret.mkdir()
    (secret / "image.png").write_bytes(png(corner_pixels()))
    (secret / "paint.mtl").write_text("newmtl paint\nKd 1 0 0\n")
    (secret / "buffer.bin").write_bytes(bytes(64))
    (secret / "quad.usda").write_text('#usda 1.0\ndef Mesh "S"\n{\n}\n')
    (secret / "shape.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    (secret / "reflectance.spd").write_text("400 0.1\n700 0.2\n")
    (secret / "triangle.obj").write_text(OBJ)
    return inside, secret


def refused(path, match: str, error: type[UserError] = AssetError, seconds: float = 20.0) -> str:
    """The one line that a file ends with."""
    begin = time.monotonic()
    with pytest.raises(error, match=match) as caught:
        load_asset(path)
    assert time.monotonic() - begin < seconds
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
    return str(caught.value)


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


# --- files elsewhere -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["../secret/{}", "{secret}/{}", "..\\secret\\{}", "x/../../secret/{}"])
@pytest.mark.parametrize("what", ["image.png", "paint.mtl"])
def test_obj(folders, form, what):
    inside, secret = folders
    name = form.replace("{secret}", str(secret)).format(what)
    if what == "image.png":
        write(inside / "a.mtl", f"newmtl paint\nmap_Kd {name}\n")
        name = "a.mtl"
    line = refused(write(inside / "a.obj", f"mtllib {name}\n{OBJ}"), OUTSIDE)
    assert line.startswith("a.obj: ") and what in line


def test_a_link_does_not_lead_out(folders):
    inside, secret = folders
    (inside / "image.png").symlink_to(secret / "image.png")
    write(inside / "a.mtl", "newmtl paint\nmap_Kd image.png\n")
    refused(write(inside / "a.obj", f"mtllib a.mtl\n{OBJ}"), OUTSIDE)


def test_the_person_may_widen_the_folder(folders, monkeypatch):
    inside, secret = folders
    write(inside / "a.mtl", "newmtl paint\nmap_Kd ../secret/image.png\n")
    path = write(inside / "a.obj", f"mtllib a.mtl\n{OBJ}")
    monkeypatch.setenv("MI_SIMPLIFY_ASSET_ROOT", str(inside.parent))
    assert load_asset(path).parts[0].material.base_color.shape == (8, 8, 4)


def test_ply_texture(folders):
    header = "ply\nformat ascii 1.0\ncomment TextureFile ../secret/image.png\nelement vertex 3\n"
    header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t"))
    text = header + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    refused(write(folders[0] / "a.ply", text + "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"), OUTSIDE)


@pytest.mark.parametrize("kind", ["buffers", "images"])
@pytest.mark.parametrize("form", ["../secret/{}", "%2e%2e/secret/{}", "{secret}/{}"])
def test_gltf(folders, kind, form):
    inside, secret = folders
    glb = Glb()
    glb.material(pbrMetallicRoughness={"baseColorTexture": {"index": glb.texture(corner_pixels())}})
    glb.mesh(glb.quad(0))
    write(inside / "buffer.bin", glb.binary)
    glb.json["buffers"] = [{"byteLength": len(glb.binary), "uri": "buffer.bin"}]
    name = {"buffers": "buffer.bin", "images": "image.png"}[kind]
    glb.json[kind] = [{**glb.json[kind][0], "uri": form.replace("{secret}", str(secret)).format(name)}]
    glb.json[kind][0].pop("bufferView", None)
    path = write(inside / "a.gltf", json.dumps(glb.json))
    if kind == "buffers":
        (inside / "buffer.bin").unlink()  # one of that name beside the model would be taken
    refused(path, OUTSIDE)


def test_gltf_takes_no_address(folders):
    glb = Glb()
    glb.mesh(glb.quad())
    for uri in ("http://example.com/a.bin", f"file://{folders[1]}/buffer.bin"):
        glb.json["buffers"] = [{"byteLength": 64, "uri": uri}]
        refused(write(folders[0] / "a.gltf", json.dumps(glb.json)), "is not a file; download it")


TRIANGLE = """def Mesh "T"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
}
"""

USDA = {
    "sublayer": '#usda 1.0\n(\n    subLayers = [@../secret/quad.usda@]\n)\n{}',
    "absolute sublayer": '#usda 1.0\n(\n    subLayers = [@{secret}/quad.usda@]\n)\n{}',
    "reference": '#usda 1.0\n{}def "R" (\n    references = @../secret/quad.usda@</S>\n)\n{\n}\n',
    "payload": '#usda 1.0\n{}def "R" (\n    payload = @../secret/quad.usda@</S>\n)\n{\n}\n',
    "in a variant": '#usda 1.0\n{}def "R" (\n    variantSets = "v"\n    variants = {\n        string v = "a"\n'
    "    }\n)\n"
    '{\n    variantSet "v" = {\n        "a" (\n            references = @../secret/quad.usda@</S>\n        ) {\n'
    "        }\n    }\n}\n",
    "in a layer below": '#usda 1.0\n(\n    subLayers = [@./below.usda@]\n)\n{}',
    "clip": '#usda 1.0\n{}def "R" (\n    clips = {\n        dictionary default = {\n'
    "            string templateAssetPath = \"../secret/t.###.usda\"\n        }\n    }\n)\n{\n}\n",
    "texture": '#usda 1.0\n{}def "R"\n{\n    asset inputs:file = @../secret/image.png@\n}\n',
}  # fmt: skip


@pytest.mark.parametrize("kind", USDA)
def test_usd(folders, kind):
    inside, secret = folders
    below = "#usda 1.0\n(\n    subLayers = [@../secret/quad.usda@]\n)\n"
    write(inside / "below.usda", below)
    text = USDA[kind].replace("{secret}", str(secret)).replace("{}", TRIANGLE)
    refused(write(inside / "a.usda", text), OUTSIDE)


def test_usd_takes_no_expression(folders):
    text = '#usda 1.0\n(\n    expressionVariables = {\n        string X = "../secret"\n    }\n)\n' + TRIANGLE
    text += 'def "R" (\n    references = @`"${X}/quad.usda"`@</S>\n)\n{\n}\n'
    refused(write(folders[0] / "a.usda", text), f"by the expression|{OUTSIDE}")


XML = {
    "include": '<include filename="../secret/shape.xml"/>',
    "include by a parameter": '<default name="f" value="../secret/shape.xml"/><include filename="$f"/>',
    "spectrum": '<shape type="sphere"><bsdf type="diffuse">'
    '<spectrum name="reflectance" filename="../secret/reflectance.spd"/></bsdf></shape>',
    "bitmap": '<shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="../secret/image.png"/></texture></bsdf></shape>',
    "mesh": '<shape type="obj"><string name="filename" value="{secret}/triangle.obj"/></shape>',
    "path": '<path value="../secret"/><shape type="obj"><string name="filename" value="triangle.obj"/></shape>',
}


@pytest.mark.parametrize("kind", XML)
def test_mitsuba(folders, kind):
    inside, secret = folders
    text = f'<scene version="3.0.0">{XML[kind].replace("{secret}", str(secret))}</scene>'
    match = "holds a parameter" if "parameter" in kind else "outside the model's folder|does not exist|not found"
    refused(write(inside / "a.xml", text), match)


# --- code ------------------------------------------------------------------------------------------------------------


def test_mitsuba_loads_no_library_from_beside_the_scene(folders):
    """Mitsuba itself loads ``plugins/NAME.so`` from the scene's folder; this file would not even have to be one."""
    inside, _ = folders
    (inside / "plugins").mkdir()
    write(inside / "plugins/evil.so", b"\x7fELF")
    text = '<scene version="3.0.0"><shape type="sphere"><bsdf type="evil"/></shape></scene>'
    refused(write(inside / "a.xml", text), "plugin 'evil' would be loaded from .*only Mitsuba's own are")


@pytest.mark.parametrize(
    "value",
    ["!!python/object/apply:os.system ['touch {}']", "!!python/name:os.system", "!!python/object/new:os.system [x]"],
)
def test_yaml_builds_no_objects(tmp_path, value):
    mark = tmp_path / "mark"
    path = write(tmp_path / "job.yaml", f"asset: {value.format(mark)}\n")
    with pytest.raises(ConfigError, match="not valid YAML: could not determine a constructor"):
        load_config(path)
    assert not mark.exists()


def test_yaml_does_not_multiply(tmp_path):
    for text in ("preset: " + "x" * 5000, f"asset: *{'x' * 5000}", f"{'x' * 5000}: 1\n" * 2, f"asset: !{'x' * 5000} 1"):
        with pytest.raises(ConfigError) as error:
            load_config(write(tmp_path / "job.yaml", text))
        assert len(str(error.value)) < 600
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    for text in ("\n".join(lines), "a: " + "[" * 5000, "a: " + "{a: " * 3000):
        begin = time.monotonic()
        with pytest.raises(ConfigError) as error:
            load_config(write(tmp_path / "job.yaml", text))
        assert time.monotonic() - begin < 10 and len(str(error.value)) < 1000


def test_nothing_here_unpickles_or_evaluates():
    package = Path(cli.__file__).parent
    for path in package.rglob("*.py"):
        text = path.read_text()
        words = ("import pickle", "allow_pickle=True", " = eval(", " exec(", "yaml.unsafe", "yaml.full", "shell=True")
        for word in words:
            assert word not in text, f"{path.name}: {word}"


def test_images_are_handed_to_no_other_program():
    """Pillow gives EPS to Ghostscript, whatever the file is called."""
    eps = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n"
    with pytest.raises(AssetError, match="'a.png' cannot be read: it is no image"):
        decode_image(eps, "a.png", "model.obj")


def test_a_message_holds_no_control_characters(tmp_path):
    glb = Glb()
    glb.mesh({**glb.quad(), "indices": glb.accessor(np.uint16([0, 1, 99]))}, name="a\x1b[2J\nb" + "c" * 5000)
    line = refused(glb.save(tmp_path / "a.glb"), "refers to vertex|c{50}", UserError)
    assert line.isprintable()


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
    bitmap = XML["bitmap"].replace("../secret/", "")
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
