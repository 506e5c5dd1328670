"""Morph targets: read with their names and defaults, carried to the small mesh, and back through a file."""

import numpy as np
from support.parts import grid
from support.tiny_models import Glb

from mi_simplify.export import export_model
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.guess import first_guess


def sheet(folder, weights):
    """A sheet with a target that lifts it as a wave, and one that moves it aside."""
    glb = Glb()
    p, f = grid(24)
    wave = np.float32(np.stack([0 * p[:, 0], 0 * p[:, 0], np.cos(3 * p[:, 0])], axis=1))
    aside = np.float32(0 * p + [0, 2, 0])
    primitive = {
        "attributes": {"POSITION": glb.accessor(np.float32(p)), "TEXCOORD_0": glb.accessor(np.float32(p[:, :2]))},
        "indices": glb.accessor(f.ravel().astype("u2")),
        "targets": [{"POSITION": glb.accessor(wave)}, {"POSITION": glb.accessor(aside)}],
    }
    glb.mesh(primitive)
    glb.json["meshes"][0] |= {"weights": weights, "extras": {"targetNames": ["wave", "aside"]}}
    glb.json["nodes"] = [{"mesh": 0, "scale": [2, 2, 2]}]
    return load_asset(glb.save(folder / "sheet.glb"))


def test_targets_are_read_by_their_names(tmp_path):
    asset = sheet(tmp_path, [0.5, 0.25])
    assert asset.notes == ()
    wave, aside = asset.parts[0].morphs
    assert (wave.name, wave.weight, aside.name, aside.weight) == ("wave", 0.5, "aside", 0.25)
    np.testing.assert_allclose(aside.offsets, np.tile([0, 2, 0], (625, 1)))
    np.testing.assert_allclose(asset.placed()[0].morphs[1].offsets, np.tile([0, 4, 0], (625, 1)))


def test_targets_go_through_the_first_guess_and_a_file(tmp_path):
    asset = sheet(tmp_path, [0.0, 0.25])
    model, _ = first_guess(asset, triangles=300, atlas_size=128)
    assert model.morphs is not None and model.morphs.names == ("wave", "aside")
    p = model.mesh.positions
    np.testing.assert_allclose(model.morphs.offsets[1], np.tile([0, 4, 0], (len(p), 1)), atol=1e-6)
    # The wave is that of the whole surface: vertices stand out of it where a face cuts it short.
    corners, wave = p[model.mesh.position_faces], model.morphs.offsets[0][model.mesh.position_faces][..., 2]
    bary = np.random.default_rng(0).dirichlet([1, 1, 1], 50)  # (S, 3) points of every face
    exact = 2 * np.cos(1.5 * corners[..., 0])
    double_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)

    def error(values):
        off = values @ bary.T - 2 * np.cos(1.5 * (corners[..., 0] @ bary.T))
        return np.sqrt(np.average((off**2).mean(1), weights=double_area))

    assert error(wave) < 0.7 * error(exact)
    moved = model.transformed(3.0, np.array([1.0, 2, 3]))
    assert moved.morphs is not None
    np.testing.assert_allclose(moved.morphs.offsets, 3 * model.morphs.offsets)
    (part,) = load_asset(export_model(model, tmp_path, formats=["glb"])["glb"]).parts
    assert [(m.name, m.weight) for m in part.morphs] == [("wave", 0), ("aside", 0.25)]
    gap = np.linalg.norm(part.vertices[:, None] - p[None], axis=2)
    assert gap.min(0).max() < 1e-5 and gap.min(1).max() < 1e-5  # as it was: the default of 'aside' is in its positions
    nearest = np.linalg.norm(part.vertices[:, None] - p[None], axis=2).argmin(1)
    np.testing.assert_allclose(part.morphs[0].offsets, model.morphs.offsets[0][nearest], atol=1e-5)
