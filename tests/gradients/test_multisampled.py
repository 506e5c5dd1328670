"""Pixels that are shaded once, with more samples of visibility: the image, and its gradient against differences."""

import dataclasses

import numpy as np
import pytest

from . import scenes
from .batched import Batched
from .finite_difference import along, central_difference, compare
from .scenes import film_weights, parameters


@pytest.mark.parametrize("name", ["smooth, seams", "cube"])
def test_geometry_against_differences(name):
    scene = dataclasses.replace(scenes.scene(name), step=0.8)  # wide: every flip of the one sample is noise
    renderer = Batched(scene, shade="pixel")
    for plane in scenes.PLANES:  # nor need its pixel hold a pattern
        renderer.start[plane][:] = renderer.start[plane].mean((0, 1))
    wanted = [p for p in parameters(scene, renderer.start) if p.name in ("scale", "translation x")]
    pairs = compare(
        renderer, name, wanted, film_weights(scene, renderer.shape[0]), spp=64, gradient_spp=32, rounds=(8, 24)
    )
    assert len(pairs) == 2
    assert not [str(p) for p in pairs if not p.passes]


def test_texels_against_differences():
    """Of the same samples, so that nothing is left to chance."""
    scene = scenes.scene("smooth, seams")
    renderer = Batched(scene, shade="pixel", mips="derived")
    adjoint = film_weights(scene, renderer.shape[0])
    gradient = renderer.gradient(adjoint, 8, 3)
    for parameter in (p for p in parameters(scene, renderer.start) if p.group == "texels"):
        difference = np.sum(central_difference(renderer, parameter, 8, 3) * adjoint)
        assert along(gradient, parameter.direction) == pytest.approx(difference, rel=0.005), parameter.name


def test_on_average_as_if_all_samples_were_shaded():
    scene = scenes.scene("two objects")
    all_, one = Batched(scene), Batched(scene, shade="pixel")
    images = np.stack([one.image(one.start, 8, k) for k in range(200)])
    expected = np.mean([all_.image(all_.start, 64, k) for k in range(8)], axis=0)
    error = images.std(0) / np.sqrt(len(images))
    assert np.mean(np.abs(images.mean(0) - expected) < 4 * error + 0.01) > 0.995
    # Coverage has all samples' precision, colour that of one.
    assert np.allclose(one.image(one.start, 8, 0)[..., 3] > 0, all_.image(all_.start, 8, 0)[..., 3] > 0)


def test_centres_alone():
    scene = scenes.scene("cube")
    renderer = Batched(scene, shade="centre")
    image = renderer.image(renderer.start, 1, 0)
    assert np.array_equal(image, renderer.image(renderer.start, 5, 9))  # nothing random
    covered = Batched(scene).image(renderer.start, 256, 0)[..., 3] / np.maximum(renderer.start["opacity"].mean(), 1e-6)
    inside = covered > 0.99 * covered.max()
    assert np.all(image[..., 3][inside] > 0) and np.all(image[..., 3][covered == 0] == 0)
