"""
The plugin `hard_soft`: the batched renderer's image in a plain Mitsuba scene, and the derivative of that image.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.errors import UserError

from . import scenes
from .finite_difference import along, shifted
from .plugin import Plugin
from .scenes import film_weights, parameters
from .test_hard_soft import soft

SPP, SEED = 8, 1


def test_it_softens_as_the_batched_renderer_does():
    """The coverage of an opaque scene is that of the weights alone; colours are looked up by Mitsuba's bitmaps here."""
    scene = scenes.scene("two objects")
    plugin, hard = (Plugin(scene, type="hard_soft", radius=radius) for radius in (0.05, 1e-6))
    batched = soft(scene, radius=0.05)
    start, batched.views = plugin.start, plugin.views.take(np.arange(1))
    start["opacity"][:] = 1
    hard.start = start
    ours, expected, without = (r.image(start, 16, SEED)[..., 3] for r in (plugin, batched, hard))
    softening = np.abs(expected - without).mean()
    assert softening > 5e-3
    assert np.abs(ours - expected).mean() < 0.05 * softening


def test_the_gradient_is_that_of_the_image():
    """Of the same samples, wherever this image does not jump itself: see :mod:`.test_hard_soft`."""
    plugin = Plugin(scenes.scene("three faces an edge"), type="hard_soft")
    adjoint = film_weights(plugin.scene, 1)
    wanted = ("rotation", "along normals", "camera position")
    here, pairs = plugin.image(plugin.start, SPP, SEED + 1).astype(np.float64), []
    for p in (p for p in parameters(plugin.scene, plugin.start) if p.name in wanted):
        eps = 0.02 * p.eps
        low, high = (plugin.image(shifted(plugin.start, p.direction, s), SPP, SEED + 1) for s in (-eps, eps))
        smooth = (np.abs(low - 2 * here + high) < 5e-4).all(axis=3, keepdims=True)
        assert smooth.mean() > 0.99
        weights = np.where(smooth, adjoint, 0).astype(np.float32)
        difference = np.sum((high.astype(np.float64) - low) / (2 * eps) * weights)
        gradient = plugin.gradient(weights, SPP, SEED, attach=("positions", "camera"))
        pairs.append((p.name, difference, along(gradient, p.direction)))
    assert len(pairs) == len(wanted)
    least = 0.1 * np.sqrt(np.mean([difference**2 for _, difference, _ in pairs]))
    assert not [pair for pair in pairs if abs(pair[2] - pair[1]) > 0.01 * max(abs(pair[1]), least)]


@pytest.mark.parametrize(
    ("options", "line"),
    [({"layers": 2}, "sees one surface"), ({"radius": 0.0}, "should be above 0"), ({"delta": -0.1}, "delta -0.1")],
)
def test_what_it_cannot_do_is_one_line(options, line):
    with pytest.raises(Exception, match=line) as caught:
        mi.load_dict({"type": "hard_soft", **options})
    assert isinstance(caught.value, UserError) or "UserError" in str(caught.value)


def test_other_shapes_are_refused():
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "hard_soft"}, "ball": {"type": "sphere"},
                          "sensor": {"type": "perspective"}})  # fmt: skip
    with pytest.raises(UserError, match="no triangle mesh"):
        scene.integrator().render(scene, scene.sensors()[0], spp=1)
