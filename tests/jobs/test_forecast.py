"""A dry run: what it says is so, what it reckons comes true, and it writes nothing."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from support.toy import bumpy_sphere

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import OutputError
from mi_simplify.fitting.fit import REFRESH_EVERY
from mi_simplify.fitting.schedules import resolution_at
from mi_simplify.jobs import forecast
from mi_simplify.model.mesh import Mesh
from mi_simplify.progress import in_words
from mi_simplify.record import stopwatch

SMALL = [
    "initial.triangles=200", "initial.atlas_size=64", "evaluation.views=2", "evaluation.resolution=64",
    "evaluation.spp=8", "optimizer.steps=70", "optimizer.batch=2", "optimizer.resolution=[32,64]", "reference.pool=32",
]  # fmt: skip


@pytest.fixture
def config(tmp_path):
    return load_config(overrides=[f"asset={bumpy_sphere(tmp_path)}", *SMALL])


class SteadyRun:
    """A fit on a clock of its own: the first step compiles, pixels cost, every sixteenth step refreshes the pool."""

    now = 0.0

    def __init__(self, guess, reference, config):
        self.config, self.fit, self.compiled = config, self, set()
        SteadyRun.now += 3.0

    def step(self, k: int) -> None:
        resolution = resolution_at(k / self.config.optimizer.steps, self.config.optimizer.resolution)
        SteadyRun.now += 0.02 * (resolution / 32) ** 2 + 0.5 * (k % REFRESH_EVERY == 0)
        SteadyRun.now += 2.0 * (resolution not in self.compiled)
        self.compiled.add(resolution)

    def judge(self) -> None:
        SteadyRun.now += 0.3 + 8.0 * ("judge" not in self.compiled)
        self.compiled.add("judge")

    def state(self) -> None:
        pass


@pytest.mark.parametrize(("steps", "done"), [(10, 10), (400, 64), (5000, 64)])
def test_the_fit_is_reckoned_from_its_first_steps(config, monkeypatch, steps, done):
    config = config.model_copy(update={"optimizer": config.optimizer.model_copy(update={"steps": steps})})
    monkeypatch.setattr(forecast, "Run", SteadyRun)
    monkeypatch.setattr(stopwatch, "time", SimpleNamespace(perf_counter=lambda: SteadyRun.now))
    result = forecast.Forecast({})
    forecast._try_fit(result, config, None, None, lambda progress: None)
    SteadyRun.now = 0.0
    run = SteadyRun(None, None, config)
    for k in range(steps):
        run.step(k)
        if (k + 1) % config.evaluation.every == 0 or k + 1 == steps:
            run.judge()
    assert result.steps == done, "at both resolutions sixteen to warm up and sixteen that count"
    assert result.seconds["fit"] == pytest.approx(SteadyRun.now, rel=0.03)


def test_what_would_be_done_is_said(config, tmp_path):
    expected = forecast.forecast(config, tmp_path / "out")
    assert list(expected.seconds) == ["load", "first guess", "fit", "export", "evaluate", "report"]
    assert min(expected.seconds.values()) > 0 and expected.memory > 2e8
    assert not (tmp_path / "out").exists()
    said = expected.summary()
    rows = dict(re.findall(r"^(\S+(?: \S+)*)\s{2,}(.+)$", said, re.MULTILINE))
    assert rows["asset"].endswith("3,200 triangles in 1 part(s)")
    assert rows["fit"].startswith("at most 70 steps of 2 views of 32², then 64² pixels with")
    assert rows["fit"].endswith("; vertices, base_color, roughness, metallic, normal")
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
    assert [in_words(s) for s in (0.15, 41.2, 185, 7860)] == ["0.15 s", "41 s", "3 min 05 s", "2 h 11 min"]
