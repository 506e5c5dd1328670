"""Steps on the shape through a mesh operation; batches that share an instant."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from support.tiny_meshes import charted_sphere

from mi_simplify.config import load_config
from mi_simplify.fitting import fit
from mi_simplify.fitting.parameters.shape import ShapeSteps
from mi_simplify.fitting.pool import ViewPool
from mi_simplify.latent import latent as latent_module
from mi_simplify.latent.operation import Identity
from mi_simplify.model.model import Model
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.references.reference import CallableReference
from mi_simplify.scenes.views import goniometer

WHITE = np.float32([[[0.8, 0.8, 0.8, 1]]]), np.float32([[[0, 0.5, 0]]]), np.float32([[[0, 0, 1]]])


class Grow(Identity):
    """Rendered is the base, scaled by its one parameter and moved along x with the frame."""

    def __init__(self, model: Model):
        super().__init__(model)
        self.parameters = {"displacement": np.float32([0.8])}

    def positions(self, base, parameters, views):
        lane = dr.arange(mi.UInt32, dr.width(base))
        shift = dr.select(lane % 3 == 0, mi.Float(float(views.frame[0])), 0)
        return base * dr.gather(mi.Float, parameters["displacement"], 0) + shift

    def written(self, model, parameters):
        return replace(model, name=f"grown by {parameters['displacement'][0]:.3f}")


def shot(n=4, frame=0.0):
    views = goniometer(n, np.random.default_rng(0), width=8, height=8, irradiance=np.pi)
    arrays = views.arrays() | {"frame": np.full(n, frame, np.float32)}
    return type(views).from_arrays(arrays, 8, 8)


def test_gradients_of_rendered_positions_reach_base_and_parameters():
    model = Model(charted_sphere(4), *WHITE)
    operation = Grow(model)
    rates = {"vertices": 0.01, "displacement": 0.01}
    steps = ShapeSteps(operation, {"vertices", "displacement"}, rates, 0.0)
    pose = steps.pose(shot(frame=0.5))
    expected = model.mesh.positions * 0.8 + [0.5, 0, 0]
    assert np.allclose(pose.positions.numpy().reshape(-1, 3), expected, atol=1e-6)
    weight = np.random.default_rng(1).normal(size=expected.size).astype(np.float32)
    dr.backward(dr.sum(pose.positions * mi.Float(weight.tolist())))
    steps.step(pose, 1.0)
    assert np.allclose(pose.base.grad.numpy(), 0.8 * weight, atol=1e-5)
    slope = float(pose.parameters["displacement"].grad[0])
    assert np.isclose(slope, weight @ model.mesh.positions.ravel(), rtol=1e-3)
    _, after = steps.values()
    assert np.isclose(after["displacement"][0], 0.8 - 0.01 * np.sign(slope), atol=1e-5)


def test_what_is_not_optimised_stays_and_what_was_is_restored():
    operation = Grow(Model(charted_sphere(4), *WHITE))
    steps = ShapeSteps(operation, {"displacement"}, {"vertices": 1.0, "displacement": 0.01}, 0.3)
    before = steps.state()
    for _ in range(3):
        pose = steps.pose(shot())
        dr.backward(dr.sum(dr.square(pose.positions)))
        steps.step(pose, 1.0)
    after = steps.state()
    assert np.array_equal(after["vertices"]["u"], before["vertices"]["u"])
    assert after["displacement"]["value"][0] < 0.78
    steps.restore(before)
    assert steps.state()["displacement"]["value"][0] == before["displacement"]["value"][0]
    steps.restart({"u": before["vertices"]["u"], "displacement": np.float32([0.5])})
    assert np.allclose(steps.still(shot()).positions.numpy(), 0.5 * steps.values()[0], atol=1e-6)


def test_a_fit_finds_the_parameter_of_an_operation(monkeypatch):
    """Scaled by 0.8 at the start, the sphere is fitted to itself at full size by its one parameter."""
    monkeypatch.setattr(latent_module, "operation_of", Grow)
    model = Model(charted_sphere(8), *WHITE)
    config = load_config(
        overrides=[
            "asset=sample:relic", "optimizer.resolution=48", "optimizer.batch=2", "evaluation.resolution=48",
            "evaluation.every=20", "optimizer.steps=60", "reference.spp=8",
        ]
    )  # fmt: skip
    latent = config.latent.model_copy(update={"optimize": ("displacement",)})
    rates = config.optimizer.rates.model_copy(update={"displacement": 0.01})
    config = config.model_copy(
        update={"latent": latent, "optimizer": config.optimizer.model_copy(update={"rates": rates})}
    )
    result = fit(model, make_reference(model.as_asset(), transport="direct", spp=8), config)
    assert abs(float(result.model.name.removeprefix("grown by ")) - 1) < 0.02
    assert np.array_equal(result.model.mesh.positions, model.mesh.positions)


def test_a_batch_is_of_one_frame_and_film_size():
    """Three frames at two sizes in one pool; every image is its own view's, after a checkpoint too."""

    def draw(n, rng, resolution):
        out = []
        for frame, size in ((0.0, 8), (1.0, 8), (1.0, 4), (2.0, 4)):
            views = goniometer(n, rng, width=2 * size, height=size, irradiance=np.pi)
            out.append(type(views).from_arrays(views.arrays() | {"frame": np.full(n, frame)}, 2 * size, size))
        return out

    def image(views):
        pixels = np.ones((len(views), views.height, views.width, 4), np.float32)
        return pixels * (views.frame.numpy()[:, None, None, None] + views.height)

    pool = ViewPool(CallableReference(image), draw, 32, np.random.default_rng(0))
    pool.grow(4, 8)
    state = pool.state()
    pool = ViewPool(CallableReference(image), draw, 32, np.random.default_rng(5))
    pool.restore(state)
    seen = set()
    for _ in range(40):
        views, images, _ = pool.batch(3)
        frames = set(views.frame.numpy())
        n = max(3, 3 * 8**2 // (views.width * views.height))  # more of those that are small
        assert len(frames) == 1 and len(views) == n and dr.width(images) == n * views.width * views.height
        assert np.all(images.numpy() == frames.copy().pop() + views.height)
        seen.add((frames.pop(), views.height))
    assert seen == {(0, 8), (1, 8), (1, 4), (2, 4)}
