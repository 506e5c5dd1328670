"""
Several transparent layers in the batched renderer: values, and gradients against finite differences.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.model.model import Model
from mi_simplify.scenes.references.path_traced import make_reference

from . import scenes
from .batched import Batched
from .finite_difference import along, compare
from .scenes import film_weights, parameters

#: Alpha, colour, shape of one card and of all, cameras.
_WANTED = ("texels opacity", "texels base_color", "scale", "camera position")
_SLOW = ("front object alone", "one vertex", "along normals", "rotation", "texels normal", "light position")


def cards(**options) -> Batched:
    # Of these few edges most samples are worth their while.
    return Batched(scenes.scene("cards"), edge_fraction=1.0, **options)


def measured(renderer: Batched, names: tuple[str, ...], **options) -> list:
    adjoint = film_weights(renderer.scene, renderer.shape[0])
    wanted = [p for p in parameters(renderer.scene, renderer.start) if p.name in names]
    return compare(
        renderer, "cards", wanted, adjoint, **({"spp": 256, "gradient_spp": 32, "rounds": (4, 32)} | options)
    )


@pytest.mark.parametrize("layers", [1, 2, pytest.param(8, marks=pytest.mark.slow)])
def test_gradients_of_cards(layers):
    pairs = measured(cards(layers=layers), _WANTED)
    assert len(pairs) == len(_WANTED)
    assert not [str(p) for p in pairs if not p.passes]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("layers", [2])
def test_gradients_of_one_card_among_others(layers):
    pairs = measured(cards(layers=layers), _SLOW, spp=128, gradient_spp=32, rounds=(8, 384))
    assert len(pairs) == len(_SLOW)
    assert not [str(p) for p in pairs if not p.passes]


@pytest.mark.slow
def test_gradients_of_a_mask_that_is_cut_steeply():
    """What is wholly transparent is no layer, what is opaque ends the ray; both by the opacity as it is cut."""
    renderer = cards(layers=3)
    renderer.steepness = 4.0
    pairs = measured(renderer, ("texels opacity", "scale", "texels base_color"))
    assert not [str(p) for p in pairs if not p.passes]


@pytest.mark.parametrize("layers", [2, 8])
def test_forward_mode_equals_backward_mode(layers):
    scene = scenes.scene("cards")
    renderer = Batched(scene, layers=layers)
    adjoint = film_weights(scene, renderer.shape[0])
    gradient = renderer.gradient(adjoint, 4, 5)
    for parameter in parameters(scene, renderer.start):
        image = renderer.derivative(parameter.direction, 4, 5).astype(np.float64)
        assert np.sum(image * adjoint) == pytest.approx(along(gradient, parameter.direction), rel=1e-4), parameter.name


def test_the_image_is_that_of_a_path_tracer():
    """Direct light through six cards, beside Mitsuba's volumetric path tracer, which counts no layers."""
    renderer = Batched(scenes.scene("cards"), layers=6)
    state = renderer.start
    base = np.concatenate([state["base_color"], state["opacity"]], axis=2).astype(np.float32)
    specular = np.concatenate([state["gamma"], state["roughness"], state["metallic"]], axis=2).astype(np.float32)
    normal = state["normal"] / np.linalg.norm(state["normal"], axis=2, keepdims=True)
    model = Model(renderer.scene.mesh, base, specular, normal.astype(np.float32), "BLEND")
    reference = make_reference(model.as_asset(), transport="direct", spp=256)
    image = renderer.image(state, 256, 3)
    target = reference.render(renderer.views)
    assert np.abs(image - target).mean() < 0.004 * target.mean() + 1e-4
    traced = make_reference(model.as_asset(), transport="baked", spp=256, max_depth=2).render(renderer.views)
    assert np.abs(image[..., 3] - traced[..., 3]).mean() < 0.01


def test_what_lies_beyond_is_counted():
    renderer = Batched(scenes.scene("cards"))
    covered = {}
    for layers in (1, 2, 3):
        deferred = DeferredRenderer(renderer.topology, layers=max(layers, 2))
        renderer.renderer = deferred
        _, views, surface, textures = renderer._place(renderer.start)
        frame = deferred.render(surface, textures, views, spp=16, seed=mi.UInt32(1))
        covered[max(layers, 2)] = float(np.sum(frame.image.w.numpy())), float(np.sum(frame.unpeeled.numpy()))
    assert covered[2][0] + covered[2][1] == pytest.approx(covered[3][0], rel=1e-3)
    assert covered[3][1] < covered[2][1]


def test_cards_seen_edge_on_and_layers_that_touch_do_not_repeat():
    """A quad's diagonal, and rays along surfaces: no layer is met twice, so coverage is that of the opacity."""
    scene = scenes.scene("cards")
    quad = scene.pieces[0]
    renderer = Batched(scenes.Scene("one", (quad,), scene.camera, (64, 48)), layers=8)
    renderer.start["opacity"][:] = 0.5
    image = renderer.image(renderer.start, 64, 1)
    assert image[..., 3].max() <= 0.5 + 1e-5
    inside = image[..., 3] > 0.45
    np.testing.assert_allclose(image[inside][:, 3].max(), 0.5, atol=1e-5)
