"""The alpha test of glTF: OPAQUE, MASK and BLEND in and out."""

import numpy as np
import pytest

from mi_simplify.export import export_model
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.guess import first_guess
from mi_simplify.model.asset import Asset, Instance
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import held_out_views


@pytest.fixture
def alpha_test(shared_assets) -> Asset:
    return load_asset(shared_assets / "alpha_blend" / "AlphaBlendModeTest.glb")


def test_each_mode_comes_back_as_it_was(alpha_test, tmp_path):
    """A part of each material through bake and files: its mode, and how much of it is seen."""
    seen = {}
    for part in alpha_test.parts:
        key = (part.material.alpha_mode, part.material.alpha_cutoff)
        if key in seen or len(part.faces) > 4:
            continue
        alone = Asset((part,), (Instance(0),), name="part")
        model, _ = first_guess(alone, mesh=alone, repair=False, atlas_size=128)
        files = export_model(model, tmp_path / f"{key[0]}{key[1]}", formats=("glb", "usd"))
        for name, path in files.items():
            (mode,) = {p.material.alpha_mode for p in load_asset(path).parts}
            assert mode == key[0], (name, key)
        views = held_out_views(alone.bounds, 2, 48, 1)
        want, have = (
            make_reference(a, transport="baked", spp=64, max_depth=2).render(views)[..., 3]
            for a in (alone, load_asset(files["glb"]))
        )
        assert have.sum() == pytest.approx(want.sum(), rel=0.03), key
        assert np.abs(have - want).mean() < 0.08 * want.mean(), key
        seen[key] = True
    assert {mode for mode, _ in seen} == {"OPAQUE", "MASK", "BLEND"}
