"""The check after every export: what is written shows what was fitted, and what does not is found out."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from support.models import textured_sphere

from mi_simplify import cli
from mi_simplify.export import export_model
from mi_simplify.formats import textures
from mi_simplify.formats.gltf import vertices
from mi_simplify.formats.load import load_asset
from mi_simplify.judging.self_check import LEAST_PSNR, self_check
from mi_simplify.model.model import Model


def written(model: Model, folder, formats=("glb",)):
    return [load_asset(path) for path in export_model(model, folder, formats=formats).values()]


def test_every_format_shows_the_model(tmp_path):
    model = textured_sphere()
    for asset in written(model, tmp_path, ("glb", "obj", "usd")):
        assert self_check(model, asset, resolution=96) > 55


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_gamma_and_low_roughness_survive(tmp_path, metallic):
    model = textured_sphere()
    specular = np.broadcast_to(np.float32([0.5, 0.1, metallic]), model.specular.shape)
    model = replace(model, specular=specular)
    (asset,) = written(model, tmp_path)
    assert self_check(model, asset, resolution=96) > 50


def test_opacity_survives_where_there_is_any(tmp_path):
    model = textured_sphere()
    color = model.base_color.copy()
    color[:20, ..., 3] = 0.25
    model = replace(model, base_color=color, alpha_mode="BLEND")
    (asset,) = written(model, tmp_path)
    assert self_check(model, asset, resolution=96) > 55
    (opaque,) = written(replace(model, alpha_mode="OPAQUE"), tmp_path)
    assert self_check(model, opaque, resolution=96) < LEAST_PSNR


def test_mistakes_are_found(tmp_path):
    model = textured_sphere()
    (asset,) = written(model, tmp_path)
    (part,) = asset.parts
    material, mirror = part.material, np.float32([1, -1, 1])
    mistakes = {
        "green upside down": replace(part, material=replace(material, normal=material.normal * mirror)),
        "no normal map": replace(part, material=replace(material, normal=None)),
        "images upside down": replace(part, uvs=part.uvs * np.float32([1, -1]) + np.float32([0, 1])),
        "roughness and metalness exchanged": replace(
            part, material=replace(material, specular=material.specular[..., [0, 2, 1]])
        ),
        "sRGB taken for linear": replace(part, material=replace(material, base_color=material.base_color**0.45)),
        "a tenth of the faces is missing": replace(part, faces=part.faces[len(part.faces) // 10 :]),
        "normals flipped": replace(part, normals=-part.normals),
        "moved by a hundredth of its size": replace(part, vertices=part.vertices + 0.02),
    }
    assert self_check(model, asset, resolution=96) > 55
    for what, wrong in mistakes.items():
        assert self_check(model, replace(asset, parts=(wrong,)), resolution=96) < LEAST_PSNR, what


def test_tangents_of_the_wrong_hand_are_found(tmp_path, monkeypatch):
    model, right = textured_sphere(), vertices.vertex_tangents
    monkeypatch.setattr(vertices, "vertex_tangents", lambda *args: (right(*args)[0], -right(*args)[1]))
    (asset,) = written(model, tmp_path)
    assert self_check(model, asset, resolution=96) < LEAST_PSNR


def test_a_file_that_shows_something_else_is_an_error_that_keeps_all_files(tmp_path, monkeypatch, capsys):
    trimesh.creation.icosphere(3).export(tmp_path / "ball.ply")
    monkeypatch.setattr(textures, "encode_normal", lambda n: np.full(n.shape, 200, np.uint8))
    small = ["initial.atlas_size=64", "evaluation.resolution=64", "evaluation.spp=4", "evaluation.views=2"]
    small += ["reference.spp=2", "optimizer.resolution=32", "optimizer.steps=2", "optimizer.batch=1"]
    settings = [word for text in small for word in ("--set", text)]
    out = tmp_path / "out"
    assert cli.main(["simplify", str(tmp_path / "ball.ply"), "-n", "200", "-o", str(out), "-q", *settings]) == 1
    err = capsys.readouterr().err.splitlines()
    figure = json.loads((out / "metrics.json").read_text())["run"]["self_check"]
    assert figure["file"] == "model.glb"
    expected = f"error: {out / 'model.glb'} does not show the model it was made from: {figure['psnr']:.1f} dB"
    assert err[-1].startswith(expected)
    assert (out / "model.glb").is_file() and (out / "report.html").is_file()
    low, baked = str(out / "model.obj"), tmp_path / "baked"
    assert cli.main(["bake", str(tmp_path / "ball.ply"), low, "-o", str(baked), "-q", "--atlas-size", "64"]) == 1
    assert "does not show the model it was made from" in capsys.readouterr().err
    assert (baked / "model.glb").is_file()


@pytest.mark.parametrize(("scale", "offset"), [(1e-4, 0.0), (1e4, 0.0), (1.0, 100.0)])
def test_scale_and_place_do_not_matter(tmp_path, scale, offset):
    model = textured_sphere().transformed(scale, np.full(3, offset))
    (asset,) = written(model, tmp_path)
    assert self_check(model, asset, resolution=96) > 55
