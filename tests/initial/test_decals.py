"""Layers that are blended over a surface are baked into it, from above and from below."""

from dataclasses import replace

import numpy as np
import pytest
from support.parts import FACES, LOW, QUAD, QUAD_UV, asset_of, grid, painted

from mi_simplify.initial.bake.baker import bake
from mi_simplify.initial.bake.decals import NEAR
from mi_simplify.initial.guess import alpha_of, first_guess
from mi_simplify.model.asset import Material, Part

DIAGONAL = np.sqrt(8)
RED, GREY = np.float32([0.8, 0.1, 0.1]), np.float32([0.4, 0.4, 0.4])


def decal(height, opacity=0.75, rgb=RED, roughness=0.2, mode="BLEND"):
    """A square of that opacity in the middle of a sheet at a height, and nothing around it."""
    base = np.ones((16, 16, 4), np.float32) * [*rgb, 0]
    base[4:12, 4:12, 3] = opacity
    material = Material("decal", np.float32(base), np.float32([[[0, roughness, 0]]]), alpha_mode=mode)
    return Part(QUAD + [0, 0, height], FACES, uvs=QUAD_UV, material=material)


BODY = Part(QUAD, FACES, uvs=QUAD_UV, material=painted(GREY, roughness=0.6))


@pytest.mark.parametrize("lift", [0.2, 0.9])
@pytest.mark.parametrize("low", [0, 1])
def test_a_decal_is_part_of_the_surface_that_it_lies_on(lift, low):
    """Whether the low-poly surface is the body's or the decal's: the same texels, and nothing transparent."""
    height = lift * NEAR * DIAGONAL
    mesh = replace(LOW, positions=QUAD + [0, 0, low * height])
    baked = bake(asset_of(BODY, decal(height)), mesh, size=16, samples=1)
    np.testing.assert_allclose(baked.base_color[..., 3], 1, atol=1e-6)
    inner, outer = baked.base_color[5:11, 5:11, :3], baked.base_color[:3, :, :3]
    np.testing.assert_allclose(inner, np.broadcast_to(0.75 * RED + 0.25 * GREY, inner.shape), atol=1e-5)
    np.testing.assert_allclose(outer, np.broadcast_to(GREY, outer.shape), atol=1e-5)
    assert np.allclose(baked.specular[5:11, 5:11, 1], 0.75 * 0.2 + 0.25 * 0.6, atol=1e-5)
    assert np.allclose(baked.specular[:3, :, 1], 0.6, atol=1e-5)
    np.testing.assert_allclose(baked.height, 0, atol=1e-5)


def test_two_decals_lie_over_each_other():
    asset = asset_of(BODY, decal(1e-3, 0.5), decal(2e-3, 0.5, rgb=[0, 0, 1]))
    inner = bake(asset, LOW, size=16, samples=1).base_color[5:11, 5:11]
    expected = 0.5 * np.array([0, 0, 1]) + 0.25 * RED + 0.25 * GREY
    np.testing.assert_allclose(inner, np.broadcast_to([*expected, 1], inner.shape), atol=1e-5)


@pytest.mark.parametrize("mode, height", [("BLEND", 0.05), ("MASK", 1e-3)])
def test_a_pane_farther_away_and_a_mask_stay_as_they_are(mode, height):
    asset = asset_of(BODY, decal(height, mode=mode))
    above = bake(asset, replace(LOW, positions=QUAD + [0, 0, height]), size=16, samples=1).base_color
    assert (above[:3, :, 3] == 0).all() and np.allclose(above[5:11, 5:11, 3], 0.75 if mode == "BLEND" else 1, atol=1e-6)
    below = bake(asset, LOW, size=16, samples=1).base_color
    np.testing.assert_allclose(below, np.broadcast_to([*GREY, 1], below.shape), atol=1e-5)


def test_a_surface_that_faces_away_is_no_layer():
    back = replace(BODY, vertices=QUAD - [0, 0, 1e-3], faces=FACES[:, ::-1])
    baked = bake(asset_of(back, decal(0.0)), LOW, size=16, samples=1)
    assert (baked.base_color[:3, :, 3] == 0).all() and np.allclose(baked.base_color[5:11, 5:11, 3], 0.75, atol=1e-6)


def test_a_body_with_a_decal_gives_an_opaque_model():
    p, f = grid(20, lambda x, y: 0.1 * np.sin(3 * x) * np.cos(2 * y))
    uvs = np.float32(p[:, :2] / 2 + 0.5)
    body = Part(p, f, uvs=uvs, material=painted(GREY))
    label = replace(decal(0), vertices=p + [0, 0, 2e-3], faces=f, uvs=uvs)
    asset = asset_of(body, label)
    model, _ = first_guess(asset, triangles=300, atlas_size=256)
    assert model.alpha_mode == "OPAQUE"
    reddest = np.quantile(model.base_color[..., 0] - model.base_color[..., 1], 0.95)
    assert 0.3 < reddest < 0.6
    assert alpha_of(asset, np.float32([[[0, 0, 0, 0.5]]]))[0] == "BLEND"
