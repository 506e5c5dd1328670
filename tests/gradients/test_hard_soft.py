"""
Soft outlines: the image's own derivative, its values, and what is left of it with a small radius.
"""

from __future__ import annotations

import numpy as np
import pytest

from mi_simplify.integrators.soft.hard_soft import HardSoftRenderer
from mi_simplify.model.mesh import Mesh

from . import scenes
from .batched import Batched
from .finite_difference import along, compare, shifted
from .scenes import Scene, film_weights, parameters


def soft(scene: Scene, **options) -> Batched:
    renderer = Batched(scene)
    renderer.renderer = HardSoftRenderer(renderer.topology, **options)
    return renderer


def square(h: float = 0.5) -> Batched:
    corners = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])
    uvs = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
    mesh = Mesh(corners, np.arange(4), uvs, np.array([[0, 1, 2], [0, 2, 3]]))
    camera = {"origin": [[0, 0, -3]], "target": [0.0, 0, 0], "light": [[0, 1, -3]], "fov": 40}
    renderer = soft(Scene("square", (mesh,), camera, (60, 40)), radius=0.1)
    renderer.start["opacity"][:] = 1
    return renderer


def check(name: str, *wanted: str, within: float = 0.01) -> None:
    """
    The derivative of the same samples as a small difference has, wherever this image does not jump either: a few
    pixels do, where folds and outlines meet within the radius.
    """
    renderer = soft(scenes.scene(name))
    adjoint = film_weights(renderer.scene, renderer.shape[0])
    wanted_ones = [p for p in parameters(renderer.scene, renderer.start) if p.name in wanted]
    assert len(wanted_ones) == len(wanted)
    here = renderer.image(renderer.start, 8, 1).astype(np.float64)
    pairs = []
    for p in wanted_ones:
        eps = 0.02 * p.eps
        low, high = (renderer.image(shifted(renderer.start, p.direction, s), 8, 1) for s in (-eps, eps))
        smooth = (np.abs(low - 2 * here + high) < 5e-4).all(axis=3, keepdims=True)
        assert smooth.mean() > 0.998
        weights = np.where(smooth, adjoint, 0).astype(np.float32)
        difference = np.sum((high.astype(np.float64) - low) / (2 * eps) * weights)
        pairs.append((p.name, difference, along(renderer.gradient(weights, 8, 1), p.direction)))
    least = 0.1 * np.sqrt(np.mean([difference**2 for _, difference, _ in pairs]))
    assert not [pair for pair in pairs if abs(pair[2] - pair[1]) > within * max(abs(pair[1]), least)]


def test_the_gradient_is_that_of_the_image():
    check("three faces an edge", "rotation", "scale", "along normals", "one vertex", "camera position")


#: Scenes in which outlines come so close to each other that the soft image jumps, which its gradient does not see
#: (hard_soft.py): how far it may be off there.
_JUMPS = {"smooth, seams": 0.03, "thin tube": 0.08}


@pytest.mark.slow
@pytest.mark.parametrize("name", scenes.NAMES)
def test_the_gradient_in_other_scenes(name):
    wanted = ("translation x", "translation y", "rotation", "scale", "along normals", "camera position")
    check(name, *wanted, within=_JUMPS.get(name, 0.01))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cube", "hides itself"])
def test_the_gradient_over_a_wide_step(name):
    """The mean over all samples, jumps included."""
    renderer = soft(scenes.scene(name))
    wanted = [p for p in parameters(renderer.scene, renderer.start) if p.name in ("translation x", "camera position")]
    adjoint = film_weights(renderer.scene, renderer.shape[0])
    pairs = compare(renderer, name, wanted, adjoint, spp=64, gradient_spp=64, rounds=(8, 32))
    assert not [str(p) for p in pairs if not p.passes]


def test_without_a_radius_it_is_the_hard_image():
    scene = scenes.scene("two objects")
    hard = Batched(scene)
    expected = hard.image(hard.start, 4, 1)
    off = []
    for radius in (0.1, 0.02, 0.004):
        renderer = soft(scene, radius=radius)
        off.append(np.abs(renderer.image(renderer.start, 4, 1) - expected).mean())
    assert off[0] > 3 * off[1] > 9 * off[2] > 0
    renderer = soft(scene, radius=1e-6)
    np.testing.assert_allclose(renderer.image(renderer.start, 4, 1), expected, atol=1e-6)


def test_an_outline_is_a_logistic_step_and_keeps_the_width():
    renderer = square()
    alpha = renderer.image(renderer.start, 256, 1)[0, ..., 3]
    half = 60 / (2 * 3 * np.tan(np.radians(20))) * 0.5  # of the square on the film [pixels]
    assert alpha[20].sum() == pytest.approx(2 * half, rel=2e-3)
    sigma, reach = 0.1 * 30 / 7, 0.1 * 30
    x = (np.arange(60 * 256) + 0.5) / 256 - 30
    d = np.abs(x) - half  # outside > 0
    low = 1 / (1 + np.exp(reach / sigma))
    w = np.maximum((1 / (1 + np.exp(np.abs(d) / sigma)) - low) / (1 - 2 * low), 0)
    expected = np.where(d > 0, w, 1 - w).reshape(60, 256).mean(1)
    np.testing.assert_allclose(alpha[18:22].mean(0), expected, atol=0.01)


def test_forward_mode_equals_backward_mode():
    scene = scenes.scene("two objects")
    renderer = soft(scene, radius=0.03)
    adjoint = film_weights(scene, renderer.shape[0])
    gradient = renderer.gradient(adjoint, 4, 5)
    for parameter in parameters(scene, renderer.start):
        image = renderer.derivative(parameter.direction, 4, 5).astype(np.float64)
        expected = along(gradient, parameter.direction)
        assert np.sum(image * adjoint) == pytest.approx(expected, rel=2e-3, abs=1e-2), parameter.name


def test_nothing_in_view():
    scene = scenes.scene("cube")
    renderer = soft(scene)
    renderer.start["positions"] = renderer.start["positions"] + [100, 0, 0]
    adjoint = np.ones(renderer.shape, np.float32)
    assert np.abs(renderer.image(renderer.start, 4, 0)).max() == 0
    gradient = renderer.gradient(adjoint, 4, 0, attach=("positions", "camera"))
    assert np.abs(gradient["positions"]).max() == 0 and np.abs(gradient["camera"]).max() == 0
