"""Faces of several kinds in one file: each its own primitive and material, all of one atlas."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from support.parts import FACES, QUAD, QUAD_UV, asset_of, painted

from mi_simplify.export import export_model
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.guess import first_guess
from mi_simplify.initial.sphere import sphere
from mi_simplify.judging.self_check import self_check
from mi_simplify.model.asset import Asset, Material, Part
from mi_simplify.model.groups import Groups
from mi_simplify.model.model import Model

COAT = {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5}, "KHR_materials_ior": {"ior": 1.8}}


@pytest.fixture(scope="module")
def scene() -> Asset:
    """A coated ball in front of an opaque wall, a pane of glass beside it, a leaf with a hole that has one side."""
    p, f = sphere(600)
    wall = Part(QUAD * 2 - [0, 0, 1.5], FACES, material=replace(painted((0.8, 0.1, 0.1)), name="wall"))
    ball = Part(p * 0.8, f, material=replace(painted((0.1, 0.8, 0.1)), name="ball", lobes=COAT))
    glass = Material("glass", np.float32([[[0.1, 0.1, 0.8, 0.25]]]), alpha_mode="BLEND")
    pane = Part(QUAD * 0.5 + [3, 0, 0], FACES, material=glass)
    leaf = np.ones((16, 16, 4), np.float32) * np.float32([0.9, 0.9, 0.1, 1])
    leaf[4:12, 4:12, 3] = 0
    leafy = Material("leaf", leaf, alpha_mode="MASK", alpha_cutoff=0.25, double_sided=False)
    return asset_of(wall, ball, pane, Part(QUAD * 0.5 - [3, 0, 0], FACES, uvs=QUAD_UV, material=leafy))


@pytest.fixture(scope="module")
def guess(scene) -> Model:
    return first_guess(scene, triangles=200, atlas_size=256)[0]


def kinds(model: Model) -> dict[str, tuple]:
    return {k.name: (k.alpha_mode, k.double_sided, k.lobes) for k in model.face_groups.kinds}


def test_faces_take_the_kind_of_what_they_stand_for(guess):
    expected = {
        "wall": ("OPAQUE", True, {}), "ball": ("OPAQUE", True, COAT), "glass": ("BLEND", True, {}),
        "leaf": ("MASK", False, {}),
    }  # fmt: skip
    assert kinds(guess) == expected and guess.alpha_mode == "BLEND"
    centre = guess.mesh.vertices[guess.mesh.faces].mean(1)
    names = np.array([guess.face_groups.kinds[k].name for k in guess.face_groups.of_face])
    assert set(names[centre[:, 0] > 2.4]) == {"glass"} and set(names[centre[:, 0] < -2.4]) == {"leaf"}
    assert set(names[centre[:, 2] > -0.9]) == {"ball", "glass", "leaf"}


def test_what_is_blended_leaves_the_rest_opaque(guess):
    """The texels of each face hold its own material's opacity and colour."""
    size = guess.base_color.shape[0]
    uv = guess.mesh.uvs[guess.mesh.faces].mean(1)
    texel = guess.base_color[(uv[:, 1] * size).astype(int), (uv[:, 0] * size).astype(int)]
    for k, kind in enumerate(guess.face_groups.kinds):
        of = texel[guess.face_groups.of_face == k]
        color = {"wall": (0.8, 0.1, 0.1), "ball": (0.1, 0.8, 0.1), "glass": (0.1, 0.1, 0.8), "leaf": (0.9, 0.9, 0.1)}
        np.testing.assert_allclose(of[:, :3], np.tile(color[kind.name], (len(of), 1)), atol=1e-3)
        if kind.name != "leaf":
            np.testing.assert_allclose(of[:, 3], 0.25 if kind.name == "glass" else 1, atol=1e-3)


def test_a_glb_has_a_primitive_and_a_material_for_each_kind(guess, tmp_path):
    path = export_model(guess, tmp_path, formats=["glb"])["glb"]
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    (mesh,) = document["meshes"]
    assert len(mesh["primitives"]) == len(document["materials"]) == 4 and len(document["images"]) <= 4
    assert len({json.dumps(p["attributes"]) for p in mesh["primitives"]}) == 1
    found = {m["name"]: m for m in document["materials"]}
    assert {n: m["alphaMode"] for n, m in found.items()} == {
        "wall": "OPAQUE", "ball": "OPAQUE", "glass": "BLEND", "leaf": "MASK"
    }  # fmt: skip
    assert found["ball"]["extensions"] == COAT
    assert (
        found["leaf"].get("alphaCutoff", 0.5) == 0.5
    )  # the bake has cut at the asset's 0.25; what it averages is coverage
    assert [n for n, m in found.items() if not m["doubleSided"]] == ["leaf"]
    assert set(COAT) <= set(document["extensionsUsed"])


@pytest.mark.parametrize("kind", ["glb", "obj", "usd"])
def test_files_of_several_kinds_show_the_model(guess, tmp_path, kind):
    written = load_asset(export_model(guess, tmp_path, formats=[kind])[kind])
    assert len(written.parts) == 4 and written.n_triangles == guess.n_triangles
    modes = sorted(part.material.alpha_mode for part in written.parts)
    assert modes == sorted(["OPAQUE", "OPAQUE", "BLEND", "BLEND" if kind == "obj" else "MASK"])
    assert self_check(guess, written, n_views=1, resolution=64) > 40
    if kind != "obj":
        assert (
            sum(part.material.lobes.get("KHR_materials_ior") == {"ior": pytest.approx(1.8)} for part in written.parts)
            == 1
        )


def test_an_opaque_texture_of_a_blending_material_is_opaque():
    solid = Part(QUAD, FACES, material=Material("solid", np.float32([[[1, 0, 0, 1]]]), alpha_mode="BLEND"))
    model, _ = first_guess(asset_of(solid), triangles=4, kind="sphere", atlas_size=32)
    assert model.alpha_mode == "OPAQUE" and kinds(model) == {"solid": ("OPAQUE", True, {})}


def test_a_side_that_got_lost_is_shown_from_the_other():
    """A thin sheet of two one-sided skins, of which the low-poly mesh keeps one."""
    one = replace(painted((0.5, 0.5, 0.5)), double_sided=False)
    back = Part(QUAD - [0, 0, 1e-3], FACES[:, ::-1], material=one)
    low = asset_of(Part(QUAD, FACES, uvs=QUAD_UV))
    for asset, double in (
        (asset_of(Part(QUAD, FACES, material=one)), False),
        (asset_of(Part(QUAD, FACES, material=one), back), True),
    ):
        model, _ = first_guess(asset, mesh=low, atlas_size=32)
        assert [k.double_sided for k in model.face_groups.kinds] == [double]


def test_split_faces_stay_in_their_group():
    groups = Groups((), np.array([0, 1]))
    assert groups.split(2).of_face.tolist() == [0, 1] * 16
