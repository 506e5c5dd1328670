"""Weights of morph targets: their sum and its derivative, found from images, written back into the file."""

import drjit as dr
import mitsuba as mi
import numpy as np
from support.tiny_models import Glb

import mi_simplify as ms
from mi_simplify.formats.gltf.file import GltfFile
from mi_simplify.latent.file_model import file_model
from mi_simplify.latent.operation import operation_of
from mi_simplify.machine.upload import upload
from mi_simplify.scenes.views import look_at


def scene(path, weights=(0.0, 0.25), more=0):
    """A pane whose corners a target each moves, placed twice; the second target has a weight already."""
    glb = Glb()
    plain = glb.material(
        name="plain", pbrMetallicRoughness={"baseColorFactor": [0.8, 0.4, 0.2, 1], "metallicFactor": 0}
    )
    primitive = glb.quad(plain)
    n = 4 + more
    up, out = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
    up[2:4, 1], out[:2, 0] = 0.8, -0.7
    primitive["targets"] = [{"POSITION": glb.accessor(up)}, {"POSITION": glb.accessor(out)}]
    glb.mesh(primitive, name="pane")
    glb.json["meshes"][0] |= {"weights": list(weights), "extras": {"targetNames": ["up", "out"]}}
    glb.nodes({"mesh": 0, "name": "a"}, {"mesh": 0, "name": "b", "translation": [2, 0, 0], "scale": [-1, 1, 1]})
    return glb.save(path)


def test_the_sum_and_its_derivative_are_those_of_numpy(tmp_path):
    asset = ms.load_asset(scene(tmp_path / "a.glb"))
    origin = file_model(asset, ["weights"])
    operation, morphs = operation_of(origin.model), origin.model.morphs
    assert morphs.names == ("up", "out") and morphs.weights == (0.0, 0.25) and origin.targets == ((0, 0), (0, 1))
    views = look_at([0, 0, 3], [0, 0, 0], [0, 0, 3], width=8, height=8)
    base = upload(mi.Float, operation.base.positions.ravel())
    weights = upload(mi.Float, np.float32([0.5, -0.3]))
    dr.enable_grad(weights)
    moved = operation.positions(base, {"weights": weights}, views)
    change = np.array([0.5, -0.3]) - morphs.weights
    first = operation.base.positions + np.tensordot(change, morphs.offsets, axes=1)
    np.testing.assert_allclose(moved.numpy().reshape(-1, 3)[: len(first)], first, atol=1e-6)
    g = np.random.default_rng(0).normal(size=dr.width(moved)).astype(np.float32)
    dr.backward(dr.sum(moved * upload(mi.Float, g)))
    g = g.reshape(2, -1, 3)  # of both places, the second mirrored
    total = g[0] + g[1] * [-1, 1, 1]
    np.testing.assert_allclose(dr.grad(weights).numpy(), np.einsum("kpi,pi->k", morphs.offsets, total), rtol=1e-4)
    written = operation.written(origin.model, {"weights": np.float32([0.5, -0.3])})
    np.testing.assert_allclose(written.mesh.positions, first, atol=1e-6)


def test_weights_are_found_and_written(tmp_path):
    true, start = scene(tmp_path / "true.glb", (0.7, -0.4)), scene(tmp_path / "start.glb")
    opt = ms.Optimization(
        start, targets=true, views=4, steps=80, resolution=32, batch=4,
        overrides=["evaluation.views=2", "reference.spp=8", "loss.laplacian.weight=0"],
    )  # fmt: skip
    opt.requires_grad(weights=0.05)
    for _ in range(80):
        opt.step()
    found = opt.save(tmp_path / "found.glb")
    (mesh,) = GltfFile(found, []).json["meshes"]
    np.testing.assert_allclose(mesh["weights"], [0.7, -0.4], atol=0.04)
    assert mesh["extras"] == {"targetNames": ["up", "out"]}
    again, asset = ms.load_asset(found), ms.load_asset(true)
    np.testing.assert_allclose(again.placed()[1].vertices, asset.placed()[1].vertices, atol=0.04)


def test_lips_that_touch_are_not_welded(tmp_path):
    """Vertices of one place that targets part are two."""
    glb = Glb()
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, -1, 0], [1, 0, 0]])
    moved = np.zeros((6, 3), np.float32)
    moved[3:, 1] = -0.5
    uvs = np.zeros((6, 2), np.float32)
    primitive = {
        "attributes": {"POSITION": glb.accessor(corners), "TEXCOORD_0": glb.accessor(uvs)},
        "indices": glb.accessor(np.arange(6, dtype=np.uint16)), "targets": [{"POSITION": glb.accessor(moved)}],
    }  # fmt: skip
    glb.mesh(primitive)
    glb.nodes({"mesh": 0})
    asset = ms.load_asset(glb.save(tmp_path / "lips.glb"))
    assert len(file_model(asset, ["positions"]).model.mesh.positions) == 4
    assert len(file_model(asset, ["weights"]).model.mesh.positions) == 6


def test_mistakes_are_one_line(tmp_path, rejected):
    glb = Glb()
    glb.mesh(glb.quad())
    glb.nodes({"mesh": 0})
    plain = glb.save(tmp_path / "plain.glb")
    line = rejected("fit", plain, "--to", plain, "--optimize", "weights", "-o", "out")
    assert "'weights': no mesh of plain has morph targets" in line
    odd = scene(tmp_path / "odd.glb", more=1)
    line = rejected("fit", odd, "--to", odd, "--optimize", "weights", "-o", "out")
    assert "of morph target 1 has 5 rows for 4 vertices" in line
