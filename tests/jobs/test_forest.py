"""Forests: places, the YAML, instances in files, and a small one rendered whole."""

import json
import struct

import numpy as np
import pytest
from support.parts import leaves

from mi_simplify import cli
from mi_simplify.config.commands.forest import load_forest
from mi_simplify.errors import ConfigError, OutputError
from mi_simplify.formats.gltf.instancing import write_instanced
from mi_simplify.formats.gltf.write import write_glb
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.cards.cards import cards
from mi_simplify.jobs.scatter import scatter


def test_copies_stand_upright_and_evenly_on_their_square():
    places = scatter(900, 30.0, 0.6, np.random.default_rng(0))
    assert np.abs(places[:, [0, 2], 3]).max() <= 15 and (places[:, 1, 3] == 0).all()
    counts = np.histogram2d(places[:, 0, 3], places[:, 2, 3], bins=[np.linspace(-15, 15, 31)] * 2)[0]
    assert (counts == 1).all()
    size = np.cbrt(np.linalg.det(places[:, :3, :3]))
    assert size.min() >= 0.6 and size.max() <= 1
    rotation = places[:, :3, :3] / size[:, None, None]
    np.testing.assert_allclose(rotation @ rotation.transpose(0, 2, 1), np.tile(np.eye(3), (900, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(rotation[:, 1], np.tile([0, 1, 0], (900, 1)), atol=1e-12)


def test_instances_come_back_from_the_file(tmp_path):
    model, _ = cards(leaves(5), 10, atlas_size=64)
    source = write_glb(model, tmp_path / "model.glb")
    places = scatter(40, 9.0, 0.5, np.random.default_rng(1))
    asset = load_asset(write_instanced(source, places, tmp_path / "many.glb"))
    assert len(asset.parts) == 1 and len(asset.instances) == 40
    assert asset.n_triangles == 40 * model.n_triangles
    np.testing.assert_allclose([i.to_world for i in asset.instances], places, atol=1e-5)
    assert asset.parts[0].material.alpha_mode == "MASK"
    data = (tmp_path / "many.glb").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    assert "EXT_mesh_gpu_instancing" in document["extensionsRequired"]
    with pytest.raises(OutputError, match="do not stand in the root|model.glb of mi-simplify"):
        write_instanced(__file__, places, tmp_path / "none.glb")


def test_the_yaml_is_checked_and_its_paths_are_its_own(tmp_path):
    path = tmp_path / "forest.yaml"
    path.write_text("plants: [{original: 'sample:fern', approximation: fern.glb}]\nenvironment: sky.hdr\n")
    forest = load_forest(path)
    assert forest.plants[0].original == "sample:fern"
    assert forest.plants[0].approximation == str(tmp_path / "fern.glb")
    assert forest.environment == str(tmp_path / "sky.hdr")
    for text, match in (
        ("plants: []", "plants"),
        ("instances: 3", "plants: missing"),
        ("plants: [{original: a, approximation: b}]\ninstanzes: 3", "instances"),
        ("plants: [{original: a, aproximation: b}]", "unknown key|approximation: missing"),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError, match=match):
            load_forest(path)


def test_a_small_forest_from_the_command_line(tmp_path, capsys):
    model, _ = cards(leaves(30), 60, atlas_size=96)
    write_glb(model, tmp_path / "model.glb")
    (tmp_path / "forest.yaml").write_text(
        "plants: [{original: model.glb, approximation: model.glb}]\n"
        "instances: 20\nside: 5\nwidth: 64\nheight: 48\nspp: 16\nmax_depth: 3\n"
    )
    out = tmp_path / "out"
    assert cli.main(["forest", str(tmp_path / "forest.yaml"), "-o", str(out), "--gpu-instancing", "-q"]) == 0
    figures = json.loads((out / "forest.json").read_text())
    assert figures["triangles"] == {"original": 20 * 60, "approximation": 20 * 60}
    # The same models: they differ by noise alone.
    assert figures["psnr"] == pytest.approx(figures["noise_psnr"], abs=0.5) and figures["psnr"] > 20
    assert {p.name for p in out.iterdir()} == {"original.png", "approximation.png", "forest.json", "forest_0.glb"}
    assert len(load_asset(out / "forest_0.glb").instances) == 20
    again = ["forest", str(tmp_path / "forest.yaml"), "-o", str(out)]
    assert cli.main(again) == 2
    assert "already holds a run" in capsys.readouterr().err
    assert cli.main([*again, "--overwrite", "--environment", "none.hdr"]) == 2
    assert "none.hdr" in capsys.readouterr().err
