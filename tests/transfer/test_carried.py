"""Transfer of an original in textures of its small model: lookups, fits to rays, files, and the command."""

import json

import numpy as np
import pytest

from mi_simplify import cli
from mi_simplify.config.export import CarriedSettings
from mi_simplify.errors import AssetError, ConfigError
from mi_simplify.model.asset import Asset, Instance, Part
from mi_simplify.transfer.body import Body
from mi_simplify.transfer.carried import carried, load_carried, lookup
from mi_simplify.transfer.carrier import Carrier
from mi_simplify.transfer.cast import Caster, unshadowed
from mi_simplify.transfer.player import Surface, player_data
from mi_simplify.transfer.surfaces.image import grid_faces

SETTINGS = CarriedSettings(size=24, directions=64)


def gutter(n: int) -> Body:
    """A square folded along its middle, n² vertices, whose bottom is in its own shade, unfolded in the texture."""
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n)))
    x = 2 * u - 1
    vertices = np.stack([0.5 * x, np.abs(x), 1 - 2 * v], 1)
    uvs = np.stack([u, v], 1).astype(np.float32)
    faces = grid_faces(n)
    return Body.of(Asset((Part(vertices, faces, uvs=uvs),), (Instance(0),), name="gutter"))


@pytest.fixture(scope="module")
def textures():
    return carried(gutter(25), gutter(3), SETTINGS)


def test_lookups_are_bilinear():
    """What is linear over the texels comes back, and beyond the outermost centres they are clamped."""
    n = 8
    x, y = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)
    uvs = np.random.default_rng(0).uniform(0.07, 0.93, (50, 2))
    np.testing.assert_allclose(lookup(uvs, n) @ (2 * x + 3 * y).ravel(), uvs @ [2, 3], atol=1e-12)
    assert lookup(np.array([[0.0, 1.0]]), n).toarray().reshape(n, n)[-1, 0] == 1


def test_textures_of_few_triangles_hold_the_shadows_of_many(textures):
    fine = gutter(25)
    positions, normals = fine.posed(0)
    rays = Caster(positions, fine.faces, n_directions=1024, albedo=1.0)(positions, normals)
    inside = (np.abs(fine.uvs - 0.5) < 0.45).all(1) & (np.abs(fine.uvs[:, 0] - 0.5) > 0.03)  # not on the crease
    shown = lookup(fine.uvs[inside], SETTINGS.size) @ textures.at(0).reshape(-1, 16)
    error = np.abs(shown - rays[inside]).mean()
    assert error < 0.15 * np.abs(unshadowed(normals[inside], albedo=1.0) - rays[inside]).mean()
    assert textures.weights.shape == (1, 0) and textures.order == 3


def test_a_file_holds_it_all(textures, tmp_path):
    again = load_carried(textures.save(tmp_path / "transfer.npz"))
    np.testing.assert_array_equal(again.at(0), textures.at(0))
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    with pytest.raises(AssetError, match="transfer.npz of a run expected"):
        load_carried(tmp_path / "bad.npz")


def test_frames_are_sums_of_axes():
    """A figure that walks: with as many axes as there are frames the textures are those of each frame alone."""
    from mi_simplify.scenes.samples.catalogue import sample_asset

    body = Body.of(sample_asset("walker:2000"))
    settings = CarriedSettings(size=16, directions=16, frames=4, order=1)
    whole, few = (carried(body, body, settings.model_copy(update={"axes": n})) for n in (3, 1))
    assert list(whole.frames) == [0, 8, 15, 23] and whole.textures.shape == (4, 16, 16, 4)
    between = (whole.at(0) + whole.at(8)) / 2
    np.testing.assert_allclose(whole.at(4), between, atol=1e-5)
    assert 0 < np.abs(few.at(8) - whole.at(8)).mean() < 0.5 * np.abs(whole.at(0) - whole.at(8)).mean()


def test_what_has_no_texture_coordinates_is_refused():
    bare = gutter(3)
    bare = Body(bare.asset, bare.faces, None)
    with pytest.raises(AssetError, match="texture coordinates expected"):
        carried(gutter(5), bare, SETTINGS)


def test_the_player_has_vertices_and_textures_side_by_side(textures):
    body = gutter(3)
    positions, normals = body.posed(0)
    rays = Surface(positions[None], body.faces, {"rays": unshadowed(normals)[None]})
    data = player_data([rays, Surface(positions[None], body.faces, {"own": textures.at(0)[None]}, body.uvs)])
    assert data["names"] == ["rays", "own"] and [s["side"] for s in data["surfaces"]] == [0, SETTINGS.size]
    json.dumps(data)


def test_the_figures_tell_textures_from_no_shadows(tmp_path):
    settings = CarriedSettings(write=True, size=24, directions=64)
    figures = Carrier(gutter(25).asset, settings)(gutter(3).asset, tmp_path / "transfer")
    for row in figures["psnr"].values():
        assert row["textures"] > row["vertices, every frame"] > row["no shadows"]
    assert {path.name for path in (tmp_path / "transfer").iterdir()} == {"transfer.npz", "player.json"}


def test_what_has_no_triangles_is_refused():
    with pytest.raises(ConfigError, match="export.transfer: a model file with triangles"):
        Carrier(None, SETTINGS)


@pytest.mark.slow
def test_simplify_writes_transfer_and_its_report_plays_it(tmp_path):
    small = ["initial.triangles=300", "initial.atlas_size=64", "optimizer.steps=2", "optimizer.resolution=32"]
    small += ["evaluation.resolution=32", "evaluation.spp=2", "evaluation.views=2", "reference.spp=2"]
    small += ["export.transfer.size=32", "export.transfer.directions=16", "export.transfer.frames=3"]
    options = [option for text in small for option in ("--set", text)]
    out = tmp_path / "out"
    assert cli.main(["simplify", "sample:walker:2000", "--transfer", "-o", str(out), "--quiet", *options]) == 0
    assert load_carried(out / "transfer" / "transfer.npz").weights.shape == (3, 2)
    run = json.loads((out / "metrics.json").read_text())["run"]
    assert run["transfer"]["frames"] == 3 and run["transfer"]["psnr"]["places"]["textures"] > 15
    page = (out / "report.html").read_text()
    assert 'id="player-data"' in page and "asset, rays" in page
    assert cli.main(["report", str(out)]) == 0
    assert 'id="player-data"' in (out / "report.html").read_text()
