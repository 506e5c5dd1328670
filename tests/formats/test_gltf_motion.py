"""Animated nodes and several clips of glTF: joints of their own, every clip by its name, through a file and back."""

import json
import struct

import numpy as np
import pytest
from support.tiny_models import QUAD, Glb

from mi_simplify.export import export_model
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.reduce.weights import carried_weights
from mi_simplify.judging.self_check import self_check
from mi_simplify.model.asset import Asset, rig_of
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.model import Model
from mi_simplify.model.rigging import Rigging
from mi_simplify.subjects.character import boxes

TURN = np.float32([[0, 0, 0, 1], [0, 0, 0.5**0.5, 0.5**0.5]])  # a quarter about z


@pytest.fixture
def truck(tmp_path) -> Asset:
    """A body that stands still and a wheel that turns in one clip, rises in the other."""
    glb = Glb()
    glb.mesh(glb.quad(), name="body")
    glb.mesh(glb.quad(), name="wheel")
    glb.nodes(
        {"name": "truck", "children": [1, 2]}, {"name": "body", "mesh": 0},
        {"name": "wheel", "mesh": 1, "translation": [3, 0, 0]},
    )  # fmt: skip
    time = glb.accessor(np.float32([0, 1 / 24, 2 / 24]))
    turn = glb.accessor(np.float32([TURN[0], TURN[1], TURN[0]]))
    up = glb.accessor(np.float32([[3, 0, 0], [3, 0, 1], [3, 0, 2]]))
    glb.json["animations"] = [
        {"name": name, "samplers": [{"input": time, "output": output}],
         "channels": [{"sampler": 0, "target": {"node": 2, "path": path}}]}
        for name, output, path in (("spin", turn, "rotation"), ("lift", up, "translation"))
    ]  # fmt: skip
    return load_asset(glb.save(tmp_path / "truck.glb"))


def test_animated_nodes_are_joints_and_all_clips_are_there(truck):
    rig = rig_of(truck)
    assert truck.notes == () and rig.clips == (("spin", 0, 3), ("lift", 3, 6)) and "wheel" in rig.names
    wheel = [k for k, part in enumerate(truck.posed(1).instances) if part.name == "wheel"][0]
    placed = [truck.posed(frame).placed()[wheel].vertices for frame in range(6)]
    np.testing.assert_allclose(placed[0], QUAD + [3, 0, 0], atol=1e-6)
    np.testing.assert_allclose(placed[1], np.stack([-QUAD[:, 1], QUAD[:, 0], QUAD[:, 2]], 1) + [3, 0, 0], atol=1e-6)
    np.testing.assert_allclose(placed[5], QUAD + [3, 0, 2], atol=1e-6)  # the first clip does not go on in the second
    np.testing.assert_allclose(truck.posed(4).placed()[1 - wheel].vertices, QUAD, atol=1e-9)
    assert (np.diff(rig.codes) > 0).all()


def test_some_frames_of_several_clips(truck):
    assert rig_of(truck).clip(np.array([1, 2, 5])).clips == (("spin", 0, 2), ("lift", 2, 3))


def test_clips_come_back_by_their_names(truck, tmp_path):
    rig = rig_of(truck)
    vertices = np.concatenate([part.vertices for part in truck.placed()])
    faces = np.concatenate([part.faces + 4 * k for k, part in enumerate(truck.placed())])
    uvs = np.concatenate([part.uvs for part in truck.placed()])
    mesh = Mesh(vertices, np.arange(8), uvs, faces)
    flat = np.zeros((128, 128, 3), np.float32) + np.float32([0, 0, 1])
    noise = np.concatenate([np.random.default_rng(0).random((128, 128, 3)), np.ones((128, 128, 1))], 2).astype(
        np.float32
    )
    rigging = Rigging(carried_weights(truck, mesh), rig, boxes(truck), np.arange(6), 4, 0.0)
    model = Model(mesh, noise, flat[..., ::-1] * 0.5, flat, skin=rigging)
    path = export_model(model, tmp_path, formats=["glb"])["glb"]
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    assert [a["name"] for a in document["animations"]] == ["spin", "lift"]
    assert "wheel" in [node.get("name") for node in document["nodes"]]
    again = load_asset(path)
    assert rig_of(again).clips == rig.clips
    for frame in range(6):
        want = np.concatenate([part.vertices for part in truck.posed(frame).placed()])
        got = np.concatenate([part.vertices for part in again.posed(frame).placed()])
        gap = np.linalg.norm(want[:, None] - got[None], axis=2).min(1)
        assert gap.max() < 1e-5
    # Rigid parts are shown with the weights that they have, not with what a fit may begin from.
    assert self_check(model, again) > 65  # 60 with these
