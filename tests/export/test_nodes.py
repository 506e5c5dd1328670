"""Kept nodes, from file to file: names, hierarchy, transforms, animation, instances."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from support.tiny_meshes import charted_sphere
from support.tiny_models import Glb

from mi_simplify.config import load_config
from mi_simplify.errors import ConfigError
from mi_simplify.export import export_model
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.guess import first_guess
from mi_simplify.initial.nodes import kept_nodes
from mi_simplify.judging.self_check import self_check
from mi_simplify.model.nodes.placing import expanded
from mi_simplify.model.rig import BIND_POSE
from mi_simplify.record.checkpoint import Checkpoint
from mi_simplify.subjects import open_subject

HALF = 0.5**0.5
SMALL = ["initial.triangles=200", "initial.atlas_size=64"]


def ball(glb: Glb, name: str, **more) -> int:
    mesh = charted_sphere(4)
    primitive = {
        "attributes": {
            "POSITION": glb.accessor(np.float32(mesh.vertices)),
            "TEXCOORD_0": glb.accessor(np.float32(mesh.uvs)),
        },
        "indices": glb.accessor(mesh.faces.ravel().astype("u2")),
        **more,
    }
    return glb.mesh(primitive, name=name)


def cart(moves: bool) -> Glb:
    """A body, four wheels of one mesh below two axles (one mirrored, one squeezed), an empty hook."""
    glb = Glb()
    body, wheel = ball(glb, "body"), ball(glb, "wheel")
    glb.nodes(
        {"name": "cart", "children": [1, 2, 5, 8]},
        {"name": "body", "mesh": body, "scale": [2, 1, 1]},
        {"name": "front", "translation": [3, -1, 0], "children": [3, 4]},
        {"name": "wheel", "mesh": wheel, "translation": [0, 0, 2], "scale": [0.5, 0.5, 0.5]},
        {"name": "wheel", "mesh": wheel, "translation": [0, 0, -2], "scale": [0.5, 0.5, -0.5]},
        {"name": "back", "translation": [-3, -1, 0], "rotation": [0, 0, HALF, HALF], "children": [6, 7]},
        {"name": "wheel", "mesh": wheel, "translation": [0, 0, 2], "scale": [0.5, 0.5, 0.25]},
        {"mesh": wheel, "translation": [0, 0, -2], "scale": [0.5, 0.5, 0.5]},
        {"name": "hook", "translation": [-4, 0, 0]},
    )
    if moves:
        time = glb.accessor(np.float32([0, 1 / 24, 2 / 24]), min=[0], max=[2 / 24])
        turn = glb.accessor(np.float32([[0, 0, 0, 1], [0, 0, HALF, HALF], [0, 0, 1, 0]]))
        glb.json["animations"] = [
            {"name": "drive", "samplers": [{"input": time, "output": turn}],
             "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}]}
        ]  # fmt: skip
    return glb


def document(path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


def simplified(glb: Glb, folder, *settings):
    """The subject of a file, its first guess in the units of the file, and the GLB file of that."""
    subject = open_subject(load_config(None, [{"asset": glb.save(folder / "in.glb")}, *SMALL, *settings]))
    model = subject.frame.restored(subject.guess()[0])
    return subject, model, export_model(model, folder, formats=["glb"])["glb"]


def paths(nodes: list[dict], names: bool = True) -> list:
    """Names of the nodes from the root on, as far as they are named."""
    above = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}

    def path(k: int) -> str:
        return (path(above[k]) + "/" if k in above else "") + nodes[k].get("name", "?")

    return sorted(path(k) for k in range(len(nodes)))


def far(a: np.ndarray, b: np.ndarray) -> float:
    """How far a point of one surface's vertices is from the closest vertex of the other, at most."""
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min(1).max())


def corners(asset, time: int = BIND_POSE) -> np.ndarray:
    """Sorted corners of all triangles, to the fourth digit."""
    placed = asset.posed(time).placed()
    rows = np.concatenate([part.vertices[part.faces].reshape(-1, 3) for part in placed])
    return np.unique(np.round(rows, 4) + 0.0, axis=0)


def test_all_nodes_come_back(tmp_path):
    subject, model, path = simplified(cart(False), tmp_path, "initial.keep_nodes=all")
    there, back = cart(False).json["nodes"], document(path)["nodes"]
    assert paths(back) == paths(there)
    for before, after in zip(there, back, strict=True):
        for key, plain in (("translation", [0, 0, 0]), ("rotation", [0, 0, 0, 1])):
            np.testing.assert_allclose(after.get(key, plain), before.get(key, plain), atol=1e-6)
    # Instances are simplified once, and still count in the budget.
    assert [len({n["mesh"] for n in back if n.get("name") == "wheel"}), len(document(path)["meshes"])] == [1, 2]
    written = load_asset(path)
    assert written.n_triangles == model.n_triangles <= 200 and len(model.mesh.faces) < 130
    assert model.n_triangles > 180
    assert far(np.concatenate([p.vertices for p in written.placed()]), corners(subject.geometry)) < 0.5
    assert self_check(model, written, resolution=64) > 50


def test_what_moves_stays_a_node_and_the_rest_is_one_mesh(tmp_path, node_run):
    subject, model, path = simplified(cart(True), tmp_path)
    told = document(path)
    assert sorted(node["name"] for node in told["nodes"]) == ["front", "in"] and "skins" not in told
    (clip,) = told["animations"]
    assert clip["name"] == "drive"
    assert [told["nodes"][c["target"]["node"]]["name"] for c in clip["channels"]] == ["front"]
    written = load_asset(path)
    for frame in range(3):
        want, have = corners(subject.geometry, frame), corners(written, frame)
        np.testing.assert_allclose(have.min(0), want.min(0), atol=0.1)
        np.testing.assert_allclose(have.max(0), want.max(0), atol=0.1)
    assert self_check(model, written, resolution=64) > 50
    script = "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(0)))"
    issues = json.loads(
        node_run("gltf-validator", script + ".then(r => console.log(JSON.stringify(r.issues)))", path.read_bytes())
    )
    assert issues["numErrors"] == 0 and issues["numWarnings"] == 0, issues["messages"]


def test_other_formats_have_every_instance(tmp_path):
    _, model, path = simplified(cart(True), tmp_path, "initial.keep_nodes=all")
    want = corners(load_asset(path))
    for form, file in export_model(model, tmp_path, formats=["obj", "usd"]).items():
        have = corners(load_asset(file))
        assert max(far(have, want), far(want, have)) < 1e-3, form
    whole = expanded(model)
    assert whole.nodes is None and len(whole.mesh.faces) == model.n_triangles
    assert far(whole.mesh.positions, want) < 1e-3
    assert set(np.unique(whole.skin.weights)) == {0, 1}


def test_rounded_positions_and_far_places(tmp_path):
    glb = cart(False)
    glb.json["nodes"][0]["translation"] = [5e5, 0, 4e6]
    subject, model, path = simplified(glb, tmp_path, "initial.keep_nodes=all")
    want = load_asset(path)
    assert document(path)["nodes"][0]["translation"] == [5e5, 0, 4e6]
    assert far(corners(want) - [5e5, 0, 4e6], corners(subject.geometry) - [5e5, 0, 4e6]) < 0.5
    (tmp_path / "packed").mkdir()
    packed = export_model(
        model,
        tmp_path / "packed",
        formats=["glb"],
        glb=subject.config.export.glb.model_copy(update={"compress": "meshopt"}),
    )["glb"]
    assert {"cart", "body", "front", "back", "hook"} <= {node.get("name") for node in document(packed)["nodes"]}
    assert far(corners(load_asset(packed)) - [5e5, 0, 4e6], corners(want) - [5e5, 0, 4e6]) < 2e-3


def test_morph_targets_stay_with_their_node(tmp_path):
    glb = Glb()
    grow = [{"POSITION": glb.accessor(np.float32(charted_sphere(4).vertices))}]
    head, body = ball(glb, "head", targets=grow), ball(glb, "body")
    glb.json["meshes"][head] |= {"weights": [0.25], "extras": {"targetNames": ["grow"]}}
    glb.nodes({"name": "head", "mesh": head, "translation": [0, 3, 0]}, {"name": "body", "mesh": body})
    _, _, path = simplified(glb, tmp_path, "initial.keep_nodes=all")
    with_target, without = sorted(document(path)["meshes"], key=lambda mesh: mesh["name"], reverse=True)
    assert with_target["extras"]["targetNames"] == ["grow"] and with_target["weights"] == [0.25]
    assert "weights" not in without and "targets" not in without["primitives"][0]
    (part,) = [part for part in load_asset(path).parts if part.morphs]
    length = np.linalg.norm(part.vertices, axis=1)
    np.testing.assert_allclose(np.linalg.norm(part.morphs[0].offsets, axis=1) * 1.25, length, rtol=0.05)


def test_named_nodes(tmp_path, rejected):
    _, _, path = simplified(cart(False), tmp_path, {"initial": {"keep": ["hook", "back"]}})
    assert sorted(n["name"] for n in document(path)["nodes"]) == ["back", "hook", "in"]
    with pytest.raises(ConfigError, match="no node 'hok', did you mean 'hook'"):
        simplified(cart(False), tmp_path, {"initial": {"keep": ["hok"]}})
    with pytest.raises(ConfigError, match="keep_nodes"):
        load_config(None, [{"asset": "a.glb"}, "initial.keep_nodes=all", "initial.kind=sphere"])
    assert "no nodes to keep" in rejected("simplify", "sample:relic", "--keep-nodes", "-n", "100")


def test_instances_that_touch_do_not_grow_together(tmp_path):
    glb = Glb()
    mesh = ball(glb, "ball")
    glb.nodes({"name": "a", "mesh": mesh}, {"name": "b", "mesh": mesh, "scale": [1, 1, 1.0001]})
    asset = load_asset(glb.save(tmp_path / "in.glb"))
    model, _ = first_guess(asset, triangles=120, atlas_size=64, keep_nodes="all")
    assert model.nodes is not None and model.nodes.placed == ((0, 1),)
    glb = Glb()
    glb.nodes({"name": "a", "mesh": ball(glb, "a")}, {"name": "b", "mesh": ball(glb, "b")})  # one on the other
    asset = load_asset(glb.save(tmp_path / "in.glb"))
    kept = kept_nodes(asset, replace_settings(keep_nodes="all"))
    assert kept is not None and kept.placed == ((0,), (1,))


def replace_settings(**changes):
    return load_config(None, [{"asset": "a.glb"}]).initial.model_copy(update=changes)


def test_a_checkpoint_has_them(tmp_path):
    subject, model, _ = simplified(cart(True), tmp_path, "initial.keep_nodes=all")
    checkpoint = Checkpoint(tmp_path / "checkpoint", subject.config, subject.geometry)
    checkpoint.begin(model, [])
    again, _, _ = checkpoint.load()
    assert again.nodes is not None and again.nodes.placed == model.nodes.placed
    assert again.nodes.tree.names == model.nodes.tree.names and again.skin.rigid
    np.testing.assert_array_equal(again.nodes.tree.motion, model.nodes.tree.motion)
    assert replace(again, nodes=None).n_triangles == len(model.mesh.faces)


def test_the_wheels_of_a_real_truck(tmp_path, shared_assets, node_run):
    source = shared_assets / "cesium_milk_truck" / "CesiumMilkTruck.glb"
    subject = open_subject(load_config(None, [{"asset": str(source)}, *SMALL, "initial.keep_nodes=all"]))
    model = subject.frame.restored(subject.guess()[0])
    path = export_model(model, tmp_path, formats=["glb"])["glb"]
    assert paths(document(path)["nodes"]) == paths(document(source)["nodes"])
    there, back = load_asset(source), load_asset(path)
    wheels = [
        [k for k, i in enumerate(a.instances) if a.instances[k].joint != a.instances[0].joint] for a in (there, back)
    ]
    for frame in (0, 10, 20):
        want, have = (
            [a.posed(frame).instances[k].to_world for k in which]
            for a, which in zip((there, back), wheels, strict=True)
        )
        np.testing.assert_allclose(have, want, atol=1e-5)
