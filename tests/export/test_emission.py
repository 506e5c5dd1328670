"""Emission, occlusion and notices: through files of every format, apart from ambient light, and in pictures."""

from dataclasses import replace

import numpy as np
import pytest
from support.parts import FACES, LOW, QUAD, QUAD_UV, asset_of, painted

from mi_simplify.errors import UserError
from mi_simplify.export import export_model
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.guess import first_guess
from mi_simplify.model.asset import Material, Part
from mi_simplify.model.model import Model
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import look_at

AMBIENT = np.float32([[0.3, 0.2, 0.1]])


@pytest.fixture(scope="module")
def model() -> Model:
    """A lamp, four times as bright as white, in one quarter of the image."""
    base = np.full((8, 8, 4), 0.5, np.float32)
    base[..., 3] = 1
    specular = np.zeros((8, 8, 3), np.float32) + np.float32([0, 0.5, 0.25])
    normal = np.zeros((8, 8, 3), np.float32) + np.float32([0, 0, 1])
    emission, occlusion = np.zeros((8, 8, 3), np.float32), np.linspace(0, 1, 64, dtype=np.float32).reshape(8, 8, 1)
    emission[:4, :4] = [4, 2, 1]
    metadata = {"copyright": "2026 A. Author", "extras": {"author": "A"}}
    return Model(LOW, base, specular, normal, emission=emission, occlusion=occlusion, metadata=metadata)


@pytest.mark.parametrize("ambient", [None, AMBIENT], ids=["dark", "ambient"])
@pytest.mark.parametrize("kind", ["glb", "obj", "usd"])
def test_emission_comes_back_without_the_ambient_term(model, tmp_path, kind, ambient):
    facts = {} if ambient is None else {"ambient": " ".join(map(str, ambient.ravel()))}
    path = export_model(replace(model, ambient=ambient), tmp_path, formats=[kind], extras=facts)[kind]
    asset = load_asset(path)
    (part,) = asset.parts
    assert asset.notes == ()
    np.testing.assert_allclose(part.material.emission, model.emission, atol=0.03)
    assert (part.material.emission[4:] == 0).all()
    if kind != "obj":
        np.testing.assert_allclose(part.material.occlusion, model.occlusion, atol=1 / 255)
        assert asset.metadata["copyright"] == "2026 A. Author"
    if kind == "glb":
        assert asset.metadata["extras"]["author"] == "A"


@pytest.mark.parametrize("kind", ["glb", "obj", "usd"])
def test_ambient_light_alone_is_no_emission(model, tmp_path, kind):
    dark = replace(model, emission=None, ambient=AMBIENT)
    path = export_model(dark, tmp_path, formats=[kind], extras={"ambient": "0.3 0.2 0.1"})[kind]
    assert load_asset(path).parts[0].material.emission is None


def test_emission_is_seen_as_it_is_and_lights_nothing():
    lamp = Part(QUAD, FACES, uvs=QUAD_UV, material=painted((0, 0, 0), emission=np.float32([[[4, 2, 1]]])))
    pane = Part(
        QUAD + [0, 0, 0.5], FACES, material=Material("pane", np.float32([[[0, 0, 0, 0.25]]]), alpha_mode="BLEND")
    )
    view = look_at([0, 0, 4], [0, 0, 0], [0, 0, 4], width=8, height=8, fov=10, irradiance=np.pi)
    for parts, share in (((lamp,), 1), ((lamp, pane), 0.75)):
        for transport in ("direct", "baked"):
            with_it, without = (
                make_reference(asset_of(*parts), transport=transport, spp=4, emission=e).render(view)[0] for e in (1, 0)
            )
            np.testing.assert_allclose(
                (with_it - without)[..., :3].mean((0, 1)), np.array([4, 2, 1]) * share, rtol=2e-2
            )
            np.testing.assert_array_equal(with_it[..., 3], without[..., 3])


def test_the_first_guess_has_emission_occlusion_and_the_notice():
    material = painted((0.5, 0.5, 0.5), emission=np.float32([[[3, 0, 0]]]), occlusion=np.float32([[[0.25]]]))
    asset = replace(asset_of(Part(QUAD, FACES, uvs=QUAD_UV, material=material)), metadata={"copyright": "me"})
    for oversample in (1, 2):
        guess, _ = first_guess(asset, triangles=4, kind="sphere", atlas_size=32, oversample=oversample)
        assert guess.emission is not None and guess.occlusion is not None
        assert guess.emission.shape == (32, 32, 3) and guess.occlusion.shape == (32, 32, 1)
        np.testing.assert_allclose(guess.emission.mean((0, 1)), [3, 0, 0], atol=1e-5)
        np.testing.assert_allclose(guess.occlusion, 0.25, atol=1e-5)
        assert guess.metadata == {"copyright": "me"}
    with pytest.raises(UserError):
        first_guess(asset, triangles=0)
