"""Fixed views of a shape that stays: what is kept shows and derives the same as what is rendered anew."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.models import random_sphere

from mi_simplify import cli
from mi_simplify.config import Config, load_config
from mi_simplify.fitting.fit import Fit
from mi_simplify.fitting.kept import KeptStep
from mi_simplify.fitting.stages import STAGES, can_keep, explained
from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.integrators.kept import gradient_of, image_of, keep
from mi_simplify.machine.reactive import Reactive, Stage, affected
from mi_simplify.scenes.references.fixed import FixedViews
from mi_simplify.scenes.references.reference import CallableReference
from mi_simplify.scenes.views import goniometer


def views_of(n=2, side=16, seed=3):
    return goniometer(n, np.random.default_rng(seed), width=side, height=side)


def grey(views):
    return np.full((len(views), views.height, views.width, 4), 0.5, np.float32)


def fit_of(*names, **latent):
    settings = {
        "asset": "none", "reference": {"refresh": 0, "pool": 2}, "latent": {"optimize": names, **latent},
        "optimizer": {"resolution": 16, "batch": 2, "steps": 100}, "evaluation": {"views": 2, "resolution": 16},
    }  # fmt: skip
    return Fit(random_sphere(), FixedViews(CallableReference(grey), views_of()), Config.model_validate(settings))


@pytest.mark.parametrize("shade", ["sample", "pixel"])
def test_image_and_gradient_are_those_of_the_renderer(shade):
    fit, views, seed = fit_of("base_color"), views_of(), mi.UInt32(5)
    textures, form = fit.latent.textures, "gltf"
    positions, surface = fit._moved(views)
    renderer = DeferredRenderer(fit.latent.topology, shade=shade)
    renderer.move(positions)
    frame = renderer.render(surface, textures, views, spp=3, seed=dr.opaque(mi.UInt32, 5))
    kept = keep(renderer.tracer, surface, textures, views, spp=3, seed=dr.opaque(mi.UInt32, 5), shade=shade)
    channels = tuple(range(textures.n_channels))
    image = image_of(kept, textures, channels, None, form)
    np.testing.assert_allclose(image.numpy(), frame.image.numpy(), atol=2e-5)
    grad = mi.Vector4f(*np.random.default_rng(1).normal(size=(4, dr.width(image))).astype(np.float32))
    texel, values = gradient_of(kept, textures, channels, None, form, grad)
    ours = np.zeros((textures.n_stored, textures.n_channels), np.float32)
    ours[texel.numpy()] = values.numpy().T
    theirs = renderer.backward(frame, grad, surface, textures, positions, seed).spread_out(textures).numpy()
    np.testing.assert_allclose(ours.ravel(), theirs, atol=2e-4 * np.abs(theirs).max())


@pytest.mark.parametrize("names", [("normal",), ("base_color", "roughness")])
def test_a_kept_step_changes_the_named_channels_alone_and_normals_stay_unit(names):
    fit = fit_of(*names)
    before = fit.latent.textures.images()
    for k in range(3):
        fit.step(k)
    after = fit.latent.textures.images()
    changed = {
        "base_color": np.abs(after["base_color"] - before["base_color"]).max(),
        "roughness": np.abs(after["specular"][..., 1] - before["specular"][..., 1]).max(),
        "metallic": np.abs(after["specular"][..., 2] - before["specular"][..., 2]).max(),
        "normal": np.abs(after["normal"] - before["normal"]).max(),
    }
    assert {name for name, change in changed.items() if change > 1e-6} == set(names)
    data = fit.latent.textures.data.numpy().reshape(-1, fit.latent.textures.n_channels)[:, 5:8]
    length = np.linalg.norm(data, axis=1)
    assert np.abs(length[length > 0.5] - 1).max() < 1e-5


def test_every_declared_dependency_changes_the_image_and_nothing_else_computes_anything():
    """Each input in turn; the same values again launch no kernel."""
    fit = fit_of("base_color")
    fit.step(0)
    step = next(iter(fit._kept.values()))
    stages = step.stages
    stages.changed("textures")  # by the step
    first = stages.get("image").numpy()
    stages.get("loss")
    stages.computed.clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        stages.get("loss")
        assert not stages.computed and not dr.kernel_history()
    light = dr.opaque(mi.Float, 0.2, 3)
    other = fit_of("base_color")
    other.shape.vertices.restart(other.shape.vertices.state()["u"] * 0.8)
    dr.set_flag(dr.JitFlag.KernelHistory, False)
    for name, value in {
        "views": views_of(seed=4), "samples": dr.opaque(mi.UInt32, 99), "light": light, "vertices": other.shape,
    }.items():  # fmt: skip
        before = stages.get(name)
        stages.computed.clear()
        stages.set(name, value)
        assert np.abs(stages.get("image").numpy() - first).max() > 1e-3, name
        assert stages.computed == [s for s in affected(STAGES, [name]) if s != "loss"]
        stages.set(name, before)
        np.testing.assert_array_equal(stages.get("image").numpy(), first)
    fit.latent.textures.data *= 0.5
    dr.eval(fit.latent.textures.data)
    stages.computed.clear()
    stages.changed("textures")
    assert np.abs(stages.get("image").numpy() - first).max() > 1e-3 and stages.computed == ["image"]
    loss = float(stages.get("loss")[0][0])
    stages.set("targets", (stages.get("targets")[0] * 0.5, mi.Color3f(0)))
    assert abs(float(stages.get("loss")[0][0]) - loss) > 1e-4


def test_two_kept_steps_launch_what_belongs_to_texels_alone():
    fit = fit_of("normal")
    for k in range(3):
        fit.step(k)
    step = next(iter(fit._kept.values()))
    step.stages.computed.clear()
    fit.step(3)
    assert isinstance(step, KeptStep) and step.stages.computed == ["image", "loss"]


def test_stages_are_computed_in_the_order_in_which_they_are_read():
    stages = (Stage("b", ("a",)), Stage("c", ("b", "x")), Stage("d", ("c",)))
    graph = Reactive(stages, {"b": lambda a: a + 1, "c": lambda b, x: b * x, "d": lambda c: -c})
    graph.set("a", 1)
    graph.set("x", 10)
    assert graph.get("d") == -20 and graph.computed == ["b", "c", "d"]
    graph.computed.clear()
    graph.set("x", 11)
    assert graph.get("d") == -22 and graph.computed == ["c", "d"]
    assert affected(stages, ["x"]) == ["c", "d"] and affected(stages, ["a"]) == ["b", "c", "d"]


@pytest.mark.parametrize(
    ("changes", "computed"),
    [
        (["reference.refresh=0", "latent.optimize=normal"], {"image", "loss"}),
        (["reference.refresh=1", "latent.optimize=normal"], {s.name for s in STAGES}),
        (["reference.refresh=0", "latent.optimize=[vertices, normal]"], {s.name for s in STAGES}),
    ],
)
def test_what_a_step_computes_is_explained(changes, computed):
    config = load_config(overrides=["asset=none.glb", *changes])
    rows = explained(config)
    assert {name for name, every, _ in rows if every and not name.startswith("gradient")} == computed
    assert can_keep(config) == (computed == {"image", "loss"})


def test_the_doctor_explains(tmp_path, capsys):
    path = tmp_path / "job.yaml"
    path.write_text("asset: none.glb\nreference: {refresh: 0}\nlatent: {optimize: normal}\n")
    assert cli.main(["doctor", "--explain", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if " hits " in line).startswith("once")
    assert next(line for line in lines if " image " in line).startswith("every step")
    assert cli.main(["doctor", "--explain", str(tmp_path / "none.yaml")]) == 2


def test_no_more_hits_are_kept_than_memory_holds():
    """150 bytes a hit: 128 views of 256² with two samples may have 2.5 GB of them, 1024² are too many."""
    fixed = {"asset": "none", "reference": {"refresh": 0}, "latent": {"optimize": ["normal"]}}
    fits, does_not = (Config.model_validate({**fixed, "optimizer": {"resolution": side}}) for side in (256, 1024))
    assert can_keep(fits) and not can_keep(does_not)
    assert "hits" in [name for name, is_computed, _ in explained(does_not) if is_computed]
