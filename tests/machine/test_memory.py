"""Memory: sizes as people write them, what is left, and jobs that are refused before they start."""

import json
import re
import struct

import numpy as np
import pytest
from support.tiny_models import Glb

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import ConfigError, MemoryLimitError
from mi_simplify.formats.headers import said_image_bytes, said_triangles
from mi_simplify.formats.load import load_asset
from mi_simplify.jobs.footprint import check_footprint, footprint
from mi_simplify.machine import memory
from mi_simplify.model.asset import Asset, Instance, Part


def job(*settings: str):
    return load_config(None, [{"asset": "sample:relic"}, *settings])


def test_sizes():
    assert [memory.parse_size(text) for text in ("4GB", "1.5 g", "800 MiB", "2048k", "7", "1 TB")] == [
        4 << 30, 3 << 29, 800 << 20, 2 << 20, 7, 1 << 40,
    ]  # fmt: skip
    for text in ("", "lots", "-4GB", "4GBs", "0", "nan"):
        with pytest.raises(ConfigError, match="write it as 4GB or 800MB"):
            memory.parse_size(text)
    assert memory.shown_size(4.3e9) == "4.0 GB" and memory.shown_size(5e7) == "48 MB" and memory.shown_size(3) == "1 MB"


def test_a_limit_counts_what_is_held_already():
    held = memory.held()
    if held is None:
        pytest.skip("this system does not tell what a process holds")
    assert held > 50 << 20  # Python, NumPy, Mitsuba
    with memory.limited(held + (100 << 20)):
        assert memory.left() == pytest.approx(100 << 20, abs=20 << 20)
        memory.require(50 << 20, "it", "do less")
        with pytest.raises(MemoryLimitError, match=r"it needs about 150 MB of memory, \d+ MB are left of"):
            memory.require(150 << 20, "it", "do less")
    with memory.limited(held // 2), pytest.raises(MemoryLimitError, match=r"this process holds [\d.]+ [MG]B already"):
        memory.require(150 << 20, "it", "do less")
    with pytest.raises(MemoryLimitError, match="it needs about .* of memory, .* are free; do less"):
        memory.require(1 << 60, "it", "do less")


def test_every_setting_weighs():
    least = sum(footprint(job()).values())
    for setting in ("initial.atlas_size=2048", "optimizer.batch=32", "optimizer.resolution=[64, 512]",
                    "reference.pool=1024", "evaluation.resolution=1024", "evaluation.baseline=true"):  # fmt: skip
        assert sum(footprint(job(setting)).values()) > least, setting
    mesh = Part(np.zeros((3, 3)), np.zeros((100_000, 3), np.int64))
    assert sum(footprint(job(), Asset((mesh,), (Instance(0),) * 20)).values()) > least + 2e9


def test_the_way_out_is_what_takes_most():
    with memory.limited(4 << 30), pytest.raises(MemoryLimitError, match="lower initial.atlas_size, which takes 51.9"):
        check_footprint(job("initial.atlas_size=8192"))
    with memory.limited(4 << 30), pytest.raises(MemoryLimitError, match="lower reference.pool, which takes"):
        check_footprint(job("reference.pool=100000"))
    many = Asset((Part(np.zeros((3, 3)), np.zeros((100_000, 3), np.int64)),), (Instance(0),) * 100)
    with (
        memory.limited(4 << 30),
        pytest.raises(
            MemoryLimitError,
            match=r"decimate the asset to 2,\d\d0,000 triangles before, or simplify it in parts, which takes 11",
        ),
    ):
        check_footprint(job(), many)


def test_what_a_file_says_of_itself_is_refused_before_it_is_read(tmp_path, capsys):
    """Headers of fifty million triangles, without the data: nothing that reads them would say that."""
    n = 50_000_000
    ply, stl, glb = (tmp_path / f"scan.{name}" for name in ("ply", "stl", "glb"))
    ply.write_text(f"ply\nformat binary_little_endian 1.0\nelement vertex {n // 2}\nelement face {n}\nend_header\n")
    with open(stl, "wb") as file:
        file.write(bytes(80) + n.to_bytes(4, "little"))
        file.truncate(84 + 50 * n)  # sparse
    mesh = {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}, {"attributes": {"POSITION": 1}, "mode": 5}]}
    text = json.dumps({"asset": {"version": "2.0"}, "accessors": [{"count": 7}, {"count": 3 * n}], "meshes": [mesh]})
    glb.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text.encode())
    assert [said_triangles(path) for path in (ply, stl, glb)] == [n, n, 4 * n - 2]
    for path in (ply, stl, glb):
        assert cli.main(["simplify", str(path), "-n", "300", "-o", str(tmp_path / "out"), "--memory-limit", "8GB"]) == 2
        assert re.search(
            r"needs about 5\d|2\d\d\.\d GB.*; decimate the asset to [56],\d\d0,000", capsys.readouterr().err
        )
    for damaged in (b"", b"ply\nelement face many", b"glTF", bytes(90)):
        for path in (ply, stl, glb):
            path.write_bytes(damaged)
            assert said_triangles(path) in (None, 0)
    assert said_triangles(tmp_path / "none.ply") is None and said_triangles("sample:relic") is None


def test_what_a_file_says_of_its_images_is_what_they_take(tmp_path):
    glb, pixels = Glb(), np.zeros((16, 32, 3), np.uint8)
    colour, rough = ({"index": glb.texture(pixels[:size])} for size in (16, 8))
    metal = {"baseColorTexture": colour, "metallicRoughnessTexture": rough}
    glb.mesh(glb.quad(glb.material(pbrMetallicRoughness=metal)))
    path = glb.save(tmp_path / "model.glb")
    assert said_image_bytes(path) == 4 * (4 * 16 * 32 + 3 * 8 * 32)
    config = load_config(None, [{"asset": str(path)}])
    assert footprint(config)["asset"] == pytest.approx(footprint(config, load_asset(path))["asset"], rel=0.01)
    for damaged in (b"", b"glTF", bytes(90)):
        (tmp_path / "model.glb").write_bytes(damaged)
        assert said_image_bytes(path) == 0


@pytest.mark.parametrize("dry", [[], ["--dry-run"]])
def test_the_command_line_refuses_before_it_starts(tmp_path, capsys, dry):
    out = tmp_path / "out"
    assert cli.main(["simplify", "sample:relic", "-o", str(out), "--memory-limit", "200MB", *dry]) == 2
    line = capsys.readouterr().err
    assert line.startswith("error: this job needs about") and line.count("\n") == 1 and "--memory-limit" in line
    assert not out.exists()
