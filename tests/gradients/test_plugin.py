"""
Gradients of the `direct_edge` plugin through ``mi.render``: a slice here, all of it under `make slow`.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from . import scenes
from .batched import Batched
from .cases import PROMISED, SECTIONS
from .finite_difference import compare
from .plugin import Plugin
from .scenes import Scene, film_weights, parameters

_QUICK = {"spp": 256, "gradient_spp": 16, "target": 0.006, "rounds": (4, 8)}


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
    quiet = [p for p in pairs if p.noise < 0.01]
    assert len(quiet) >= len(names) - 1, [str(p) for p in pairs if p not in quiet]
    assert not [str(p) for p in quiet if not p.passes]


@pytest.mark.parametrize("name, rfilter", [("cube", "box"), ("hides itself", "gaussian")])
def test_slice(name, rfilter):
    scene = scenes.scene(name)
    _check(Plugin(scene, rfilter=rfilter), scene, ("translation x", "scale", "rotation", "texels normal"))


def test_layers():
    """What lies behind translucent faces, and how the camera moves over it."""
    scene = scenes.scene("hides itself")
    names = ("translation x", "translation y", "texels opacity")
    _check(Plugin(scene, headlight=False, layers=3), scene, names)


def test_symmetry_plane_through_the_camera():
    """Hidden edges that fall onto the line of a visible one must not count its jump again."""
    scene = scenes.scene("smooth, seams")
    camera = scene.camera | {
        "origin": np.array([[0, 0.6, -3.0]]),
        "target": (0.0, -0.02, 0.01),
        "light": [[0, 2, -3.0]],
    }
    scene = dataclasses.replace(scene, camera=camera, film=(63, 48))
    _check(Plugin(scene), scene, ("translation x", "translation y"), spp=1024)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("section, index", [(s, i) for s in PROMISED[1:] for i in range({"Plugin": 9}.get(s, 11))])
def test_every_pair(section, index):
    cases = SECTIONS[section]()
    if index >= len(cases):
        pytest.skip("no such case")
    case = dataclasses.replace(cases[index], rival=False)
    assert not [str(p) for p in case.measure() if not p.passes]


_FORWARD = """
from mi_simplify import runtime; runtime.ensure_variant()
import numpy as np
from gradients import scenes
from gradients.finite_difference import along
from gradients.plugin import Plugin
scene = scenes.scene("two objects")
renderer, adjoint = Plugin(scene), scenes.film_weights(scene, 1)
gradient = renderer.gradient(adjoint, 4, 5)
for parameter in scenes.parameters(scene, renderer.start):
    image = renderer.derivative(parameter.direction, 4, 5).astype(np.float64)
    forward, backward = np.sum(image * adjoint), along(gradient, parameter.direction)
    assert abs(forward - backward) < 1e-4 * abs(backward), (parameter.name, forward, backward)
"""


def test_forward_mode_equals_backward_mode():
    """
    In a process of its own: after other renders Dr.Jit may refuse the forward pass ("outside of the current
    dr.isolate_grad() scope") although the parameters' own edges are cleared; cause unknown.
    """
    tests = Path(__file__).resolve().parents[1]
    done = subprocess.run([sys.executable, "-c", _FORWARD], cwd=tests, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr


def test_both_renderers_show_the_same():
    """Box filter, one layer, light off the camera: the colours of the two renderers agree but for noise."""
    scene = scenes.scene("cube")  # hard edges: Mitsuba computes normals per split vertex, which shows along UV seams
    plain, batched = Plugin(scene, headlight=False), Batched(scene)
    for renderer in (plain, batched):
        renderer.start["normal"][:] = [0, 0, 1]  # Mitsuba's tangent is that of the face
    here, there = (r.image(r.start, 64, 1)[0, ..., :3] for r in (plain, batched))
    assert np.abs(here - there).mean() < 0.01 * there.mean()
