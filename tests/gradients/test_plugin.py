"""
Gradients of the `direct_edge` plugin through ``mi.render``: a slice here, more under `make slow`, see
:mod:`.test_batched`.
"""

from __future__ import annotations

import dataclasses
import gc

import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.errors import UserError

from . import scenes
from .batched import Batched
from .cases import PROMISED, SECTIONS
from .finite_difference import along, compare
from .plugin import Plugin
from .scenes import Scene, film_weights, parameters

_QUICK = {"spp": 256, "gradient_spp": 32, "rounds": (8, 16)}


@pytest.fixture(autouse=True)
def quiet():
    """Mitsuba's samplers warn about sample counts that they round."""
    level = mi.logger().log_level()
    mi.set_log_level(mi.LogLevel.Error)
    yield
    mi.set_log_level(level)


def _check(renderer: Plugin, scene: Scene, names: tuple[str, ...], **options) -> None:
    wanted = [p for p in parameters(scene, renderer.start) if p.name in names]
    pairs = compare(renderer, scene.name, wanted, film_weights(scene, 1), **(_QUICK | options))
    assert len(pairs) == len(names)
    assert not [str(p) for p in pairs if not p.passes]


@pytest.mark.parametrize(
    "name, rfilter, names",
    [
        ("cube", "box", ("translation x", "texels normal")),
        ("hides itself", "gaussian", ("translation y", "light position")),
    ],
)
def test_slice(name, rfilter, names):
    scene = scenes.scene(name)
    _check(Plugin(scene, rfilter=rfilter), scene, names)


def test_layers():
    """What lies behind translucent faces, and how the camera moves over it."""
    scene = scenes.scene("hides itself")
    _check(Plugin(scene, headlight=False, layers=3), scene, ("translation y", "texels opacity"))


def test_symmetry_plane_through_the_camera():
    """Hidden edges that fall onto the line of a visible one must not count its jump again."""
    scene = scenes.scene("smooth, seams")
    camera = scene.camera | {
        "origin": np.array([[0, 0.6, -3.0]]),
        "target": (0.0, -0.02, 0.01),
        "light": [[0, 2, -3.0]],
    }
    scene = dataclasses.replace(scene, camera=camera, film=(63, 48))
    _check(Plugin(scene), scene, ("translation y",))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("section, turn", [(s, i) for s in PROMISED[1:] for i in range(len(SECTIONS[s]()))])
def test_every_scene(section, turn):
    case = dataclasses.replace(SECTIONS[section]()[turn], rival=False)
    assert not [str(p) for p in case.measure(turn) if not p.passes]


def test_forward_mode_equals_backward_mode():
    scene = scenes.scene("two objects")
    renderer, adjoint = Plugin(scene), film_weights(scene, 1)
    gradient = renderer.gradient(adjoint, 4, 5)
    gc.collect()  # scenes of other tests: forward mode wants none that carries gradients
    for parameter in parameters(scene, renderer.start):
        image = renderer.derivative(parameter.direction, 4, 5).astype(np.float64)
        assert np.sum(image * adjoint) == pytest.approx(along(gradient, parameter.direction), rel=1e-4), parameter.name


def test_forward_mode_and_other_scenes():
    """One that carries gradients stands in the way as long as it lives; none must live for ever."""
    other, renderer = (Plugin(scenes.scene("cube")) for _ in range(2))
    other.gradient(film_weights(other.scene, 1), 1, 0)
    other.attach(tuple(other.start))
    direction = {"positions": np.ones_like(renderer.start["positions"])}
    with pytest.raises(UserError, match="disable the gradients of other scenes"):
        renderer.derivative(direction, 1, 0)
    del other
    gc.collect()
    assert np.abs(renderer.derivative(direction, 1, 0)).max() > 0


def test_both_renderers_show_the_same():
    """Box filter, one layer, light off the camera: colour and coverage of the two renderers agree but for noise."""
    scene = scenes.scene("cube")  # hard edges: Mitsuba computes normals per split vertex, which shows along UV seams
    plain, batched = Plugin(scene, headlight=False), Batched(scene)
    for renderer in (plain, batched):
        renderer.start["normal"][:] = [0, 0, 1]  # Mitsuba's tangent is that of the face
    here, there = (r.image(r.start, 64, 1)[0] for r in (plain, batched))
    difference, level = (np.abs(x).mean((0, 1)) for x in (here - there, there))
    assert (difference < 0.01 * level).all(), difference / level
