"""The baker: known colours, relief and roughness land where they belong, and nothing bleeds."""

import numpy as np
import pytest
from support.parts import FACES, LOW, QUAD, QUAD_UV, asset_of, grid, painted

from mi_simplify.errors import MeshError
from mi_simplify.initial.bake.baker import bake, reaches
from mi_simplify.initial.closest import ClosestPoints
from mi_simplify.initial.groups import Grouping
from mi_simplify.initial.sphere import sphere
from mi_simplify.initial.unwrap.charting import unwrap
from mi_simplify.model.asset import Material, Part
from mi_simplify.model.groups import Group, Groups
from mi_simplify.model.mesh import Mesh


def where(mesh: Mesh, size: int) -> np.ndarray:
    """World position of every texel, NaN where there is no surface, shape (size, size, 3)."""
    from mi_simplify.initial.bake.lookup import LowPoly

    points = LowPoly(mesh, np.zeros(len(mesh.positions))).points(size, (0.5, 0.5))
    p = np.where(points.active.numpy(), points.p.numpy(), np.nan)
    return p.T.reshape(size, size, 3)


def test_a_texture_comes_back_texel_by_texel():
    """Texel centres are where the renderer has them: the same UVs and the same size give the same image."""
    rng = np.random.default_rng(0)
    base, specular = rng.random((16, 16, 4)).astype(np.float32), rng.random((16, 16, 3)).astype(np.float32)
    base[..., 3] = 1
    asset = asset_of(Part(QUAD, FACES, uvs=QUAD_UV, material=Material("m", base, specular)))
    baked = bake(asset, LOW, size=16, samples=1)
    np.testing.assert_allclose(baked.base_color, base, atol=1e-4)
    np.testing.assert_allclose(baked.specular, specular, atol=1e-4)
    assert baked.covered.all() and baked.missed == 0
    np.testing.assert_allclose(baked.normal, np.broadcast_to([0, 0, 1], (16, 16, 3)), atol=1e-5)


def test_two_materials_in_one_atlas_without_bleeding():
    p, f = sphere(6000)
    right = p[f].mean(1)[:, 0] > 0
    gold, clay = painted((0.9, 0.6, 0.1), 0.2, 1.0), painted((0.1, 0.2, 0.7), 0.9, 0.0)
    q, g = sphere(300)
    low, _ = unwrap(q, g, atlas_size=128)
    baked = bake(asset_of(Part(p, f[right], material=gold), Part(p, f[~right], material=clay)), low, size=128)
    x = where(low, 128)[..., 0]
    for side, m in ((x > 0.1, gold), (x < -0.1, clay)):
        assert side.sum() > 2000
        assert np.abs(baked.base_color[side] - m.base_color[0, 0]).max() < 1e-5
        assert np.abs(baked.specular[side] - m.specular[0, 0]).max() < 1e-5
    # Between the charts each texel is one of the two colours, or the mixture of a texel on the border.
    share = (baked.base_color[..., 0] - 0.1) / 0.8
    assert share.min() > -1e-5 and share.max() < 1 + 1e-5
    far = ~baked.covered
    assert far.any() and (np.minimum(share, 1 - share)[far] < 1e-5).mean() > 0.9


def test_the_background_repeats_the_nearest_texel():
    q, g = sphere(40)
    low, _ = unwrap(q, g, atlas_size=64)
    p, f = sphere(2000)
    colors = np.float32(np.column_stack([0.5 + 0.5 * p, np.ones(len(p))]))
    baked = bake(asset_of(Part(p, f, colors=colors)), low, size=64)
    y, x = np.nonzero(baked.covered)
    for v, u in np.argwhere(~baked.covered)[::37]:
        d = (y - v) ** 2 + (x - u) ** 2
        nearest = baked.base_color[y[d == d.min()], x[d == d.min()]]
        assert (np.abs(nearest - baked.base_color[v, u]).max(1) == 0).any()


def test_a_known_relief_becomes_its_normals_and_heights():
    def height(x, y):
        return 0.03 * np.sin(4 * x) * np.cos(3 * y)

    p, f = grid(150, height)
    baked = bake(asset_of(Part(p, f)), LOW, size=64)
    x, y, _ = where(LOW, 64).transpose(2, 0, 1)
    n = np.stack([-0.12 * np.cos(4 * x) * np.cos(3 * y), 0.09 * np.sin(4 * x) * np.sin(3 * y), np.ones_like(x)], 2)
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((n * baked.normal).sum(2), -1, 1)))
    assert angle.mean() < 0.2 and angle.max() < 1.5
    assert np.abs(baked.height[..., 0] - height(x, y)).max() < 2e-3


def test_a_relief_survives_charts_that_are_turned_and_bent():
    """The world-space normal of every texel is that of the reference, whatever the tangent frame under it."""
    from mi_simplify.initial.bake.lookup import LowPoly

    p, f = sphere(20_000)
    p = p * (1 + 0.02 * np.sin(9 * p[:, :1]) * np.cos(8 * p[:, 1:2]))
    q, g = sphere(500)
    low, _ = unwrap(q, g, atlas_size=256)
    baked = bake(asset_of(Part(p, f)), low, size=256)
    points = LowPoly(low, np.zeros(len(q))).points(256, (0.5, 0.5))
    active = points.active.numpy()
    n, t, w = points.n.numpy().T, points.t.numpy().T, points.w.numpy()
    local = baked.normal.reshape(-1, 3)
    world = local[:, :1] * t + local[:, 1:2] * w[:, None] * np.cross(n, t) + local[:, 2:] * n
    reference = ClosestPoints(p, f)
    expected = reference.normals[reference.query(points.p.numpy().T[active]).face]
    angle = np.degrees(np.arccos(np.clip((world[active] * expected).sum(1), -1, 1)))
    assert np.median(angle) < 1.5 and np.quantile(angle, 0.99) < 6
    flat = np.degrees(np.arccos(np.clip((n[active] * expected).sum(1), -1, 1)))
    assert np.median(flat) > 5  # what a flat normal map would be off by


def test_holes_are_transparent_and_keep_the_colour_of_what_is_around():
    leaf = np.ones((32, 32, 4), np.float32) * [0.2, 0.6, 0.1, 1]
    leaf[8:24, 8:24, 3] = 0
    material = Material("leaf", np.float32(leaf), alpha_mode="MASK")
    baked = bake(asset_of(Part(QUAD, FACES, uvs=QUAD_UV, material=material)), LOW, size=32)
    opacity = baked.base_color[..., 3]
    assert (opacity[10:22, 10:22] == 0).all() and (opacity[:6] == 1).all()
    np.testing.assert_allclose(baked.base_color[..., :3], leaf[..., :3], atol=1e-5)


def test_what_is_out_of_reach_takes_the_closest_surface():
    far = Mesh(QUAD + [0, 0, 5], np.arange(4), QUAD_UV, FACES)
    baked = bake(asset_of(Part(QUAD, FACES, material=painted((0.7, 0.1, 0.1)))), far, size=8, reach=0.1)
    assert baked.missed == 1
    np.testing.assert_allclose(baked.base_color[..., :3], np.broadcast_to([0.7, 0.1, 0.1], (8, 8, 3)), atol=1e-6)
    for image in (baked.base_color, baked.specular, baked.normal, baked.height):
        assert np.isfinite(image).all()


def test_rays_look_as_far_as_the_surfaces_are_apart():
    p, f = sphere(4000)
    q, g = sphere(300)
    low = Mesh(q, np.arange(len(q)), np.zeros((len(q), 2), np.float32), g)
    near, wide = (reaches(low, ClosestPoints(r * p, f), 2 * r * 3**0.5) for r in (1.01, 1.3))
    assert (near > 0.01).all() and near.max() < 0.15
    assert (wide > 0.3).all() and wide.max() < 0.7


def test_a_bake_is_the_same_every_time():
    p, f = sphere(3000)
    low, _ = unwrap(*sphere(100), atlas_size=64)
    asset = asset_of(Part(p * [1, 1.2, 0.9], f, colors=np.float32(np.column_stack([abs(p), np.ones(len(p))]))))
    a, b = (bake(asset, low, size=64) for _ in range(2))
    for name in ("base_color", "specular", "normal", "height"):
        assert np.array_equal(getattr(a, name), getattr(b, name))


def test_a_mesh_without_texels_is_refused():
    none = Mesh(QUAD, np.arange(4), np.zeros((4, 2), np.float32), FACES)
    with pytest.raises(MeshError, match="covers no texel"):
        bake(asset_of(Part(QUAD, FACES)), none, size=8)


def test_occlusion_is_the_share_of_the_sky_that_the_asset_sees():
    """A floor before a long wall: of the sky (1 - d / √(d² + h²)) / 2 is hidden, by the form factor of a strip."""
    floor = np.array([[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]]) * [[2.0, 1, 1]]
    height, length = 0.5, 200
    wall = np.array([[0, 0, length], [0, 0, -length], [0, height, -length], [0, height, length]])
    glass = np.array([[0, 0.1, 1], [2, 0.1, 1], [2, 0.1, -2], [0, 0.1, -2]])
    clear = Material("glass", np.float32([[[1, 1, 1, 0.5]]]), alpha_mode="BLEND")
    asset = asset_of(Part(floor, FACES), Part(wall, FACES), Part(glass, FACES, material=clear))
    low = Mesh(floor, np.arange(4), QUAD_UV, FACES)
    grouping = Grouping(Groups((Group(),), np.zeros(2, int)), np.array([0, -1, -1]))
    baked = bake(asset, low, size=32, grouping=grouping, occlusion=True)
    d = where(low, 32)[..., 0]
    want = 1 - (1 - d / np.hypot(d, height)) / 2
    assert np.abs(baked.occlusion[..., 0] - want).mean() < 0.02  # 128 rays a texel
    assert np.abs(baked.occlusion[..., 0].mean(0) - want.mean(0)).max() < 0.01
    assert bake(asset, low, size=8, grouping=grouping).occlusion is None


def test_the_darker_of_both_occlusions_counts_and_convex_things_have_none():
    p, f = sphere(2000)
    q, g = sphere(200)
    low, _ = unwrap(q, g, atlas_size=32)
    own = Material("m", occlusion=np.full((1, 1, 1), 0.25, np.float32))
    assert bake(asset_of(Part(p, f)), low, size=32, occlusion=True).occlusion.mean() > 0.97
    np.testing.assert_allclose(
        bake(asset_of(Part(p, f, material=own)), low, size=32, occlusion=True).occlusion, 0.25, atol=1e-6
    )
