"""A dry run: what it says is so, what it reckons comes true, and it writes nothing."""

import re

import numpy as np
import pytest
from test_cli import bumpy_sphere

from mi_simplify import cli, forecast
from mi_simplify.config import load_config
from mi_simplify.errors import OutputError
from mi_simplify.job import run_job
from mi_simplify.latent.model import Mesh

SMALL = [
    "initial.triangles=200", "initial.atlas_size=64", "evaluation.views=2", "evaluation.resolution=64",
    "evaluation.spp=8", "optimizer.steps=70", "optimizer.batch=2", "optimizer.resolution=[32,64]", "reference.pool=32",
]  # fmt: skip


@pytest.fixture
def config(tmp_path):
    return load_config(overrides=[f"asset={bumpy_sphere(tmp_path)}", *SMALL])


def test_the_time_is_what_the_run_takes(config, tmp_path):
    expected = forecast.forecast(config, tmp_path / "out")
    assert expected.steps == 2 * 32, "both resolutions, sixteen steps to warm up and sixteen that count"
    assert not (tmp_path / "out").exists()
    seconds = run_job(config, tmp_path / "out").figures["run"]["seconds"]
    assert list(expected.seconds) == ["load", "first guess", "fit", "export", "evaluate", "report"]
    assert sum(expected.seconds.values()) == pytest.approx(seconds["total"], rel=1.0), "the machine may be busy"
    assert expected.memory > 2e8


def test_what_would_be_done_is_said(config, tmp_path):
    said = forecast.forecast(config, tmp_path / "out").summary()
    rows = dict(re.findall(r"^(\S+(?: \S+)*)\s{2,}(.+)$", said, re.MULTILINE))
    assert rows["asset"].endswith("3,200 triangles in 1 part(s)")
    assert rows["fit"].startswith("70 steps of 2 views of 32², then 64² pixels with")
    assert re.match(r"64 × 64 texels, \d+ charts on \d\d % of it", rows["atlas"])
    assert rows["evaluation"] == "2 views of 64² pixels with 8 samples"
    assert "model.glb, model.obj, model.usdc" in rows["results"]
    assert re.match(r"about .*: load .*, first guess .*, fit .*, evaluate", rows["time"])
    assert "64 steps of the fit" in rows["measured"] and "nothing was written" in rows["measured"]


def test_the_command_writes_nothing_and_refuses_what_a_run_refuses(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sphere = str(bumpy_sphere(tmp_path))
    settings = [item for text in [*SMALL, "optimizer.steps=0"] for item in ("--set", text)]
    assert cli.main(["simplify", sphere, *settings, "-o", "out", "--dry-run", "--quiet"]) == 0
    assert "0 steps of the fit" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["sphere.ply"]
    assert cli.main(["simplify", sphere, *settings, "-o", "sphere.ply", "--dry-run"]) == 2
    assert cli.main(["simplify", sphere, "-n", "9999", "-o", "out", "--dry-run"]) == 2
    assert capsys.readouterr().err.count("\n") == 2


def test_resume_has_no_forecast(config, tmp_path):
    with pytest.raises(OutputError, match="leave out --resume"):
        forecast.forecast(config, tmp_path / "out", resume=True)


def test_charts_are_counted_and_measured():
    uvs = np.float32([[0, 0], [0.5, 0], [0, 0.5], [0.5, 0.5], [0.6, 0.6], [1, 0.6], [0.6, 1]])
    mesh = Mesh(np.zeros((7, 3)), np.arange(7), uvs, np.array([[0, 1, 2], [1, 3, 2], [4, 5, 6]]))
    charts, used = forecast._charts(mesh)
    assert charts == 2 and used == pytest.approx(0.25 + 0.08)
    assert [forecast._words(s) for s in (0.15, 41.2, 185, 7860)] == ["0.15 s", "41 s", "3 min 05 s", "2 h 11 min"]
