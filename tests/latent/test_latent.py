"""The latent model between NumPy and the device: what goes in comes out, in the right frame."""

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from support.models import random_sphere as model

from mi_simplify.latent.latent import Latent
from mi_simplify.model.model import Model


@pytest.mark.parametrize("extended", [False, True])
def test_what_goes_in_comes_out(extended):
    first = model(alpha_mode="MASK", alpha_cutoff=0.3, name="ball")
    latent = Latent(first, extended)
    again = latent.model(first.mesh.positions)
    assert np.array_equal(again.mesh.vertices[again.mesh.faces], first.mesh.vertices[first.mesh.faces])
    assert np.array_equal(again.mesh.uvs[again.mesh.faces], first.mesh.uvs[first.mesh.faces])
    assert np.array_equal(again.mesh.position_faces, first.mesh.position_faces)
    keep = slice(0, 4) if extended else slice(0, 3)
    assert np.array_equal(again.base_color[..., keep], first.base_color[..., keep])
    assert np.array_equal(again.specular[..., 1:], first.specular[..., 1:])
    assert np.all(again.base_color[..., 3] == 1) != extended and np.all(again.specular[..., 0] == 0) != extended
    assert np.allclose(again.normal, first.normal, atol=1e-6)
    assert (again.alpha_mode, again.alpha_cutoff, again.name) == ("MASK", 0.3, "ball")


def test_moved_positions_come_out():
    first = model()
    latent, moved = Latent(first), first.mesh.positions * 1.5 + [0, 1, 0]
    again = latent.model(moved.ravel())  # flat, as the optimiser has them
    assert np.array_equal(again.mesh.positions, moved) and again.n_triangles == 48
    surface = latent.evaluate(mi.Float(moved.astype(np.float32).ravel()))
    p = surface.packets.numpy().reshape(-1, 3, 4)[:, 0, :3]
    assert np.allclose(p, again.mesh.vertices, atol=1e-6)


def test_transformed_goes_there_and_back():
    first, offset = model(), np.array([1.0, -2, 3])
    there = first.transformed(2.5, offset)
    assert np.allclose(there.mesh.positions, first.mesh.positions * 2.5 + offset)
    back = there.transformed(1 / 2.5, -offset / 2.5)
    assert np.allclose(back.mesh.positions, first.mesh.positions)
    assert back.normal is first.normal and np.array_equal(back.mesh.uvs, first.mesh.uvs)


def test_as_asset_is_the_same_mesh_with_its_normals_and_material():
    first = model(alpha_mode="BLEND", name="ball")
    asset = first.as_asset()
    part = asset.parts[0]
    assert asset.n_triangles == first.n_triangles == 48 and asset.name == "ball"
    assert np.array_equal(part.vertices, first.mesh.vertices) and np.array_equal(part.faces, first.mesh.faces)
    assert np.allclose(np.linalg.norm(part.normals, axis=1), 1, atol=1e-6)
    assert np.sum(part.normals * part.vertices, axis=1).min() > 0.8  # outwards
    # One normal a position, whatever the seams.
    for k in range(len(first.mesh.positions)):
        assert np.ptp(part.normals[first.mesh.position_index == k], axis=0).max() == 0
    assert part.material.base_color is first.base_color and part.material.normal is first.normal
    assert part.material.specular is first.specular and part.material.alpha_mode == "BLEND"


@pytest.mark.parametrize(
    ("quantities", "changed"),
    [
        ((), {}),
        (("vertices",), {"positions"}),
        (("base_color", "normal"), {"red", "green", "blue", "normal"}),
        (("opacity", "metallic"), {"opacity", "metallic"}),
        (("gamma", "roughness", "vertices"), {"gamma", "roughness", "positions"}),
    ],
)
def test_a_fitted_model_gives_away_only_what_was_fitted(quantities, changed):
    guess, other = model(0, alpha_mode="MASK"), model(1)
    fitted = Latent(guess).model(other.mesh.positions)
    fitted = replace(fitted, base_color=other.base_color, specular=other.specular, normal=other.normal)

    def parts(m: Model) -> dict[str, np.ndarray]:
        names = ("red", "green", "blue", "opacity", "gamma", "roughness", "metallic")
        images = np.concatenate([m.base_color, m.specular], axis=2).transpose(2, 0, 1)
        return {"positions": m.mesh.positions, "normal": m.normal, **dict(zip(names, images, strict=True))}

    result = guess.taking(fitted, quantities)
    assert result.alpha_mode == "MASK" and result.name == guess.name and result.mesh.faces is fitted.mesh.faces
    for name, value in parts(result).items():
        assert np.array_equal(value, parts(fitted if name in changed else guess)[name]), name


def test_custom_mips_come_back_as_they_went_in():
    first = model(size=16)
    start = Latent(first, extended=True, mips="custom").model(first.mesh.positions)
    assert [level["normal"].shape[0] for level in start.mips] == [8, 4, 2, 1]
    again = Latent(start, extended=True, mips="custom").model(first.mesh.positions)
    for a, b in zip(start.mips, again.mips, strict=True):
        assert all(np.allclose(a[name], b[name], atol=1e-6) for name in a)
    assert Latent(first, mips="derived").model(first.mesh.positions).mips == ()
    kept = start.taking(Latent(model(1, size=16), True, "custom").model(first.mesh.positions), ("normal",))
    assert np.array_equal(kept.mips[0]["base_color"], start.mips[0]["base_color"])
    assert not np.allclose(kept.mips[0]["normal"], start.mips[0]["normal"])
