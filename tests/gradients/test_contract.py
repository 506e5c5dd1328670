"""
What Mitsuba promises of every integrator: `develop` and `evaluate`.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from . import scenes
from .plugin import Plugin


@pytest.fixture
def scene() -> mi.Scene:
    plugin = Plugin(scenes.scene("cube"))
    with dr.suspend_grad():
        plugin.image(plugin.start, 1, 0)
    return plugin.mi_scene


def test_without_develop_the_image_stays_on_the_film(scene):
    integrator, film = scene.integrator(), scene.sensors()[0].film()
    image = integrator.render(scene, 0, seed=3, spp=4)
    returned = integrator.render(scene, 0, seed=3, spp=4, develop=False)
    assert dr.width(returned) == 0
    assert np.array_equal(film.develop().numpy(), image.numpy())


def test_evaluate_says_whether_to_wait(scene):
    assert scene.integrator().render(scene, 0, seed=3, spp=4).array.state == dr.VarState.Evaluated
    later = scene.integrator().render(scene, 0, seed=4, spp=4, evaluate=False)
    assert later.array.state == dr.VarState.Unevaluated
