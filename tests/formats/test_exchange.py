"""FBX, Collada and STEP through their libraries: shapes, places, colours; what is lost is a line, nonsense an error."""

import builtins

import numpy as np
import pytest
from support.exchange import collada, fbx, step
from support.tiny_models import corner_pixels, png

from mi_simplify.errors import AssetError
from mi_simplify.formats.load import load_asset
from mi_simplify.model.color import srgb_to_linear
from mi_simplify.model.topology import area_vectors

QUAD = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], float)
CORNERS = QUAD[:, :2] / [2, 1]
TETRAHEDRON = np.array([[0, 0, 0], [10, 0, 0], [0, 20, 0], [0, 0, 30]], float)
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def dae(folder, **changes):
    pytest.importorskip("assimp_py")
    (folder / "a.dae").write_text(collada(QUAD, [range(4)], CORNERS, **changes))
    return load_asset(folder / "a.dae")


def test_collada_stands_in_metres_with_its_up_axis_up(tmp_path):
    asset = dae(tmp_path, unit=0.5, up="Z_UP")
    # Z_UP: y of the file points away from the viewer, and its z, where the node stands at 7, upwards.
    np.testing.assert_allclose(asset.bounds, [[0, 3.5, -0.5], [1, 3.5, 0]], atol=1e-6)
    assert asset.notes == () and asset.instances[0].name == "n"


def test_collada_materials(tmp_path):
    (tmp_path / "a.png").write_bytes(png(corner_pixels()))
    effect = "<transparency><float>0.5</float></transparency>"
    (part,) = dae(tmp_path, diffuse='<texture texture="s" texcoord="t"/>', effect=effect).parts
    pixels = corner_pixels()
    np.testing.assert_allclose(part.material.base_color[..., :3], srgb_to_linear(pixels[..., :3] / 255), atol=1e-5)
    assert part.material.alpha_mode == "BLEND" and part.material.base_color[0, 0, 3] == pytest.approx(0.5)
    assert part.uvs is not None
    np.testing.assert_allclose(part.uvs, part.vertices[:, :2] / [2, -1] + [0, 1], atol=1e-6)


def test_fbx_has_its_place_and_colours(tmp_path):
    pytest.importorskip("assimp_py")
    (tmp_path / "a.fbx").write_text(fbx(QUAD, [range(4)], CORNERS))
    asset = load_asset(tmp_path / "a.fbx")
    (part,) = asset.parts
    np.testing.assert_allclose(asset.bounds, [[0, 0, 7], [2, 1, 7]], atol=1e-6)
    np.testing.assert_allclose(part.material.base_color[0, 0], [*srgb_to_linear(np.array([1, 0.5, 0])), 1], atol=1e-6)
    assert part.material.emission is not None
    np.testing.assert_allclose(part.material.emission[0, 0], srgb_to_linear(np.array([0, 0, 0.5])), atol=1e-6)
    assert asset.notes == ()


def test_what_assimp_does_not_hand_over_is_a_line(tmp_path):
    lights = '<library_lights><light id="l"/></library_lights><library_animations><animation/></library_animations>'
    asset = dae(tmp_path, more=lights, diffuse='<texture texture="s" texcoord="t"/>')
    assert [note.split(" of the file")[0] for note in asset.notes[:2]] == ["animation", "lights"]
    assert "'a.png' does not exist" in asset.notes[2] and len(asset.notes) == 3


def test_step_surfaces_are_solids_in_metres(tmp_path, capfd):
    pytest.importorskip("cascadio")
    (tmp_path / "a.step").write_text(step(TETRAHEDRON, FACES))
    asset = load_asset(tmp_path / "a.step")
    corners = np.concatenate([p.vertices[p.faces] for p in asset.placed()])
    volume = (area_vectors(corners) * corners[:, 0]).sum() / 6
    assert volume == pytest.approx(10 * 20 * 30 / 6 * 1e-9, rel=1e-4) and asset.n_triangles == 4
    assert len(asset.notes) == 1 and "4 triangles" in asset.notes[0]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["a.fbx", "a.dae", "a.step"])
def test_nonsense_is_one_line(name, tmp_path):
    pytest.importorskip("assimp_py"), pytest.importorskip("cascadio")
    (tmp_path / name).write_text("neither the one\nnor the other")
    with pytest.raises(AssetError, match=f"{name}: (Assimp|OpenCASCADE) cannot read it.* GLB") as caught:
        load_asset(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.fbx", "a.dae", "a.stp"])
def test_a_missing_package_is_named_with_its_extra(name, tmp_path, monkeypatch):
    (tmp_path / name).write_text("x")
    known = builtins.__import__

    def without(module, *args, **kwargs):
        if module in ("assimp_py", "cascadio"):
            raise ImportError(module)
        return known(module, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(AssetError, match=r"pip install 'mi-simplify\[formats\]'"):
        load_asset(tmp_path / name)
