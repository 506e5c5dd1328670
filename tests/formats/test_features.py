"""Every feature of glTF in a file of its own, through the first guess and back: nothing is lost without a line."""

import json
import re
import struct

import numpy as np
import pytest
from support.features import FEATURES, made
from support.parts import FACES, QUAD_UV, asset_of
from support.paths import ROOT
from support.tiny_models import QUAD

from mi_simplify.export import export_model
from mi_simplify.formats.gltf.file import SUPPORTED
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.guess import first_guess
from mi_simplify.model.asset import Part

LOW = asset_of(Part(QUAD, FACES, uvs=QUAD_UV))

#: Features that set the base colour, so that a file has one of them.
BASE = {"base colour", "further UV sets", "texture transforms", "clamp and mirror", "mask", "blending"}


def simplified(names, folder):
    """The file's asset, the JSON of what became of it, and that read again."""
    asset = load_asset(made(*names).save(folder / "in.glb"))
    model, _ = first_guess(asset, mesh=LOW, atlas_size=32)
    path = export_model(model, folder, formats=["glb"])["glb"]
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    return asset, document, load_asset(path), path


def check(names, folder):
    """Looks at one file; returns the path of what became of it."""
    asset, document, written, path = simplified(names, folder)
    (material,) = document["materials"]
    (before,), after = {id(p.material): p.material for p in asset.parts}.values(), written.parts[0].material
    assert after.lobes == before.lobes
    assert material["alphaMode"] == before.alpha_mode and material["doubleSided"] == before.double_sided
    assert written.metadata.get("copyright") == asset.metadata.get("copyright")
    for field in ("emission", "occlusion"):
        have, had = (getattr(m, field) for m in (after, before))
        assert (have is None) == (had is None)
        if had is not None:
            assert have.max() == pytest.approx(had.max(), rel=0.05)
    if not (BASE | {"vertex colours"}) & set(names):
        np.testing.assert_allclose(after.base_color.mean((0, 1)), before.base_color.mean((0, 1)), atol=0.01)
    left_out = [name for name in names if FEATURES[name][1] == "left out"]
    assert sum("left out" in note for note in asset.notes) == len(left_out)
    carried = set(before.lobes)
    assert carried <= set(document.get("extensionsUsed", ()))
    assert sum("carried over" in note for note in asset.notes) == len(carried)
    return path


VALIDATOR = """
    const fs = require('fs'), validator = require('gltf-validator');
    (async () => {
        const found = [];
        for (const path of JSON.parse(fs.readFileSync(0))) {
            const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)));
            found.push(report.issues.messages.filter(x => x.severity < 2).map(x => x.code));
        }
        console.log(JSON.stringify(found));
    })();
"""


def pairs() -> list[list[str]]:
    """All pairs of features that one file can have."""
    names = list(FEATURES)
    every = [[a, b] for k, a in enumerate(names) for b in names[k + 1 :]]
    return [pair for pair in every if not set(pair) <= BASE]


def test_what_is_left_out_is_told_and_nothing_else(tmp_path):
    for name, (_, verdict) in FEATURES.items():
        notes = load_asset(made(name).save(tmp_path / "in.glb")).notes
        assert sum("left out" in note for note in notes) == (verdict == "left out"), name


def test_everything_at_once(tmp_path):
    check([name for name in FEATURES if name not in BASE - {"mask"}], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", FEATURES)
def test_a_feature_is_baked_carried_over_or_told(name, tmp_path):
    check([name], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_so_are_several_at_once(seed, tmp_path):
    rng = np.random.default_rng(seed)
    exclusive = [n for n in FEATURES if n in BASE]
    for _ in range(12):
        names = [str(n) for n in rng.choice(list(FEATURES), rng.integers(2, 6), replace=False)]
        first, *others = [n for n in names if n in exclusive] or [""]
        names = [n for n in names if n not in others]
        check(names, tmp_path)


@pytest.mark.slow
def test_pairs_satisfy_the_validator_of_khronos(tmp_path, node_run):
    """No error, and no warning that the file it was made from has not: some extensions are there without another."""
    every = pairs()
    written = []
    for k in np.random.default_rng(4).permutation(len(every))[:24]:
        (tmp_path / str(k)).mkdir()
        path = check(every[k], tmp_path / str(k))
        written += [str(path), str(path.with_name("in.glb"))]
    codes = json.loads(node_run("gltf-validator", VALIDATOR, json.dumps(written)))
    for k, (after, before) in enumerate(zip(codes[::2], codes[1::2], strict=True)):
        assert set(after) <= set(before), written[2 * k]


def table() -> dict[str, str]:
    """Column glTF of the features in docs/formats.md."""
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([^|]+?) \| ([^|]+?) \|.*\|$", text, re.M)
    return {feature: verdict for feature, verdict in rows if feature not in ("feature", "---")}


def test_the_table_of_the_documentation_says_what_happens():
    rows = table()
    assert {name: rows.get(name) for name in FEATURES} == {name: verdict for name, (_, verdict) in FEATURES.items()}


def test_every_extension_is_named_in_the_documentation():
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    assert {name for name in SUPPORTED if f"`{name}`" not in text} == set()
