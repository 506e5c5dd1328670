"""Several vertex sets over one topology: blending, gradients, the fit, and morph targets."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree
from support.models import random_sphere as plain_model

from mi_simplify.config import load_config
from mi_simplify.errors import ConfigError
from mi_simplify.export import export_model
from mi_simplify.fitting import Fit
from mi_simplify.formats.gltf.file import GltfFile
from mi_simplify.latent.latent import Latent
from mi_simplify.latent.vertex_sets import Blended, blend_weights, blended
from mi_simplify.machine.upload import upload
from mi_simplify.model.model import Model, VertexSets
from mi_simplify.scenes.references.reference import CallableReference
from mi_simplify.scenes.views import look_at

SIZES = (64.0, 32.0, 16.0)


def model(seed=0) -> Model:
    start = plain_model(seed)
    offsets = np.random.default_rng(seed).normal(size=(2, *start.mesh.positions.shape)) * 0.1
    return Model(start.mesh, start.base_color, start.specular, start.normal, vertex_sets=VertexSets(SIZES, offsets))


def views(size):
    return look_at([[0, 0.5, 4]], [0, 0, 0], [[1, 2, 4]], width=size, height=size, irradiance=np.pi)


@pytest.mark.parametrize(
    ("size", "weights"),
    [(64, (1, 0, 0)), (32, (0, 1, 0)), (16, (0, 0, 1)), (8, (0, 0, 1)), (500, (1, 0, 0)), (64 / 2**0.5, (0.5, 0.5, 0))],
)
def test_weights_go_by_the_logarithm_of_the_size(size, weights):
    assert blend_weights(SIZES, size) == pytest.approx(weights, abs=1e-6)


def test_no_popping():
    """Between neighbouring sizes the surface moves by little, however far the sets are apart."""
    start = model()
    moved = [blended(start, size).mesh.positions for size in range(12, 80)]
    steps = [np.abs(a - b).max() for a, b in zip(moved, moved[1:], strict=False)]
    assert max(steps) < 0.1 * np.abs(start.vertex_sets.offsets).max() + 0.05


def test_the_device_blends_alike_and_its_derivatives_are_those_of_differences():
    start, rng = model(), np.random.default_rng(3)
    operation = Blended(start)
    for size in (64, 44, 32, 24, 12):
        base = upload(mi.Float, start.mesh.positions.ravel())
        sets = upload(mi.Float, operation.parameters["vertex_sets"])
        dr.enable_grad(base, sets)
        out = operation.positions(base, {"vertex_sets": sets}, views(size))
        assert np.allclose(out.numpy().reshape(-1, 3), blended(start, size).mesh.positions, atol=1e-6)
        weight = rng.normal(size=dr.width(out))
        dr.backward(dr.sum(out * upload(mi.Float, weight)))
        direction = rng.normal(size=start.vertex_sets.offsets.shape)
        values = []
        for step in (-1e-3, 1e-3):
            moved = VertexSets(SIZES, start.vertex_sets.offsets + step * direction)
            there = blended(Model(start.mesh, start.base_color, start.specular, start.normal, vertex_sets=moved), size)
            values.append(np.sum(there.mesh.positions.ravel() * weight))
        difference = (values[1] - values[0]) / 2e-3
        assert np.sum(dr.grad(sets).numpy() * direction.ravel()) == pytest.approx(difference, rel=1e-3, abs=1e-4)
        assert np.allclose(dr.grad(base).numpy(), weight, atol=1e-5)


def test_each_set_is_fitted_by_the_sizes_that_show_it():
    """A reference that is larger where it is seen small: the far set grows, the near one does not."""
    start = plain_model(size=16)
    zero = VertexSets((32.0, 16.0), np.zeros((1, *start.mesh.positions.shape)))
    start = Model(start.mesh, start.base_color, start.specular, start.normal, vertex_sets=zero)

    def grown(v):
        scale = 1.0 if v.width == 32 else 1.15
        from mi_simplify.judging.screen import Screen

        bigger = Model(start.mesh, start.base_color, start.specular, start.normal).transformed(scale, np.zeros(3))
        return Screen(bigger, mips="none").images(v, spp=16)

    config = load_config(None, [
        "asset=none", "optimizer.resolution=32", "optimizer.least_resolution=16", "optimizer.steps=40",
        "optimizer.batch=2", "optimizer.rates.vertex_sets=0.02", "optimizer.rates.vertices=0.003", "reference.pool=64",
        "reference.refresh=1", "latent.optimize=[vertices, vertex_sets]", "evaluation.views=1",
    ])  # fmt: skip
    fit = Fit(start, CallableReference(grown), config)
    for k in range(40):
        fit.step(k)
    result = fit.model()
    radius = [np.linalg.norm(blended(result, size).mesh.positions, axis=1).mean() for size in (32, 16)]
    before = np.linalg.norm(start.mesh.positions, axis=1).mean()
    assert radius[1] / before > 1.08 and abs(radius[0] / before - 1) < 0.06
    assert Latent(result).operation.parameters["vertex_sets"].any()


def test_sets_are_morph_targets_and_mips_are_images(tmp_path):
    start = model()
    export_model(start, tmp_path, formats=("glb",))
    file = GltfFile(tmp_path / "model.glb", [])
    mesh = file.item("meshes", 0)
    targets = mesh["primitives"][0]["targets"]
    assert mesh["extras"] == {"targetNames": ["32 px", "16 px"], "imageSizes": list(SIZES)}
    assert mesh["weights"] == [0, 0]
    points = file.accessor(mesh["primitives"][0]["attributes"]["POSITION"])
    distance, vertex = cKDTree(start.mesh.vertices).query(points)  # the file has an order of its own
    assert distance.max() < 1e-6
    for k, target in enumerate(targets):
        moved = points + file.accessor(target["POSITION"])
        expected = blended(start, SIZES[k + 1]).mesh.vertices[vertex]
        assert np.allclose(moved, expected, atol=1e-5)
    custom = Latent(plain_model(size=16), mips="custom")
    export_model(custom.model(start.mesh.positions), tmp_path / "mipped", formats=("glb",))
    for level in range(5):
        with Image.open(tmp_path / "mipped" / "mips" / f"normal_{level}.png") as image:
            assert image.size == (16 >> level, 16 >> level)


def test_sets_need_several_sizes():
    with pytest.raises(ConfigError, match="set `optimizer.least_resolution`"):
        load_config(None, ["asset=a.obj", "initial.vertex_sets=2"])
