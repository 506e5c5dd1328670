"""Gradients through mip levels, derived and custom, against finite differences."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.latent.surface import MeshTopology
from mi_simplify.latent.textures import Textures
from mi_simplify.machine.upload import upload
from mi_simplify.model.mesh import Mesh
from mi_simplify.scenes.views import look_at

from . import scenes
from .batched import Batched
from .finite_difference import compare
from .scenes import film_weights, parameters

_FEW = {
    "smooth, seams": ("scale", "texels base_color", "texels normal", "camera position"),
    "cube": ("along normals", "texels roughness"),
}


def renderer(name: str, mips: str) -> Batched:
    """A scene whose texels are smaller than its pixels, by two levels and a half."""
    return Batched(dataclasses.replace(scenes.scene(name), n_texels=256), mips=mips)


@pytest.mark.parametrize("name", ["cube", pytest.param("smooth, seams", marks=pytest.mark.slow)])
def test_through_derived_levels(name):
    batched = renderer(name, "derived")
    wanted = [p for p in parameters(batched.scene, batched.start) if p.name in _FEW[name]]
    adjoint = film_weights(batched.scene, batched.shape[0])
    pairs = compare(batched, name, wanted, adjoint, spp=256, gradient_spp=32, rounds=(8, 12))
    assert len(pairs) == len(_FEW[name])
    assert not [str(p) for p in pairs if not p.passes]


def test_every_custom_level_has_its_own_gradient():
    batched = renderer("smooth, seams", "custom")
    adjoint, start = film_weights(batched.scene, batched.shape[0]), batched.start
    seed = dr.opaque(mi.UInt32, 3)
    _, views, surface, textures = batched._place(start)
    frame = batched.renderer.render(surface, textures, views, spp=16, seed=seed)
    grad = upload(mi.Vector4f, adjoint.reshape(-1, 4))
    texels = batched.renderer.backward(frame, grad, surface, textures, mi.Float(0), seed)
    gradient = texels.by_parameters(textures).spread_out(textures).numpy().astype(np.float64)
    data, rng = textures.data.numpy().copy(), np.random.default_rng(0)
    places = np.concatenate([np.full(dr.width(textures.places(k)), k) for k in range(textures.n_levels)])
    order = np.concatenate([textures.places(k).numpy() for k in range(textures.n_levels)])
    felt = 0
    for level in range(textures.n_levels):
        direction = np.zeros((len(data) // 12, 12))
        # Of colours and opacity, in which an image is all but linear.
        direction[order[places == level], :3] = rng.uniform(0.5, 1, (np.sum(places == level), 3))
        direction[order[places == level], 8] = 0.5
        images = []
        for step in (-0.05, 0.05):
            textures.data = upload(mi.Float, data + step * direction.ravel())
            images.append(batched.renderer.render(surface, textures, views, spp=16, seed=seed).image.numpy())
        difference = np.sum((images[1].astype(np.float64) - images[0]).T.reshape(adjoint.shape) * adjoint) / 0.1
        ours = np.sum(gradient * direction.ravel())
        if abs(difference) < 1:
            assert abs(ours - difference) < 0.01
        else:
            assert ours == pytest.approx(difference, rel=0.01)
            felt += 1
    assert felt >= 3


def test_level_is_that_of_a_pixel():
    """A square of 256² texels that fills a film of 64² is read at level 2, turned by 60° at level 3: blue marks it."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    uvs = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
    square = Mesh(corners, np.arange(4), uvs, np.array([[0, 1, 2], [0, 2, 3]]))
    levels = [material(256 >> k, k / 8) for k in range(9)]
    textures = Textures(*levels[0].values(), mips="custom", coarser=levels[1:])
    renderer = DeferredRenderer(MeshTopology(square, density=True))
    positions = upload(mi.Float, corners.ravel())
    renderer.move(positions)
    fov = 2 * np.degrees(np.arctan(1 / 4))
    for angle, expected in ((0, 2), (60, 3)):
        camera = [4 * np.sin(np.radians(angle)), 0, 4 * np.cos(np.radians(angle))]
        views = look_at(camera, [0, 0, 0], [0, 0, 4], width=64, height=64, fov=fov, irradiance=np.pi)
        surface = renderer.topology.surface(positions)
        frame = renderer.render(surface, textures, views, spp=1, seed=dr.opaque(mi.UInt32, 0))
        red, _, blue, _ = frame.image.numpy().reshape(4, 64, 64)[:, 31, 31]
        assert blue / red == pytest.approx(expected / 8, abs=0.01)  # 4 % of white are mirrored


def material(n: int, blue: float) -> dict:
    """Diffuse, red 1 and this much blue."""
    base = np.broadcast_to(np.float32([1, 0, blue, 1]), (n, n, 4))
    specular = np.broadcast_to(np.float32([0, 1, 0]), (n, n, 3))
    return dict(base_color=base, specular=specular, normal=np.broadcast_to(np.float32([0, 0, 1]), (n, n, 3)))
