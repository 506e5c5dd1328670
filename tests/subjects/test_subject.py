"""What a job asks of its input: pictures, verdicts as fitted, light that is known."""

import json
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import AssetError
from mi_simplify.initial.sphere import sphere
from mi_simplify.model.light.harmonics import constant_environment, environment_coefficients, environment_image
from mi_simplify.subjects import open_subject


@pytest.fixture
def cup(tmp_path) -> Path:
    """A bowl, which shadows its own inside; its rim in the middle of a ball."""
    positions, faces = sphere(1500)
    inner = positions.copy()
    inner[:, 1] = np.where(positions[:, 1] > 0.3, 0.6 - positions[:, 1], positions[:, 1])
    lines = [f"v {x} {y} {z}" for x, y, z in inner] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (tmp_path / "cup.obj").write_text("\n".join(lines))
    return tmp_path / "cup.obj"


def sky(folder: Path) -> tuple[Path, np.ndarray]:
    coefficients = constant_environment((0.8, 0.9, 1.0)) + np.random.default_rng(1).normal(size=(16, 3)) * 0.1
    mi.Bitmap(environment_image(coefficients)).write(str(folder / "sky.exr"))
    return folder / "sky.exr", coefficients


def test_coefficients_and_image_of_an_environment_are_inverse():
    coefficients = constant_environment((0.8, 0.9, 1.0)) + np.random.default_rng(1).normal(size=(16, 3)) * 0.1
    np.testing.assert_allclose(environment_coefficients(environment_image(coefficients, 128)), coefficients, atol=2e-3)


def test_a_known_environment_lights_the_model(cup, tmp_path):
    path, coefficients = sky(tmp_path)
    overrides = [f"asset={cup}", f"reference={{transport: baked, environment: {path}}}"]
    subject = open_subject(load_config(overrides=overrides))
    assert subject.config.latent.ambient.kind == "environment" and not subject.config.latent.ambient.optimize
    np.testing.assert_allclose(subject.ambient, coefficients, atol=0.01)
    assert open_subject(load_config(overrides=[*overrides, "latent.ambient.kind=none"])).ambient is None
    with pytest.raises(AssetError, match="no.exr' does not exist"):
        missing = "reference={transport: baked, environment: no.exr}"
        _ = open_subject(load_config(overrides=[overrides[0], missing])).ambient
    assert open_subject(load_config(overrides=[overrides[0]])).ambient is None


def test_effects_that_are_baked_are_judged_as_they_were_fitted(cup, tmp_path):
    """Shadows of a static light and of the sky, into the textures: better than the true materials without them."""
    path, _ = sky(tmp_path)
    short = [
        f"reference={{transport: baked, environment: {path}, spp: 16, pool: 32}}", "views.light.position=[2, 2, 1]",
        "evaluation={light: fitted, views: 2, resolution: 48, spp: 64}", "optimizer.steps=60", "optimizer.batch=4",
        "optimizer.resolution=48", "optimizer.rates.base_color=0.03", "initial={triangles: 400, atlas_size: 128}",
        "latent.optimize=[base_color]", "export.formats=glb",
    ]  # fmt: skip
    out = tmp_path / "out"
    assert cli.main(["simplify", str(cup), "-o", str(out), "-q", *(x for s in short for x in ("--set", s))]) == 0
    figures = json.loads((out / "metrics.json").read_text())
    before, after = (figures["candidates"][name]["psnr"] for name in ("first guess", "result"))
    assert after > before + 2
    assert figures["settings"]["light"] == "as fitted"


@pytest.mark.parametrize("asset", ["sample:creature", "thing.py:thing"])
def test_pictures_of_what_is_no_model_file(asset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = "from mi_simplify.scenes.implicit.sdf import torus\ndef thing(p): return torus(p, 1, .3)\n"
    (tmp_path / "thing.py").write_text(code)
    assert cli.main(["render", asset, "-o", "a.exr", "--resolution", "32", "--spp", "4"]) == 0
    image = np.array(mi.Bitmap("a.exr"))
    assert image.shape == (32, 32, 4) and 0.05 < (image[..., 3] > 0.5).mean() < 0.9
