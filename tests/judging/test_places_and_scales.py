"""Any unit and any place: pictures and exported files of a model do not depend on them."""

from dataclasses import replace

import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.export import export_model
from mi_simplify.formats.load import load_asset
from mi_simplify.judging.evaluate import Judging, compare_assets
from mi_simplify.judging.self_check import self_check
from mi_simplify.model.asset import Asset, Instance, Part
from mi_simplify.model.model import Model
from mi_simplify.report.portrait import render_picture

SPHERE = charted_sphere(8)
HERE = np.zeros(3)
UTM = np.array([512_345.678, 5_412_345.678, 123.4])


def ball(scale: float, offset: np.ndarray = HERE) -> Asset:
    return Asset((Part(SPHERE.vertices * scale + offset, SPHERE.faces),), (Instance(0),), name="ball")


@pytest.mark.parametrize(("scale", "offset"), [(1e9, HERE), (1e-9, HERE), (5.0, UTM)])
def test_pictures_do_not_depend_on_unit_and_place(scale, offset):
    expected = render_picture(ball(1.0), resolution=32, spp=4)
    assert expected[..., :3].max() > 0.1
    np.testing.assert_allclose(render_picture(ball(scale, offset), resolution=32, spp=4), expected, atol=2e-2)
    judging = Judging(n_views=1, resolution=32, spp=4)
    here, there = (compare_assets(a, {"same": a}, judging) for a in (ball(1.0), ball(scale, offset)))
    np.testing.assert_allclose(there.reference, here.reference, atol=2e-2)
    assert there.figures["candidates"]["same"]["silhouette_error"] < 0.01


def model_at(offset: np.ndarray) -> Model:
    flat = np.broadcast_to(np.float32([0, 0, 1]), (4, 4, 3))
    mesh = replace(SPHERE, positions=SPHERE.positions * 5 + offset)
    color = np.broadcast_to(np.float32([0.5, 0.4, 0.3, 1]), (4, 4, 4))
    return Model(mesh, color, np.full((4, 4, 3), 0.5, np.float32), flat, name="far")


def test_files_of_what_lies_far_from_the_origin_keep_their_digits(tmp_path):
    model = model_at(UTM)
    files = export_model(model, tmp_path, formats=["glb", "obj", "usd"])
    expected = model.mesh.vertices[model.mesh.faces].mean(1)
    for path in files.values():
        asset = load_asset(path)
        (part,) = asset.placed()
        found = part.vertices[part.faces].mean(1)
        order, wanted = np.lexsort(found.round(3).T), np.lexsort(expected.round(3).T)
        np.testing.assert_allclose(found[order], expected[wanted], atol=2e-6)  # 10 m: 1e-6 m is float32's
        if path.suffix != ".obj":  # the stored numbers are small, which is what other programs see
            assert np.abs(asset.parts[0].vertices).max() < 12
    lines = files["obj"].read_text().splitlines()
    assert lines[1].startswith("# origin: 51234")
    assert max(abs(float(x)) for line in lines if line.startswith("v ") for x in line.split()[1:]) < 12
    assert self_check(model, load_asset(files["glb"])) > 45


def test_files_of_what_stands_near_the_origin_are_as_before(tmp_path):
    files = export_model(model_at(np.array([20.0, 0, 0])), tmp_path, formats=["glb", "obj"])
    assert "origin" not in files["obj"].read_text()
    np.testing.assert_array_equal(load_asset(files["glb"]).instances[0].to_world, np.eye(4))
