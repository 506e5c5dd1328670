"""The loop as a whole, and the promise of the export: what is fitted is what the file shows."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.models import textured_sphere

from mi_simplify.config import load_config
from mi_simplify.errors import ConfigError
from mi_simplify.export import export_model
from mi_simplify.fitting import fit
from mi_simplify.formats.load import load_asset
from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.latent.latent import Latent
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import goniometer


def test_the_exported_file_shows_what_the_latent_renderer_shows(tmp_path):
    """Written, read back, and rendered through Mitsuba's own scene: 45 dB and more, on a film that is not square."""
    model = textured_sphere()
    latent = Latent(model)
    positions = mi.Float(latent.topology.mesh.positions.astype(np.float32).ravel())
    renderer = DeferredRenderer(latent.topology)
    renderer.move(positions)
    views = goniometer(4, np.random.default_rng(0), width=72, height=48, irradiance=np.pi)
    frame = renderer.render(latent.evaluate(positions), latent.textures, views, spp=256, seed=dr.opaque(mi.UInt32, 1))
    image = frame.images()
    file = export_model(model, tmp_path, formats=("glb",))["glb"]
    reference = make_reference(load_asset(file), transport="direct", spp=256).render(views)
    assert reference[..., 3].mean() > 0.1
    assert -10 * np.log10(np.mean((np.clip(image, 0, 1) - np.clip(reference, 0, 1)) ** 2)) > 45


def test_a_fit_comes_closer_and_never_returns_less_than_it_began_with():
    """A sphere that is too small and grey grows into its textured self; and no step at all returns the guess."""
    target = textured_sphere()
    guess = target.transformed(0.9, np.zeros(3))
    reference = make_reference(target.as_asset(), transport="direct", spp=8)
    common = ["asset=sample:relic", "optimizer.resolution=48", "optimizer.batch=2", "evaluation.resolution=48"]
    short = ["evaluation.every=10", "optimizer.steps=40", "optimizer.rates.vertices=0.01", "reference.spp=8"]
    result = fit(guess, reference, load_config(overrides=[*common, *short]))
    radius = lambda model: np.linalg.norm(model.mesh.positions, axis=1).mean()  # noqa: E731
    assert abs(radius(result.model) - radius(target)) < 0.5 * abs(radius(guess) - radius(target))
    judged = [record["psnr"] for record in result.log if "psnr" in record]
    assert judged[-1] > judged[0]
    ruinous = [*common, "evaluation.every=5", "optimizer.steps=10", "optimizer.rates.vertices=2.0"]
    assert fit(target, reference, load_config(overrides=ruinous)).model is target
    assert fit(guess, reference, load_config(overrides=[*common, "optimizer.steps=0"])).model is guess


def test_a_fit_with_soft_outlines_moves_what_a_hard_one_cannot_reach():
    """Soft for the first half, exact for the second; a transparent model is refused."""
    target = textured_sphere()
    guess = target.transformed(0.9, np.zeros(3))
    reference = make_reference(target.as_asset(), transport="direct", spp=8)
    config = load_config(
        overrides=[
            "asset=sample:relic", "optimizer.resolution=48", "optimizer.batch=2", "evaluation.resolution=48",
            "evaluation.every=20", "optimizer.steps=40", "optimizer.rates.vertices=0.01", "reference.spp=8",
            "optimizer.visibility=hard_soft", "optimizer.hard_soft.radius=0.05", "optimizer.hard_soft.until=0.5",
        ]
    )  # fmt: skip
    result = fit(guess, reference, config)
    radius = lambda model: np.linalg.norm(model.mesh.positions, axis=1).mean()  # noqa: E731
    assert abs(radius(result.model) - radius(target)) < 0.5 * abs(radius(guess) - radius(target))
    with pytest.raises(ConfigError, match="optimizer.visibility"):
        fit(replace(guess, alpha_mode="MASK"), reference, config)
