"""Nothing lost: a run that was killed goes on to the same end; damage, a full disk, NaN do not cost it."""

import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.models import textured_sphere
from support.toy import bumpy_sphere, files

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import OutputError
from mi_simplify.fitting import Fit, Run, fit
from mi_simplify.fitting.parameters.texels import TexelAdam
from mi_simplify.fitting.parameters.vertices import VertexSteps
from mi_simplify.jobs.job import run_job
from mi_simplify.progress import Progress
from mi_simplify.record.checkpoint import Checkpoint, fingerprint, read_archive, write_archive
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.subjects import model_file, subject

resource = pytest.importorskip("resource", reason="POSIX")

TINY = [
    "asset=sample:relic", "optimizer.batch=2", "evaluation.resolution=32", "evaluation.views=2", "evaluation.every=10",
    "reference.spp=2", "optimizer.rates.vertices=0.01", "optimizer.tolerance=0",
]  # fmt: skip


@pytest.fixture
def one_thread():
    """Sums of several threads come out in another order every time; with one, everything is the same to the bit."""
    before = dr.thread_count()
    dr.set_thread_count(1)
    yield
    dr.set_thread_count(before)


def problem(*overrides: str):
    """A sphere that is too small, what it should become, and how."""
    target, config = textured_sphere(), load_config(overrides=[*TINY, *overrides])
    reference = make_reference(target.as_asset(), transport=config.reference.transport, spp=2)
    return target.transformed(0.9, np.zeros(3)), reference, config


def advanced(run: Run, n: int) -> Run:
    while run.done < n:
        run.step()
    return run


# ------------------------------------------------------------------ states


@pytest.mark.parametrize(
    "overrides",
    [
        ("optimizer.resolution=[24,32]",),
        ("optimizer.resolution=32", "optimizer.large_steps.enabled=false", "loss.laplacian.weight=0"),
        ("optimizer.resolution=32", "latent.optimize=[base_color,opacity,gamma]", "optimizer.tolerance=0.9"),
        pytest.param(
            ("optimizer.resolution=16", "reference.transport=matched", "reference.max_depth=3"), marks=pytest.mark.slow
        ),
    ],
    ids=["coarse to fine", "plain Adam", "no vertices, opacity and gamma, ending early", "matched"],
)
def test_a_restored_run_takes_the_same_steps_to_the_bit(overrides, one_thread, tmp_path):
    parts = problem(*overrides, "optimizer.steps=24", "reference.pool=12")
    whole = advanced(Run(*parts), 24)
    write_archive(tmp_path / "state.npz", advanced(Run(*parts), 15).state())
    resumed = advanced(Run(*parts, state=read_archive(tmp_path / "state.npz")), 24)
    for name, values in whole.fit.parameters().items():
        np.testing.assert_array_equal(values, resumed.fit.parameters()[name], err_msg=name)
    timeless = lambda run: [{**record, "seconds": 0} for record in run.records]  # noqa: E731
    assert timeless(whole) == timeless(resumed)
    assert (whole.best_step, whole.least) == (resumed.best_step, resumed.least)
    np.testing.assert_array_equal(whole.result().model.base_color, resumed.result().model.base_color)
    assert resumed.seconds >= resumed.records[-1]["seconds"] > resumed.records[0]["seconds"]


def test_a_state_is_a_copy():
    run = advanced(Run(*problem("optimizer.resolution=24", "optimizer.steps=9")), 2)
    state = run.state()
    before = state["fit"]["texels"]["m"].copy()
    advanced(run, 5)
    np.testing.assert_array_equal(state["fit"]["texels"]["m"], before)
    assert np.abs(run.state()["fit"]["texels"]["m"] - before).max() > 0


# ------------------------------------------------------------------ files


def test_archives_hold_arrays_and_plain_values_and_no_pickles(tmp_path):
    tree = {
        "a": {"b": {"c": np.arange(6, dtype=np.float16).reshape(2, 3)}, "n": None},
        "records": [{"step": 1, "loss": 0.1}], "big": 2**100, "infinite": float("inf"), "text": "ü",
    }  # fmt: skip
    write_archive(tmp_path / "x.npz", tree)
    back = read_archive(tmp_path / "x.npz")
    array = back["a"]["b"].pop("c")
    assert array.dtype == np.float16 and array.tolist() == tree["a"]["b"].pop("c").tolist()
    assert back == tree
    np.savez(tmp_path / "evil.npz", plain=np.array([print], dtype=object))
    with pytest.raises(ValueError, match="pickle"):
        read_archive(tmp_path / "evil.npz")


def test_a_fingerprint_tells_assets_apart_whatever_they_are_called():
    asset = textured_sphere().as_asset()
    (part,) = asset.parts
    assert fingerprint(replace(asset, name="other")) == fingerprint(asset)
    moved = part.vertices.copy()
    moved[5, 1] = np.nextafter(moved[5, 1], 9)
    color = part.material.base_color.copy()
    color[3, 4, 1] += 1e-3
    for changed in (replace(part, vertices=moved), replace(part, material=replace(part.material, base_color=color))):
        assert fingerprint(replace(asset, parts=(changed,))) != fingerprint(asset)


@pytest.fixture
def checkpoint(tmp_path):
    model = textured_sphere()
    return Checkpoint(tmp_path / "checkpoint", load_config(overrides=TINY), model.as_asset()), model


def test_first_guess_and_state_come_back(checkpoint):
    checkpoint, model = checkpoint
    checkpoint.begin(model, ["a note"])
    guess, notes, state = checkpoint.load()
    assert (notes, state, guess.name, guess.mesh.normal_index) == (["a note"], None, model.name, None)
    for name in ("positions", "position_index", "uvs", "faces"):
        np.testing.assert_array_equal(getattr(guess.mesh, name), getattr(model.mesh, name))
    assert checkpoint.save({"done": 7})
    (checkpoint.folder / ".state-1234abcd.npz").write_text("half")  # what a killed process leaves
    assert checkpoint.load()[2] == {"done": 7}
    assert files(checkpoint.folder) == {"guess.npz", "state.npz"}


def test_a_disk_that_is_full_costs_a_warning_and_keeps_the_old_state(checkpoint, caplog):
    checkpoint, model = checkpoint
    checkpoint.begin(model, [])
    assert checkpoint.save({"done": 1})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        assert not checkpoint.save({"done": 2, "much": np.zeros(10**6)})
        assert not checkpoint.save({"done": 3, "much": np.zeros(10**6)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [r.message for r in caplog.records] == [
        f"no checkpoint: cannot write {checkpoint.folder / 'state.npz'}: File too large; the run goes on"
    ]
    assert checkpoint.load()[2] == {"done": 1}
    assert files(checkpoint.folder) == {"guess.npz", "state.npz"}
    shutil.rmtree(checkpoint.folder)
    checkpoint.folder.write_text("in the way")
    assert not checkpoint.save({"done": 4})
    checkpoint.folder.unlink()
    assert checkpoint.save({"done": 5})
    assert checkpoint.load()[0].name == model.name and checkpoint.load()[2] == {"done": 5}


# ------------------------------------------------------------------ NaN


class Broken:
    """A reference whose images have NaN in them at some of its calls."""

    def __init__(self, reference, calls):
        self.reference, self.calls, self.n = reference, calls, 0

    def render(self, views, seed=0):
        images = self.reference.render(views, seed)
        self.n += 1
        if self.n in self.calls:
            images[:, 14:18, 14:18, 1] = np.nan
        return images


def test_pixels_that_the_reference_does_not_know_are_left_out(caplog):
    guess, reference, config = problem("optimizer.resolution=32", "optimizer.steps=40")
    run = advanced(Run(guess, Broken(reference, range(99)), config), 40)
    expected = "1.6 % of the pixels of the reference are NaN and left out of the fit"
    assert [r.message for r in caplog.records] == [expected]
    assert run.setbacks == 0 and run.best_step == 40
    psnr = [record["psnr"] for record in run.records if "psnr" in record]
    assert psnr[-1] > psnr[0] + 1


def with_loss_of_nan(run: Run, steps) -> Run:
    step = run.fit.step
    run.fit.step = lambda index, progress: step(index, progress) * (np.nan if index in steps else 1.0)
    return run


def test_nan_goes_back_to_the_best_state_and_on_with_care(caplog):
    run = with_loss_of_nan(Run(*problem("optimizer.resolution=32", "optimizer.steps=60")), {20})
    advanced(run, 20)
    assert run.setbacks == 0 and run.fit.caution == 1.0
    advanced(run, 60)
    expected = "step 21: NaN or infinity in the loss; back to the state of step 20, at half the rates"
    assert [r.message for r in caplog.records] == [expected]
    assert run.fit.caution == 0.5 and run.fit.not_finite() is None
    psnr = {record["step"]: record["psnr"] for record in run.records if "psnr" in record}
    assert run.best_step > 20 and psnr[60] > psnr[20]
    assert all(np.isfinite(record["loss"]) for record in run.records)


@pytest.mark.parametrize(("part", "array"), [("vertices", "u"), ("vertices", "v"), ("textures", "m")])
def test_nan_in_a_gradient_is_found_though_the_loss_is_finite(part, array, caplog):
    run = advanced(Run(*problem("optimizer.resolution=32", "optimizer.steps=60")), 10)
    optimizer: VertexSteps | TexelAdam = {"vertices": run.fit.shape.vertices, "textures": run.fit.texels}[part]
    state = optimizer.state()
    state[array].flat[-1] = np.nan
    optimizer.restore(state)
    assert run.fit.not_finite() == part
    advanced(run, 30)
    assert [r.message for r in caplog.records] == [
        f"step 11: NaN or infinity in the {part}; back to the state of step 10, at half the rates"
    ]
    assert run.fit.not_finite() is None and run.best_step >= 10


def test_nan_without_end_ends_with_the_best(monkeypatch, caplog):
    parts = problem("optimizer.resolution=32", "optimizer.steps=200")
    monkeypatch.setattr(Fit, "step", lambda fit, index, progress: mi.Float(np.nan))
    assert fit(*parts).model is parts[0]
    lines = [r.message for r in caplog.records if r.levelno == logging.WARNING]
    back = "NaN or infinity in the loss; back to the state of step 0"
    assert lines[0] == f"step 1: {back}, at half the rates"
    assert lines[4] == f"step 21: {back}, which is kept: 5 times is enough"
    assert len(lines) == 6 and "first guess, which is kept" in lines[5]


# ------------------------------------------------------------------ jobs

SMALL = [
    "initial.triangles=300", "initial.atlas_size=64", "evaluation.resolution=48", "evaluation.spp=4",
    "evaluation.views=2", "evaluation.every=10", "reference.spp=4", "optimizer.resolution=48", "optimizer.batch=2",
    "optimizer.steps=30", "optimizer.tolerance=0", "export.formats=glb", "export.checkpoint=0",
]  # fmt: skip


def words(settings) -> list[str]:
    return [word for text in settings for word in ("--set", text)]


def simplify(folder: Path, *arguments: str, **options) -> subprocess.Popen:
    """The command in a process of its own, on one core, so that two runs are the same to the bit."""
    command = [sys.executable, "-m", "mi_simplify", "simplify", "sphere.ply", "-q", *words(SMALL), *arguments]
    return subprocess.Popen(
        command, cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}), **options,
    )  # fmt: skip


def finish(process: subprocess.Popen) -> None:
    _, err = process.communicate(timeout=200)
    assert process.returncode == 0, err


def lines_logged(out: Path) -> int:
    log = out / "log.jsonl"
    return log.read_text().count("step") if log.exists() else 0


def assert_same_end(a: Path, b: Path) -> None:
    assert (a / "model.glb").read_bytes() == (b / "model.glb").read_bytes()
    results = [json.loads((folder / "metrics.json").read_text())["candidates"]["result"] for folder in (a, b)]
    for name in ("psnr", "flip", "silhouette_error"):
        assert results[0][name] == results[1][name]
    steps = [[json.loads(line)["step"] for line in (f / "log.jsonl").read_text().splitlines()] for f in (a, b)]
    assert steps[0] == steps[1]
    assert files(a) == files(b)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    bumpy_sphere(folder)
    start = time.monotonic()
    finish(simplify(folder, "-o", "whole"))
    (folder / "seconds").write_text(str(time.monotonic() - start))
    return folder


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="one core for a process: Linux")
def test_a_killed_run_resumed_ends_as_if_nothing_had_happened(uninterrupted):
    process = simplify(uninterrupted, "-o", "killed")
    while lines_logged(uninterrupted / "killed") < 3 and process.poll() is None:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert files(uninterrupted / "killed") >= {"config.yaml", "checkpoint", "checkpoint/state.npz"}
    finish(simplify(uninterrupted, "-o", "killed", "--resume"))
    assert_same_end(uninterrupted / "whole", uninterrupted / "killed")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="one core for a process: Linux")
def test_ten_kills_at_random_moments_of_one_run_end_the_same(uninterrupted):
    """At any moment: while it loads, writes a checkpoint, steps, exports; resumed as often as it takes."""
    seconds, rng = float((uninterrupted / "seconds").read_text()), np.random.default_rng(int(time.time()))
    out = uninterrupted / "often"
    kills = 0
    while kills < 10:
        resume = ["--resume"] if (out / "checkpoint").is_dir() else ["--overwrite"]
        process = simplify(uninterrupted, "-o", out.name, *resume)
        try:
            _, err = process.communicate(timeout=rng.uniform(0.3, 1.0) * seconds)
            assert process.returncode == 0, err
            shutil.rmtree(out)  # it came to its end; the next kills are for another one
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            kills += 1
    resume = ["--resume"] if (out / "checkpoint").is_dir() else ["--overwrite"]
    finish(simplify(uninterrupted, "-o", out.name, *resume))  # which the last kill may have left without a folder
    assert_same_end(uninterrupted / "whole", out)


@pytest.fixture
def stopped(tmp_path, monkeypatch, capsys):
    """A folder with a run that was stopped after twelve steps, and the command that began it."""
    bumpy_sphere(tmp_path, 20)
    monkeypatch.chdir(tmp_path)
    command = ["simplify", "sphere.ply", "-q", "-o", "out", *words(SMALL)]

    step = Run.step

    def stopped_at_11(run: Run) -> dict | None:
        if run.done == 11:
            signal.raise_signal(signal.SIGINT)
        return step(run)

    with monkeypatch.context() as patch:
        patch.setattr(Run, "step", stopped_at_11)
        assert cli.main(command) == 130
    assert list(filter(None, capsys.readouterr().err.splitlines())) == [
        "warning: stopping after this step; once more stops at once",
        "interrupted: out holds the best model of 12 of 30 steps; the same command with --resume goes on",
    ]
    assert files(tmp_path / "out") >= {"model.glb", "checkpoint/state.npz", "log.jsonl", "config.yaml"}
    return tmp_path, command


def test_what_cannot_be_resumed_is_one_line_and_changes_nothing(stopped, capsys):
    folder, command = stopped
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}

    def refused(*arguments: str) -> str:
        assert cli.main([*command, *arguments]) == 2
        err = capsys.readouterr().err
        assert err.startswith("error: ") and err.count("\n") == 1
        return err

    assert "pass --resume to go on with it, --overwrite to replace it, or choose another -o" in refused()
    assert "choose one of them" in refused("--resume", "--overwrite")
    assert "elsewhere holds no run, there is nothing to resume; leave out --resume" in (
        refused("--resume", "-o", "elsewhere")
    )
    assert "another configuration: optimizer.batch was 2, now it is 3; resume with the same settings" in (
        refused("--resume", "--set", "optimizer.batch=3")
    )
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    bumpy_sphere(folder, 21)
    assert "is of another asset" in refused("--resume")
    (folder / "out" / "checkpoint" / "guess.npz").write_bytes(b"PK")
    assert "checkpoint is damaged; pass --overwrite to begin anew" in refused("--resume")
    shutil.rmtree(folder / "out" / "checkpoint")
    assert "a run without a checkpoint, there is nothing to resume; pass --overwrite" in refused("--resume")


def test_an_interrupted_run_goes_on_and_then_there_is_nothing_left_to_resume(stopped, monkeypatch, capsys):
    folder, command = stopped
    with open(folder / "out" / "log.jsonl", "a") as log:  # steps since the checkpoint, and a line torn in two
        log.write('{"stage": "fit", "step": 21}\n{"stage": "fit", "st')

    def interrupted(reference, candidates, judging, progress, kept=None):
        signal.raise_signal(signal.SIGINT)
        progress(Progress("evaluate", 1, 6))

    with monkeypatch.context() as patch:
        patch.setattr(model_file, "compare_assets", interrupted)
        assert cli.main([*command, "--resume"]) == 130
    expected = "interrupted: out holds the finished fit; the same command with --resume judges it"
    assert capsys.readouterr().err.splitlines()[-1] == expected
    assert cli.main([*command, "--resume", "--set", "export.formats=[glb,obj]"]) == 0
    steps = [json.loads(line)["step"] for line in (folder / "out" / "log.jsonl").read_text().splitlines()]
    assert steps == [1, 10, 11, 20, 21, 30]
    assert (folder / "out" / "model.obj").is_file() and not (folder / "out" / "checkpoint").exists()
    capsys.readouterr()
    assert cli.main([*command, "--resume"]) == 2
    assert "out holds a finished run, there is nothing to resume" in capsys.readouterr().err


def test_a_run_that_reached_no_state_begins_again_with_its_first_guess(stopped, monkeypatch):
    folder, command = stopped
    (folder / "out" / "checkpoint" / "state.npz").unlink()
    monkeypatch.setattr(subject.Subject, "guess", None)
    assert cli.main([*command, "--resume"]) == 0
    steps = [json.loads(line)["step"] for line in (folder / "out" / "log.jsonl").read_text().splitlines()]
    assert steps == [1, 10, 11, 20, 21, 30]


def test_a_folder_that_disappears_is_made_again(tmp_path, caplog):
    bumpy_sphere(tmp_path, 20)

    def remove(event) -> None:
        if event.stage == "fit" and event.step == 11:
            shutil.rmtree(tmp_path / "out")

    result = run_job(load_config(overrides=[f"asset={tmp_path / 'sphere.ply'}", *SMALL]), tmp_path / "out", remove)
    assert result.figures["candidates"]["result"]["triangles"] > 0
    assert files(tmp_path / "out") >= {"model.glb", "metrics.json", "report.html", "config.yaml"}


def test_a_model_that_cannot_be_written_is_put_elsewhere(tmp_path, capsys):
    bumpy_sphere(tmp_path, 20)
    out = tmp_path / "out"

    def block(event) -> None:
        if event.stage == "fit" and event.step == 30:
            shutil.rmtree(out)
            out.write_text("in the way")

    config = load_config(overrides=[f"asset={tmp_path / 'sphere.ply'}", *SMALL])
    with pytest.raises(OutputError, match="the model is in") as error:
        run_job(config, out, block)
    spare = Path(str(error.value).split("the model is in ")[1].split(" instead")[0])
    assert error.value.exit_code == 2 and (spare / "model.glb").is_file()
    shutil.rmtree(spare)
