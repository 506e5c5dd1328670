"""Hostile files: none reads outside its folder or runs code; each ends in one clear line."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.hostile import OBJ, OUTSIDE, TRIANGLE, refused, with_secret, write
from support.tiny_models import Glb, corner_pixels

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import AssetError, ConfigError, UserError
from mi_simplify.formats.images import decode_image
from mi_simplify.formats.load import load_asset


@pytest.fixture
def folders(tmp_path):
    """A folder for the model, and one beside it with what it must not see."""
    return with_secret(tmp_path)


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
        with pytest.raises(ConfigError) as error:  # 9¹² strings would end in the time limit
            load_config(write(tmp_path / "job.yaml", text))
        assert len(str(error.value)) < 1000


def test_nothing_here_unpickles_or_evaluates():
    package = Path(cli.__file__).parents[1]
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


def test_a_mitsuba_image_without_a_file(tmp_path):
    """Mitsuba reads through a null pointer then: found by the fuzzer."""
    bitmap = '<bsdf type="diffuse"><texture type="bitmap" name="reflectance"/></bsdf>'
    path = write(tmp_path / "a.xml", f'<scene version="3.0.0"><shape type="sphere">{bitmap}</shape></scene>')
    refused(path, "a 'bitmap' names no image; give it a")
