"""After three steps everything that runs is compiled, whatever changes from step to step."""

import gc
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.config import Config
from mi_simplify.fitting import Fit
from mi_simplify.model.model import Model
from mi_simplify.scenes.references.reference import CallableReference


@pytest.fixture(autouse=True)
def _two_threads():
    """What threads add up in private copies is compiled into kernels, but not for one thread."""
    before = dr.thread_count()
    dr.set_thread_count(2)
    yield
    dr.set_thread_count(before)


def model(n_texels=64) -> Model:
    rng = np.random.default_rng(0)
    base_color, specular = (rng.uniform(0.3, 0.7, (n_texels, n_texels, c)).astype(np.float32) for c in (4, 3))
    normal = np.broadcast_to(np.float32([0, 0, 1]), (n_texels, n_texels, 3))
    # With 768 faces their 2,304 packets were once as many as the texels of the blocks touched, 16 each, and
    # what is equally wide shares a kernel. Here no number of blocks does that.
    return Model(charted_sphere(7, noise=0.05, seed=1), base_color, specular, normal)


def noise(views):
    return np.random.default_rng(len(views)).random((len(views), views.height, views.width, 4), np.float32)


def kernels(step) -> set:
    """Hashes of the kernels that a step runs."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        step()
        dr.sync_thread()
        return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}


@pytest.mark.parametrize(
    ("name", "section"),
    [
        ("defaults", {}),
        ("opacity and gamma", {"latent": {"optimize": ["base_color", "opacity", "gamma", "vertices"]}}),
        ("textures alone", {"latent": {"optimize": ["base_color", "normal"]}, "reference": {"refresh": 1, "pool": 24}}),
        ("kept hits", {"latent": {"optimize": ["base_color", "normal"]}}),
        ("plain Adam, another loss", {"optimizer": {"large_steps": {"enabled": False}}, "loss": {"image": "smape"}}),
        ("custom mips", {"latent": {"mips": "custom"}}),
        ("derived mips", {"latent": {"mips": "derived"}}),
        ("several samples a pixel", {"optimizer": {"spp": 4}}),
        ("one shading sample a pixel", {"optimizer": {"spp": 4, "shade": "pixel"}}),
    ],
)
def test_no_kernel_of_a_fit_is_compiled_after_the_third_step(name, section):
    optimizer = {"batch": 2, "resolution": 32, "spp": 1, "steps": 40} | section.get("optimizer", {})
    settings = {"asset": "none", "reference": {"refresh": 0, "pool": 24}, **section, "optimizer": optimizer}
    fit = Fit(model(), CallableReference(noise), Config.model_validate(settings))
    fit.pool.grow(24, 32)
    # Where hits are kept, a batch of views that comes again has a step of its own.
    first = 12 if name == "kept hits" else 4
    seen = set.union(*(kernels(lambda k=k: fit.step(k)) for k in range(1, first)))
    for k in range(first, first + 11):  # other views, seeds, learning rates and weights in every one
        assert not kernels(lambda k=k: fit.step(k)) - seen, f"step {k} compiled a kernel"


@pytest.mark.parametrize("mode", ["MASK", "BLEND"])
def test_no_kernel_of_transparent_layers_is_compiled_after_the_third_step(mode):
    optimizer = {"batch": 2, "resolution": 32, "spp": 1, "steps": 40}
    latent = {"optimize": ["base_color", "opacity", "vertices"]}
    settings = {"asset": "none", "reference": {"refresh": 0, "pool": 24}, "latent": latent, "optimizer": optimizer}
    fit = Fit(replace(model(), alpha_mode=mode), CallableReference(noise), Config.model_validate(settings))
    fit.pool.grow(24, 32)
    seen = set.union(*(kernels(lambda k=k: fit.step(k)) for k in range(1, 4)))
    for k in range(4, 15):
        assert not kernels(lambda k=k: fit.step(k)) - seen, f"step {k} compiled a kernel"
    fit.judge()
    assert 0 <= fit.unpeeled < 0.05


def test_no_kernel_of_the_plugin_is_compiled_after_the_third_step():
    from mi_simplify.machine.meshes import POSITIONS
    from mi_simplify.scenes.shapes import asset_shapes

    gc.collect()  # kernels call the BSDFs of all scenes that live: those of other tests must not go in between
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct_edge"},
            "light": {"type": "point", "position": [1, 2, 3], "intensity": {"type": "rgb", "value": 5.0}},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 32, "height": 24, "rfilter": {"type": "box"}},
            },
            **asset_shapes(model().as_asset()),
        },
        optimize=False,
    )
    params = mi.traverse(scene)
    key = f"part_0.{POSITIONS}"
    start = mi.Float(params[key])

    def step(k):
        params[key] = start * dr.opaque(mi.Float, 1 + 0.01 * k)
        dr.enable_grad(params[key])
        params["light.position"] = mi.Point3f(dr.opaque(mi.Float, 1 + 0.1 * k), 2, 3)
        params.update()
        dr.backward(dr.mean(mi.render(scene, params, spp=2, seed=k), axis=None))
        dr.eval(dr.grad(params[key]))

    seen = set.union(*(kernels(lambda k=k: step(k)) for k in range(1, 4)))
    for k in range(4, 10):
        assert not kernels(lambda k=k: step(k)) - seen, f"step {k} compiled a kernel"
