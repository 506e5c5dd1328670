"""Files of at most so many bytes, and what is given up for them."""

from dataclasses import replace

import numpy as np
import pytest
from support.short import SHORT
from support.tiny_meshes import charted_sphere
from support.toy import bumpy_sphere

import mi_simplify as ms
from mi_simplify import cli
from mi_simplify.config.glb import GlbSettings
from mi_simplify.errors import ConfigError, OutputError
from mi_simplify.formats.gltf.write import write_glb
from mi_simplify.formats.packing import pack_textures
from mi_simplify.jobs.byte_budget import require_room, within_bytes
from mi_simplify.judging.texture_loss import TextureLoss
from mi_simplify.model.model import Model


def painted(side: int = 64, seed: int = 0) -> Model:
    """A ball with stripes as base colour, which are seen, and hardly any change in roughness, which nobody sees."""
    rng = np.random.default_rng(seed)
    color = np.ones((side, side, 4), np.float32)
    color[..., :3] = 0.2 + 0.6 * (np.arange(side) // 2 % 2)[:, None, None]
    color[..., :3] += 0.1 * rng.random((side, side, 3), np.float32)
    specular = np.zeros((side, side, 3), np.float32)
    specular[..., 1] = 0.6 + 0.02 * rng.random((side, side), np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (side, side, 1))
    return Model(charted_sphere(6), color, specular, normal)


@pytest.fixture(scope="module")
def loss():
    return TextureLoss(painted(), n_views=1, resolution=64)


def test_the_models_own_textures_lose_no_more_than_8_bits(loss):
    assert loss(pack_textures(painted())) < 1e-5


def test_fewer_texels_lose_more_and_what_nobody_sees_loses_least(loss):
    found = [loss(pack_textures(painted(), GlbSettings(color_size=size))) for size in (64, 32, 16)]
    assert found[0] < 1e-5 and found[1] > 10 * found[0] and found[2] > 0.9 * found[1]
    assert loss(pack_textures(painted(), GlbSettings(orm_size=16))) < found[1] / 20


def test_a_file_that_is_small_enough_stays_as_it_was_asked_for():
    settings = GlbSettings(max_bytes=10**7)
    assert within_bytes(painted(), settings).settings == settings


@pytest.mark.parametrize("most", [16_000, 9_000, 7_700])
def test_a_budget_is_kept_and_what_is_seen_is_kept_longest(most, tmp_path):
    model = painted()
    packing = within_bytes(model, GlbSettings(max_bytes=most))
    settings = packing.settings
    size = write_glb(model, tmp_path / "m.glb", settings=settings).stat().st_size
    assert packing.n_bytes <= size + 8 and size <= most and size > most / 4
    assert settings.compress == "meshopt" and settings.textures == "webp" and packing.psnr < 100
    assert settings.data_quality < 100 or settings.orm_size is not None, "roughness goes first"
    assert f"{packing.n_bytes / 1000:.1f} kB for --max-bytes {most / 1000:g} kB: geometry meshopt" in packing.note
    assert ms.load_asset(tmp_path / "m.glb").n_triangles == model.n_triangles


def test_the_looser_budget_looks_better():
    loose, tight = (within_bytes(painted(), GlbSettings(max_bytes=n)).psnr for n in (12_000, 7_500))
    assert loose > tight + 1


def test_what_somebody_stated_is_kept():
    packing = within_bytes(painted(), GlbSettings(max_bytes=14_000, textures="png", compress="quantize", orm_size=64))
    s = packing.settings
    assert (s.textures, s.compress, s.orm_size) == ("png", "quantize", 64) and s.color_size in (16, 32)


def test_a_budget_that_nothing_fits_is_one_line_and_the_way_out():
    with pytest.raises(OutputError, match=r"the least file of \d+ triangles has (\d+) bytes; ask for --max-bytes") as e:
        within_bytes(painted(), GlbSettings(max_bytes=1000))
    least = int(str(e.value).split(" bytes;")[0].split()[-1])
    assert within_bytes(painted(), GlbSettings(max_bytes=least + 8)).n_bytes <= least
    with pytest.raises(OutputError, match="the least file"):
        require_room(painted(), GlbSettings(max_bytes=1000))


def test_textures_without_mip_levels_keep_their_size():
    model = painted(60)
    settings = within_bytes(model, GlbSettings(max_bytes=9_000)).settings
    assert settings.color_size is settings.orm_size is None and settings.quality < 100
    assert within_bytes(replace(model, name="b"), GlbSettings(max_bytes=9_000)).settings == settings


def test_bytes_of_what_is_not_written_are_one_line():
    with pytest.raises(ConfigError, match="`export.glb.max_bytes` is about the GLB file, which `export.formats` leave"):
        ms.load_config(None, ["asset=a.obj", "export.formats=obj", "export.glb.max_bytes=5kB"])
    with pytest.raises(ConfigError, match=r"^export.glb.max_bytes: should be a size of a file such as 500kB or 1.5MB"):
        ms.load_config(None, ["asset=a.obj", "export.glb.max_bytes=12 parsecs"])


@pytest.mark.slow
def test_a_command_keeps_to_its_bytes(tmp_path, capsys):
    asset = bumpy_sphere(tmp_path)
    settings = [x for s in [*SHORT, "export.formats=glb"] for x in ("--set", s)]
    command = ["simplify", str(asset), "-n", "200", *settings, "-o"]
    assert cli.main([*command, str(tmp_path / "tiny"), "--max-bytes", "300"]) == 2
    assert "the least file" in capsys.readouterr().err and not (tmp_path / "tiny").exists()
    assert cli.main([*command, str(tmp_path / "small"), "--max-bytes", "9kB"]) == 0
    assert (tmp_path / "small" / "model.glb").stat().st_size <= 9000
    assert "kB for --max-bytes 9 kB" in capsys.readouterr().out
    assert "max_bytes: 9000" in (tmp_path / "small" / "config.yaml").read_text()
