"""A glTF file fitted in place: what is named changes and looks like the target, what is not stays to the bit."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.tiny_models import QUAD, Glb, corner_pixels

import mi_simplify as ms
from mi_simplify import cli
from mi_simplify.export.in_place import write_in_place
from mi_simplify.formats.captured.write import write_captured
from mi_simplify.formats.gltf.file import GltfFile
from mi_simplify.formats.gltf.stage.cameras import read_stage
from mi_simplify.latent.file_model import file_model
from mi_simplify.model.frame import Frame
from mi_simplify.scenes.views import look_at

SMALL = {"steps": 40, "resolution": 32, "batch": 2, "texture_size": 8}
QUICK = ["evaluation.views=2", "reference.spp=4"]
TURNED = [0.0, 0.3826834, 0.0, 0.9238795]


def scene(path, color=(0.8, 0.8, 0.8, 1.0), shift=0.0):
    """Two materials, one of them a texture that repeats, and a mesh that two nodes place, one of them mirrored."""
    glb = Glb()
    textured = glb.material(
        name="paint",
        pbrMetallicRoughness={"baseColorTexture": {"index": glb.texture(corner_pixels())}, "metallicFactor": 0},
    )
    plain = glb.material(name="plain", pbrMetallicRoughness={"baseColorFactor": list(color), "metallicFactor": 0})
    glb.mesh(glb.quad(textured), name="panel")
    glb.mesh(glb.quad(plain), name="blank")
    glb.nodes(
        {"mesh": 0, "name": "left", "translation": [0, 0, 0]},
        {"mesh": 1, "name": "middle", "translation": [1.2 + shift, 0, 0], "rotation": TURNED},
        {"mesh": 0, "name": "right", "translation": [2.4, 0, 0], "scale": [-1, 1, 1]},
        {"camera": 0, "name": "eye", "translation": [1, 0.5, 4]},
        {"name": "lamp", "translation": [1, 3, 4], "extensions": {"KHR_lights_punctual": {"light": 0}}},
    )
    glb.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1, "aspectRatio": 1.0}}]
    light = {"type": "point", "intensity": 60.0, "color": [1, 1, 1]}
    glb.json["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    glb.json["extensionsUsed"] = ["KHR_lights_punctual"]
    return glb.save(path)


@pytest.fixture
def file(tmp_path):
    return scene(tmp_path / "scene.glb")


def without(path, *kinds):
    """The JSON of a file without what a changed array or image changes."""
    json_ = GltfFile(Path(path), []).json
    return {k: v for k, v in json_.items() if k not in ("buffers", "bufferViews", "accessors", "images", *kinds)}


def test_nothing_fitted_is_the_file_itself(file, tmp_path):
    asset = ms.load_asset(file)
    frame = Frame.around(asset.bounds)
    origin = file_model(frame.normalised(asset), ["vertices", "base_color", "roughness", "normal"])
    names = ["vertices", "base_color", "roughness", "normal"]
    again = ms.load_asset(write_in_place(file, tmp_path / "again.glb", origin, origin.model, names))
    for a, b in zip(asset.parts, again.parts, strict=True):
        np.testing.assert_array_equal(a.faces, b.faces)
        np.testing.assert_array_equal(a.uvs, b.uvs)
        np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-6)
        size = b.material.base_color.shape
        expected = (
            np.broadcast_to(a.material.base_color, size) if a.material.base_color.size == 4 else a.material.base_color
        )
        np.testing.assert_allclose(b.material.base_color[..., :3], expected[..., :3], atol=5e-3)
    assert [i.name for i in asset.instances] == [i.name for i in again.instances]
    kept = without(file, "textures", "materials", "meshes", "extensionsUsed")
    assert {k: v for k, v in without(tmp_path / "again.glb").items() if k in kept} == kept


def test_what_is_not_named_stays_to_the_bit(file, tmp_path):
    asset = ms.load_asset(file)
    origin = file_model(Frame.around(asset.bounds).normalised(asset), ["vertices"])
    moved = ms.Model.transformed(origin.model, 1.0, np.array([0.0, 0.1, 0.0]))
    write_in_place(file, tmp_path / "moved.glb", origin, moved, ["vertices"])
    assert without(tmp_path / "moved.glb", "meshes") == without(file, "meshes")
    again = ms.load_asset(tmp_path / "moved.glb")
    for a, b in zip(asset.parts, again.parts, strict=True):
        assert a.material.base_color.tobytes() == b.material.base_color.tobytes()
        assert np.abs(b.vertices - a.vertices).max() > 0.01
    centre = asset.bounds.mean(0), again.bounds.mean(0)
    np.testing.assert_allclose(centre[1] - centre[0], [0, 0.1 / Frame.around(asset.bounds).scale, 0], atol=1e-5)


def test_several_materials_and_places_look_as_the_asset_does(file):
    """The start is the asset itself, in the file's own light: where they differ is the noise of edges."""
    opt = ms.Optimization(file, targets=file, views=2, overrides=[*QUICK, "reference.spp=64"], **SMALL)
    opt.requires_grad("base_color")
    _, psnr = opt.run.fit.judge()
    assert opt.run.fit.latent.textures.cells is not None
    assert len(opt.run.fit.latent.operation.mesh.faces) == 6 and len(opt.run.first_guess.mesh.faces) == 4
    assert psnr > 35


def test_a_colour_is_found_from_one_image_by_the_files_camera(file, tmp_path):
    target = scene(tmp_path / "target.glb", color=(0.1, 0.5, 0.2, 1.0))
    cameras, lights, _ = read_stage(target, ms.load_asset(target).bounds)
    assert [c.name for c in cameras] == ["eye"] and lights[0].intensity[0] == 60
    asset = ms.load_asset(target)
    fov = np.degrees(cameras[0].yfov)
    views = look_at([1, 0.5, 4], [1, 0.5, 0], [1, 3, 4], width=32, height=32, fov=fov).lit_by_point([1, 3, 4], [60] * 3)
    images = ms.make_reference(asset, spp=64).render(views)
    write_captured(tmp_path / "shots", views.arrays(), images, format="png", light="unlit")
    picture = next((tmp_path / "shots" / "images").iterdir())
    opt = ms.Optimization(file, targets=picture, overrides=QUICK, **{**SMALL, "texture_size": 1, "batch": 1})
    opt.requires_grad(base_color=0.05)
    assert opt.config.optimizer.resolution == (32,) and opt.target.n_views == 1
    before = opt.run.fit.judge()[0]
    for _ in range(40):
        opt.step()
    found = ms.load_asset(opt.save(tmp_path / "found.glb"))
    assert opt.run.fit.judge()[0] < 0.5 * before
    plain = next(part.material for part in found.parts if part.name == "blank")
    np.testing.assert_allclose(plain.base_color[0, 0, :3], [0.1, 0.5, 0.2], atol=0.03)


def test_the_command_goes_from_a_displaced_start_to_its_target(tmp_path, capsys):
    target, start = scene(tmp_path / "target.glb"), scene(tmp_path / "start.glb", shift=0.15)
    out = tmp_path / "out"
    command = [
        "fit",
        start,
        "--to",
        target,
        "--optimize",
        "positions=0.02",
        "-o",
        str(out),
        "--steps",
        "40",
        "--views",
        "4",
    ]
    options = ["--resolution", "32", "--batch", "4", *(x for key in QUICK for x in ("--set", key))]
    assert cli.main([*command, *options]) == 0
    figures = json.loads((out / "metrics.json").read_text())
    candidates = figures["candidates"]
    assert candidates["result"]["loss"] < 0.4 * candidates["start"]["loss"]
    assert candidates["result"]["psnr"] > candidates["start"]["psnr"] and "normal_dissimilarity" not in figures
    expected = {
        "config.yaml",
        "contact_sheet.png",
        "log.jsonl",
        "metrics.json",
        "model.glb",
        "report.html",
        "views.npz",
    }
    assert {path.name for path in out.iterdir()} - {"preview.png"} == expected
    assert 'id="report-data"' in (out / "report.html").read_text()
    assert "PSNR" in capsys.readouterr().out
    assert without(out / "model.glb", "meshes") == without(start, "meshes")


def bumpy(path, normal):
    """A panel whose normal map has one texel in each quarter, and nothing else that varies."""
    glb = Glb()
    texture = glb.texture(np.uint8(np.round(127.5 + 127.5 * normal)))
    material = glb.material(
        name="relief", normalTexture={"index": texture}, pbrMetallicRoughness={"metallicFactor": 0.0}
    )
    positions = glb.accessor(QUAD.astype("f4"), min=[0, 0, 0], max=[1, 1, 0])
    glb.mesh(glb.quad(material, POSITION=positions), name="panel")
    glb.nodes({"mesh": 0, "name": "panel"})
    return glb.save(path)


def test_a_normal_map_from_nothing_has_its_figure_and_curve(tmp_path, node_run):
    normal = np.zeros((8, 8, 3))
    normal[..., 2] = 1
    normal[:4, :, 0], normal[4:, 4:, 1] = 0.5, -0.4
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    flat = np.zeros_like(normal) + [0, 0, 1]
    truth, start = bumpy(tmp_path / "truth.glb", normal), bumpy(tmp_path / "start.glb", flat)
    out = tmp_path / "out"
    command = ["fit", start, "--to", truth, "--optimize", "normal=0.05", "-o", str(out), "--steps", "50"]
    options = ["--resolution", "32", "--batch", "4", *(x for key in QUICK for x in ("--set", key))]
    assert cli.main([*command, *options]) == 0
    figures = json.loads((out / "metrics.json").read_text())["candidates"]
    before, after = (figures[name]["normal_dissimilarity"] for name in ("start", "result"))
    cosines = normal[np.abs(normal[..., :2]).sum(2) > 0][:, 2]
    assert before == pytest.approx(1 - cosines.mean(), abs=2e-3)  # of 8 bits, without the flat quarter
    assert after < 0.1 * before
    log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    curve = [row["normal_dissimilarity"] for row in log if "normal_dissimilarity" in row]
    assert len(curve) == 2 and curve[-1] < curve[0] < before
    assert 'data-curve="normal_dissimilarity"' in (out / "report.html").read_text()
    script = "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(0)))"
    script += ".then(r => console.log(JSON.stringify(r.issues)))"
    issues = json.loads(node_run("gltf-validator", script, (out / "model.glb").read_bytes()))
    assert issues["numErrors"] == 0


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--optimize", "positons"], "'positons' is no parameter, did you mean 'positions'?; known are positions"),
        (["--optimize", "normal=fast"], "'normal=fast': a rate is a number"),
        (["--optimize", "opacity"], "no material of scene is transparent"),
        (["--optimize", "positions", "--to", "shot.png", "--camera", "roof"], "no camera 'roof'; its cameras are eye"),
        (["--optimize", "positions", "--to", "none.json"], "the image set 'none.json' does not exist"),
        (["--optimize", "positions", "--to", "wide.png"], "has 16 × 8 pixels, but the camera an aspect ratio of 1"),
        (["--optimize", "positions", "--set", "optimizer.stepz=3"], "optimizer.stepz"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(file, tmp_path, rejected, arguments, line):
    from PIL import Image

    Image.new("RGBA", (8, 8)).save(tmp_path / "shot.png")
    Image.new("RGBA", (16, 8)).save(tmp_path / "wide.png")
    to = [] if "--to" in arguments else ["--to", file]
    assert line in rejected("fit", file, *to, *arguments, "-o", "out")


def test_only_gltf_is_fitted_in_place(tmp_path, rejected):
    assert "a GLB or glTF file" in rejected("fit", "cow.obj", "--to", "cow.obj", "--optimize", "positions")
