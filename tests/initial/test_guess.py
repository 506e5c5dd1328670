"""The first guess of all three kinds: budgets, textures, notes, and the same again for the same seed."""

import numpy as np
import pytest
from support.parts import FACES, QUAD, QUAD_UV, asset_of

from mi_simplify.config import InitialSettings
from mi_simplify.errors import ConfigError, MeshError
from mi_simplify.formats.mitsuba.read import SceneAsset
from mi_simplify.initial.guess import alpha_of, decimated, first_guess, mean_material
from mi_simplify.initial.quadrics import quadrics_only
from mi_simplify.initial.sphere import sphere
from mi_simplify.initial.unwrap.atlas import texel_counts
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.model.model import Model

SMALL = dict(atlas_size=64, padding=2)


def pear(n=3000, offset=(0.0, 0.0, 0.0)) -> Asset:
    """A solid with a waist and a colour for every place, rough above and metal below."""
    p, f = sphere(n)
    q = p * [1, 1.5, 0.8] * (1 + 0.15 * np.sin(3 * p[:, 1:2]))
    colors = np.float32(np.column_stack([0.5 + 0.45 * p, np.ones(len(p))]))
    top = p[f].mean(1)[:, 1] > 0
    parts = tuple(
        Part(q + np.array(offset), f[which], colors=colors, material=Material(name, base, np.float32([[specular]])))
        for name, which, base, specular in (
            ("top", top, np.ones((1, 1, 4), np.float32), [0, 0.9, 0]),
            ("bottom", ~top, np.float32([[[0.5, 0.5, 0.5, 1]]]), [0, 0.2, 1]),
        )
    )
    return Asset(parts, (Instance(0), Instance(1)), name="pear", notes=("a note of the reader",))


def low_poly(n=200) -> Asset:
    p, f = sphere(n)
    return Asset((Part(p * [1, 1.5, 0.8], f),), (Instance(0),), name="low")


STARTS = {
    "decimate": dict(kind="decimate", triangles=200),
    "sphere": dict(kind="sphere", triangles=200),
    "mesh": dict(mesh=low_poly(), repair=False),
}


def arrays(model: Model) -> list[np.ndarray]:
    mesh = model.mesh
    return [mesh.positions, mesh.position_index, mesh.normal_groups, mesh.uvs, mesh.faces,
            model.base_color, model.specular, model.normal]  # fmt: skip


@pytest.mark.parametrize("kind", STARTS)
def test_every_kind_gives_a_whole_model(kind):
    model, notes = first_guess(pear(), **STARTS[kind], **SMALL)
    assert model.n_triangles == 200 and model.name == "pear" and "a note of the reader" in notes
    assert texel_counts(model.mesh, 64).max() == 1
    assert model.base_color.shape == (64, 64, 4) and model.specular.shape == model.normal.shape == (64, 64, 3)
    for array in arrays(model):
        assert np.isfinite(array).all()
    assert np.allclose(np.linalg.norm(model.normal, axis=2), 1, atol=1e-5) and model.normal[..., 2].min() > 0
    assert np.abs(model.mesh.positions).max(0) == pytest.approx([1, 1.6, 0.8], abs=0.2)
    # what is above is rough, what is below is metal, wherever it landed in the atlas
    assert model.specular[..., 2].min() == 0 and model.specular[..., 2].max() == pytest.approx(1)
    assert np.corrcoef(model.specular[..., 1].ravel(), model.specular[..., 2].ravel())[0, 1] < -0.99
    assert model.alpha_mode == "OPAQUE"


@pytest.mark.parametrize("textures", ["bake", "random"])
@pytest.mark.parametrize("kind", STARTS)
def test_the_same_seed_gives_the_same_model(kind, textures):
    a, b = (first_guess(pear(), textures=textures, seed=5, **STARTS[kind], **SMALL)[0] for _ in range(2))
    assert all(np.array_equal(x, y) for x, y in zip(arrays(a), arrays(b), strict=True))
    other, _ = first_guess(pear(), textures=textures, seed=6, **STARTS[kind], **SMALL)
    assert np.array_equal(a.base_color, other.base_color) == (textures == "bake")


def test_a_sphere_stands_in_the_box_of_the_asset():
    model, _ = first_guess(pear(offset=(10, -4, 2)), kind="sphere", triangles=400, textures="constant", **SMALL)
    low, high = pear(offset=(10, -4, 2)).bounds
    p = model.mesh.positions
    assert np.allclose(p.min(0), low, atol=0.1) and np.allclose(p.max(0), high, atol=0.1)


def test_plain_textures_are_the_mean_of_the_asset_or_noise():
    base, specular = mean_material(pear())
    assert base[3] == 1 and specular[2] == pytest.approx(0.5, abs=0.1)
    model, _ = first_guess(pear(), textures="constant", **STARTS["sphere"], **SMALL)
    assert (model.base_color == base).all() and (model.specular == specular).all()
    noise, _ = first_guess(pear(), textures="random", **STARTS["sphere"], **SMALL)
    assert noise.base_color[..., :3].std() > 0.2 and (noise.base_color[..., 3] == 1).all()
    for plain in (model, noise):
        assert (plain.normal == [0, 0, 1]).all()


def test_the_mean_material_counts_area_and_texels():
    big, small = (Part(np.array([[0, 0, 0], [s, 0, 0], [0, s, 0]], float), np.array([[0, 1, 2]]),
                       material=Material("m", np.float32([[[c, 0, 0, 1], [c, 1, 0, 1]]])))
                  for s, c in ((3, 1.0), (1, 0.0)))  # fmt: skip
    base, specular = mean_material(Asset((big, small), (Instance(0), Instance(1))))
    assert np.allclose(base, [0.9, 0.5, 0, 1]) and np.allclose(specular, [0, 0.5, 0])


def test_what_has_no_triangles_can_still_start_from_a_sphere():
    """A shape of a Mitsuba scene that is known by its box alone."""
    asset = pear()
    scene = SceneAsset(asset.parts, asset.instances, name="scene", without_triangles=("sdfgrid",))
    model, _ = first_guess(scene, kind="sphere", triangles=100, textures="constant", **SMALL)
    base, _ = mean_material(asset)
    assert model.n_triangles == 100 and (model.base_color == base).all()


def test_budgets_are_refused_in_one_line_with_both_counts():
    with pytest.raises(MeshError, match=r"above the input's own 3000 \(1502 vertices\); ask for fewer"):
        first_guess(pear(), triangles=3001)
    with pytest.raises(MeshError, match="has 2 triangles, too few to simplify"):
        first_guess(asset_of(Part(QUAD, FACES, uvs=QUAD_UV)), triangles=300)
    with pytest.raises(ConfigError, match="triangles: .*greater than or equal to 4, got 3"):
        first_guess(pear(), triangles=3)
    with pytest.raises(MeshError, match=r"low has 200 triangles \(102 vertices\), above the budget of 199"):
        first_guess(pear(), mesh=low_poly(), triangles=199)
    with pytest.raises(MeshError, match="needs one: name the file"):
        first_guess(pear(), InitialSettings(kind="mesh", mesh="low.obj"))
    with pytest.raises(MeshError, match="a budget of triangles is needed"):
        decimated(pear(), InitialSettings(kind="mesh", mesh="low.obj"))
    with pytest.raises(ConfigError, match="kind: .*'decimate'.* got 'cube'"):
        first_guess(pear(), kind="cube", triangles=20)
    with pytest.raises(ConfigError, match="trinagles: unknown key, did you mean 'triangles'"):
        first_guess(pear(), trinagles=20)


def test_a_mesh_that_stands_elsewhere_is_refused():
    away = low_poly()
    move = np.eye(4)
    move[0, 3] = 5
    with pytest.raises(MeshError, match="low does not stand where pear does"):
        first_guess(pear(), mesh=away.transformed(move))


def test_the_whole_budget_changes_nothing_about_the_shape():
    model, _ = first_guess(pear(400), triangles=400, **SMALL)
    asset = pear(400)
    corners = np.concatenate([p.vertices[p.faces] for p in asset.parts])
    assert np.allclose(np.sort(model.mesh.vertices[model.mesh.faces].sum((1, 2))), np.sort(corners.sum((1, 2))))


def test_transparency_decides_the_alpha_mode():
    solid, clear = np.ones((2, 2, 4), np.float32), np.zeros((2, 2, 4), np.float32)

    def of(*modes):
        parts = tuple(Part(np.eye(3), np.array([[0, 1, 2]]), material=Material("m", alpha_mode=m)) for m in modes)
        return Asset(parts, tuple(Instance(k) for k in range(len(parts))))

    assert alpha_of(of("OPAQUE"), clear)[0] == "OPAQUE"
    assert alpha_of(of("MASK", "BLEND"), solid)[0] == "OPAQUE"
    assert alpha_of(of("MASK", "OPAQUE"), clear)[0] == "MASK"
    assert alpha_of(of("MASK", "BLEND"), clear)[0] == "BLEND"


def test_the_baseline_is_quadrics_with_colours_and_no_normal_map():
    model, _ = quadrics_only(pear(), 200, atlas_size=64)
    assert 190 <= model.n_triangles <= 200
    assert (model.normal == [0, 0, 1]).all() and model.base_color[..., :3].std() > 0.1
    whole, _ = quadrics_only(pear(400), 1000, atlas_size=128)
    assert whole.n_triangles == 400
