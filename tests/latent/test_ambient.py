"""The ambient light of the latent model: values, derivatives, its way into files and back, and finding it."""

import json
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from support.models import rendered, textured_sphere

from mi_simplify.config import load_config
from mi_simplify.export import export_model
from mi_simplify.fitting import Fit
from mi_simplify.formats.load import load_asset
from mi_simplify.machine.upload import upload
from mi_simplify.model.color import srgb_to_linear
from mi_simplify.model.model import Model
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import goniometer

AMBIENT = np.float32([[0.3, 0.1, 0.5]])


@pytest.fixture(scope="module")
def model() -> Model:
    return textured_sphere()


def test_both_renderers_show_the_same_ambient_light(model):
    views = goniometer(2, np.random.default_rng(1), width=32, height=32, irradiance=np.pi)
    lit = rendered(model, views.under(upload(mi.Float, AMBIENT.ravel()))).images()
    plain = make_reference(model.as_asset(), transport="direct", spp=64).render(views)
    ambient = make_reference(model.as_asset(), transport="direct", spp=64, ambient=AMBIENT).render(views)
    covered = plain[..., 3] == 1
    assert np.abs((ambient - plain)[covered][:, :3]).mean() > 0.02
    np.testing.assert_array_equal(ambient[..., 3], plain[..., 3])
    assert np.abs(lit - ambient)[covered].mean() < 4e-3


def test_the_ambient_light_is_found_beside_textures_and_shape(model):
    """A reference lit by a light that the fit does not know."""
    reference = make_reference(model.as_asset(), transport="direct", spp=4, ambient=AMBIENT)
    overrides = ["asset=x", "optimizer.resolution=32", "optimizer.batch=4", "optimizer.spp=2", "optimizer.steps=120"]
    overrides += ["reference.pool=32", "optimizer.rates.ambient=0.03", "latent.optimize=[]", "evaluation.views=2"]
    fit = Fit(replace(model, ambient=np.full((1, 3), 0.1, np.float32)), reference, load_config(overrides=overrides))
    before, _ = fit.judge()
    for k in range(120):
        fit.step(k)
    after, _ = fit.judge()
    np.testing.assert_allclose(fit.model().ambient, AMBIENT, atol=0.03)
    assert after < 0.5 * before
    state = fit.state()
    other = Fit(replace(model, ambient=np.full((1, 3), 0.1, np.float32)), reference, load_config(overrides=overrides))
    other.restore(state)
    np.testing.assert_array_equal(other.model().ambient, fit.model().ambient)


def test_a_known_ambient_light_is_left_alone(model):
    config = load_config(overrides=["asset=x", "latent.ambient.optimize=false", "optimizer.resolution=16"])
    fit = Fit(replace(model, ambient=AMBIENT), make_reference(model.as_asset(), spp=1), config)
    fit.step(0)
    np.testing.assert_array_equal(fit.model().ambient, AMBIENT)


def test_files_carry_the_ambient_term_as_emission(model, tmp_path):
    """Emission of the GLB is ambient times base colour, at any strength; the light itself comes back."""
    for factor in (1.0, 20.0):
        lit = replace(model, ambient=AMBIENT * factor)
        files = export_model(lit, tmp_path / str(factor), extras={"ambient": " ".join(map(str, lit.ambient.ravel()))})
        asset = load_asset(files["glb"])
        np.testing.assert_allclose(asset.ambient, lit.ambient, rtol=1e-5)
        data = files["glb"].read_bytes()
        document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        (material,) = document["materials"]
        assert "emissiveTexture" in material
        strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)
        assert (strength > 1) == (factor == 20.0)
        from PIL import Image

        image = np.asarray(Image.open(files["obj"].with_name("model_emission.png")))[..., :3] / 255
        written = srgb_to_linear(image) * strength * material["emissiveFactor"][0]
        true = lit.ambient[0] * model.base_color[..., :3] * (1 - model.specular[..., 2:])
        np.testing.assert_allclose(written, true, atol=0.01 * true.max())
        assert "map_Ke model_emission.png" in files["obj"].with_suffix(".mtl").read_text()
    plain = export_model(model, tmp_path / "plain")
    assert load_asset(plain["glb"]).ambient is None and not (tmp_path / "plain/model_emission.png").exists()
