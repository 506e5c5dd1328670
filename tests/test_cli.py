"""The command line: every bad input is exit code 2, one line, nothing written; a toy job runs end to end."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mi_simplify import cli, job
from mi_simplify.config import load_config
from mi_simplify.export import write_glb, write_obj
from mi_simplify.latent.model import Mesh, Model
from mi_simplify.output import RunFolder

TOY = ["--set", "initial.atlas_size=64", "--set", "evaluation.resolution=64", "--set", "evaluation.spp=8",
       "--set", "evaluation.views=4", "--set", "reference.spp=8", "--set", "optimizer.resolution=64"]  # fmt: skip


def bumpy_sphere(folder: Path, n: int = 40) -> Path:
    """A sphere of 2n² triangles with waves and, per octant, another vertex colour, as PLY."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n), indexing="ij")
    theta, phi = np.pi * i / n, 2 * np.pi * j / n
    d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    points = d * (1 + 0.05 * np.sin(6 * d).sum(1, keepdims=True))
    a, b = (i * n + j)[:-1].ravel(), (i * n + (j + 1) % n)[:-1].ravel()
    faces = np.concatenate([np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)])
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [f"{x:.6f} {y:.6f} {z:.6f} {55 + 200 * (x > 0)} {55 + 200 * (y > 0)} 90\n" for x, y, z in points]
    path = folder / "sphere.ply"
    path.write_text(head + "".join(rows) + "".join(f"3 {a} {b} {c}\n" for a, b, c in faces))
    return path


def tetrahedron() -> Model:
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Mesh(positions, np.arange(4), np.float32([[0, 0], [1, 0], [0, 1], [1, 1]]), faces)
    return Model(mesh, np.full((4, 4, 4), 0.5, np.float32), np.tile(np.float32([0, 0.5, 0]), (4, 4, 1)),
                 np.tile(np.float32([0, 0, 1]), (4, 4, 1)))  # fmt: skip


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@pytest.fixture
def rejected(tmp_path, monkeypatch, capsys):
    """Run a command line that must end with code 2 and one line, and leave no file behind; returns the line."""
    monkeypatch.chdir(tmp_path)

    def run(*argv: str) -> str:
        before = files(tmp_path)
        assert cli.main(list(argv)) == 2
        out, err = capsys.readouterr()
        assert err.count("\n") == 1, err
        assert err.startswith("error: ")
        assert "Traceback" not in out + err
        assert files(tmp_path) == before
        return err

    return run


# ------------------------------------------------------------------ the asset


def obj(text: str):
    return lambda folder: (folder / "bad.obj").write_text(text) and "bad.obj"


def truncated(folder: Path) -> str:
    data = write_glb(tetrahedron(), folder / "whole.glb").read_bytes()
    (folder / "cut.glb").write_bytes(data[: len(data) // 2])
    return "cut.glb"


def missing_texture(folder: Path) -> str:
    (folder / "t.mtl").write_text("newmtl m\nmap_Kd bricks.png\n")
    (folder / "t.obj").write_text("mtllib t.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n")
    return "t.obj"


def unknown_format(folder: Path) -> str:
    (folder / "model.fbx").write_bytes(b"Kaydara FBX Binary")
    return "model.fbx"


def a_folder(folder: Path) -> str:
    (folder / "folder.obj").mkdir()
    return "folder.obj"


BAD_ASSETS = {
    "missing": (lambda folder: "none.obj", "none.obj' does not exist"),
    "unreadable": (a_folder, "folder.obj' is no file"),
    "unknown format": (unknown_format, "unknown format '.fbx'"),
    "truncated": (truncated, "cut.glb"),
    "not a GLB": (lambda folder: (folder / "text.glb").write_text("hello") and "text.glb", "text.glb"),
    "empty": (lambda folder: (folder / "empty.obj").touch() or "empty.obj", "empty.obj' is empty"),
    "no faces": (obj("v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "no faces"),
    "NaN": (obj("v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n"), "NaN"),
    "out of range": (obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), "9"),
    "zero area": (obj("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"), "no area"),
    "missing texture": (missing_texture, "bricks.png"),
}


@pytest.mark.parametrize("name", BAD_ASSETS)
def test_a_bad_asset_is_one_line(name, tmp_path, rejected):
    make, expected = BAD_ASSETS[name]
    assert expected in rejected("simplify", make(tmp_path), "-n", "4", "-o", "out")


def test_an_unknown_sample_is_one_line(rejected):
    assert "sphinx" in rejected("simplify", "sample:sphinx", "-n", "100", "-o", "out")


def test_a_triangle_budget_below_four_or_above_the_input(tmp_path, rejected):
    sphere = str(bumpy_sphere(tmp_path, 10))
    assert "'--triangles' / '-n': 3 is not in the range x>=4" in rejected("simplify", sphere, "-n", "3", "-o", "out")
    assert "initial.triangles: should be greater than or equal to 4, got 3" in (
        rejected("simplify", sphere, "--set", "initial.triangles=3", "-o", "out")
    )
    assert "budget of 9999 triangles is above the input's own 200 (92 vertices); ask for fewer" in (
        rejected("simplify", sphere, "-n", "9999", "-o", "out")
    )


def test_a_mesh_to_start_from_that_cannot_be_used(tmp_path, rejected):
    sphere = str(bumpy_sphere(tmp_path, 10))
    write_obj(tetrahedron(), tmp_path / "low.obj")  # its texture coordinates overlap
    simplify = ("simplify", sphere, "-o", "out")
    assert "the low-poly mesh '" in rejected(*simplify, "--init", "none.obj")
    assert "none.obj' does not exist" in rejected(*simplify, "--init", "none.obj")
    assert "sphere has 200 triangles (92 vertices), above the budget of 50" in (
        rejected(*simplify, "--init", sphere, "-n", "50")
    )
    assert "texture coordinates of low cannot be kept: its own overlap on" in (
        rejected(*simplify, "--init", "low.obj", "--keep-uv")
    )
    assert "texture coordinates of low cannot be kept" in rejected("bake", sphere, "low.obj", "--keep-uv", "-o", "out")
    assert "`keep_uv` is about the texture coordinates of `mesh: FILE`" in rejected(*simplify, "--keep-uv", "-n", "50")


def test_what_to_fit_that_makes_no_sense(rejected):
    simplify = ("simplify", "sample:relic", "-o", "out")
    assert "'colour' is nothing that is fitted" in rejected(*simplify, "--skip", "colour")
    assert "nothing is left to fit" in rejected(*simplify, "--normal-only", "--skip", "kd,normal")


# ------------------------------------------------------------------ configuration and usage


def test_a_bad_config_is_one_line(tmp_path, rejected):
    (tmp_path / "job.yaml").write_text("asset: sample:relic\noptimizer: {stpes: 3}\n")
    assert "optimizer.stpes: unknown key, did you mean 'steps'?" in rejected("run", "job.yaml", "-o", "out")
    (tmp_path / "job.yaml").write_text("asset: sample:relic\noptimizer: {steps: three}\n")
    assert "optimizer.steps: should be a valid integer, got 'three'" in rejected("run", "job.yaml", "-o", "out")
    assert "none.yaml: no such configuration file" in rejected("run", "none.yaml", "-o", "out")
    assert "key.subkey=value" in rejected("simplify", "sample:relic", "-o", "out", "--set", "optimizer.steps")
    assert "one of fast, balanced, best" in rejected("simplify", "sample:relic", "-o", "out", "--preset", "quick")


def test_bad_usage_is_one_line(rejected):
    assert "Missing argument 'ASSET'" in rejected("simplify")
    assert "No such option '--triangle'" in rejected("simplify", "x.obj", "--triangle", "5").replace(":", "")
    assert "No such command 'simplfy'" in rejected("simplfy")
    assert "unknown image format" in rejected("render", "sample:relic", "-o", "picture.tiff")


# ------------------------------------------------------------------ the output folder


def test_an_out_that_cannot_be_written(tmp_path, rejected):
    sphere = str(bumpy_sphere(tmp_path, 10))
    (tmp_path / "file").write_text("")
    assert "is a file, not a folder" in rejected("simplify", sphere, "-n", "50", "-o", "file")
    assert "file is a file, not a folder" in rejected("simplify", sphere, "-n", "50", "-o", "file/below/out")
    assert "file is a file, not a folder" in rejected("render", sphere, "-o", "file/picture.png")


def test_an_out_that_holds_a_run(tmp_path, rejected):
    sphere = str(bumpy_sphere(tmp_path, 10))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "metrics.json").write_text("{}")
    for command in (["simplify", sphere, "-n", "50"], ["bake", sphere, sphere], ["evaluate", sphere, sphere]):
        assert "already holds a run; pass --overwrite" in rejected(*command, "-o", "out")


def test_a_folder_that_is_no_run_of_ours_is_written_to_and_keeps_its_files(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    folder = RunFolder(tmp_path)
    with folder.opened(), folder.staged() as stage:
        (stage / "model.glb").write_text("new")
    assert files(tmp_path) == {"notes.txt", "model.glb"}


def test_results_appear_together_or_not_at_all(tmp_path):
    folder = RunFolder(tmp_path / "a" / "out")
    with pytest.raises(RuntimeError), folder.opened(), folder.staged() as stage:
        (stage / "model.glb").write_text("half")
        raise RuntimeError
    assert files(tmp_path / "a" / "out") == set()


def test_a_user_error_after_the_start_leaves_nothing_behind(tmp_path):
    from mi_simplify.errors import MeshError

    folder = RunFolder(tmp_path / "a" / "out")
    with pytest.raises(MeshError), folder.opened():
        folder.log(step=1)
        raise MeshError("too late")
    assert files(tmp_path) == set()


def test_a_model_that_is_written_stays_when_its_report_cannot_be(tmp_path):
    from mi_simplify.errors import OutputError

    folder = RunFolder(tmp_path / "out")
    with pytest.raises(OutputError, match="cannot write .*out: No space left on device; make room"), folder.opened():
        with folder.staged() as stage:
            (stage / "model.glb").write_text("good")
        with folder.staged() as stage:
            (stage / "report.html").write_text("half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert files(tmp_path / "out") == {"model.glb"}


def test_overwriting_removes_what_the_earlier_run_left(tmp_path):
    for name in ("config.yaml", "model.usdc", "log.jsonl", "mine.txt"):
        (tmp_path / name).write_text("old")
    with RunFolder(tmp_path, overwrite=True).opened() as folder:
        folder.log(step=1)
    assert files(tmp_path) == {"log.jsonl", "mine.txt"}
    assert (tmp_path / "log.jsonl").read_text() == '{"step": 1}\n'


# ------------------------------------------------------------------ this machine


def run_process(*argv: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "mi_simplify", *argv]
    return subprocess.run(
        command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("name", ["libLLVM-15.so.1", "libLLVM.so.18.1", "missing"])
def test_no_usable_llvm_is_one_line(name, tmp_path):
    sphere = bumpy_sphere(tmp_path, 10)
    if name != "missing":
        (tmp_path / name).write_bytes(b"")
    before = files(tmp_path)
    done = run_process(
        "simplify", str(sphere), "-n", "50", "-o", "out", cwd=tmp_path, DRJIT_LIBLLVM_PATH=str(tmp_path / name)
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
    assert "pip install karellen-llvm-core" in done.stderr
    assert files(tmp_path) == before


def test_cuda_without_a_gpu_is_one_line(tmp_path, rejected, monkeypatch):
    import drjit as dr

    monkeypatch.setattr(dr, "has_backend", lambda backend: False)
    sphere = str(bumpy_sphere(tmp_path, 10))
    for command in (["simplify", sphere, "-n", "50", "-o", "out"], ["evaluate", sphere, sphere]):
        assert "needs an NVIDIA GPU" in rejected(*command, "--variant", "cuda_ad_rgb")


def test_an_unsupported_variant_is_one_line(tmp_path, rejected, monkeypatch):
    sphere = str(bumpy_sphere(tmp_path, 10))
    assert "variant: should be 'llvm_ad_rgb' or 'cuda_ad_rgb'" in (
        rejected("simplify", sphere, "-n", "50", "-o", "out", "--variant", "scalar_rgb")
    )
    assert "use one of llvm_ad_rgb, cuda_ad_rgb" in rejected("evaluate", sphere, sphere, "--variant", "scalar_rgb")


# ------------------------------------------------------------------ exit codes and output


def test_help_is_instant_and_complete(tmp_path):
    start = time.perf_counter()
    done = run_process("--help", cwd=tmp_path)
    assert time.perf_counter() - start < 2.0
    assert done.returncode == 0
    for command in (
        "simplify", "run", "bake", "evaluate", "compare", "report", "render", "doctor", "version", "config-schema",
    ):  # fmt: skip
        assert f"  {command} " in done.stdout
    heavy = "import sys; from mi_simplify import cli; cli.main(['--help']); print([m for m in %r if m in sys.modules])"
    program = heavy % ["mitsuba", "drjit", "numpy", "pydantic", "rich"]
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_version_and_no_arguments(capsys):
    import mi_simplify

    assert cli.main(["version"]) == 0
    assert capsys.readouterr().out == f"mi-simplify {mi_simplify.__version__}\n"
    assert cli.main([]) == 0
    assert capsys.readouterr().out.startswith("Usage: mi-simplify")


def test_doctor_succeeds_here(capsys):
    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "libLLVM" in out
    assert "FAIL" not in out


def test_a_defect_of_ours_is_code_1_with_a_traceback(monkeypatch, capsys):
    monkeypatch.setattr(job, "run_job", lambda *a, **k: 1 / 0)
    assert cli.main(["simplify", "x.obj", "-n", "5", "-o", "out"]) == 1
    err = capsys.readouterr().err
    assert "ZeroDivisionError" in err
    assert "defect of mi_simplify" in err


def test_an_interrupt_is_code_130_and_says_what_is_there(monkeypatch, capsys):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt("out holds the model after 7 of 10 steps")

    monkeypatch.setattr(job, "run_job", interrupted)
    assert cli.main(["simplify", "x.obj", "-n", "5", "-o", "out"]) == 130
    assert capsys.readouterr().err.strip() == "interrupted: out holds the model after 7 of 10 steps"


def test_an_interrupt_inside_a_callback_of_drjit_is_one_too(monkeypatch, capsys):
    import drjit as dr
    import mitsuba as mi

    def interrupted(*args, **kwargs):
        def body(x):
            raise KeyboardInterrupt

        dr.if_stmt((mi.Float(1, 2),), mi.Bool(True, False), body, body)

    monkeypatch.setattr(job, "run_job", interrupted)
    assert cli.main(["simplify", "x.obj", "-n", "5", "-o", "out"]) == 130
    assert capsys.readouterr().err.strip() == "interrupted"


def test_options_reach_the_job(monkeypatch, tmp_path, capsys):
    jobs = []

    class Done:
        def summary(self):
            return "the summary"

    def fake(config, out, progress, *, overwrite, resume):
        jobs.append((config, str(out), overwrite))
        return Done()

    monkeypatch.setattr(job, "run_job", fake)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text("asset: other.obj\nseed: 3\noptimizer: {batch: 2}\n")
    arguments = ["--config", "c.yaml", "--preset", "fast", "--set", "optimizer.spp=2", "--variant", "llvm_ad_rgb"]
    assert cli.main(["simplify", "a.obj", "-n", "77", *arguments, "--overwrite"]) == 0
    config, out, overwrite = jobs[0]
    assert (config.asset, config.initial.triangles, config.seed) == (str(tmp_path / "a.obj"), 77, 3)
    assert (config.optimizer.batch, config.optimizer.spp, config.preset) == (2, 2, "fast")
    assert (config.variant, out, overwrite) == ("llvm_ad_rgb", "out/a", True)
    assert capsys.readouterr().out == "the summary\n"
    assert cli.main(["run", "c.yaml", "-o", "elsewhere", "--quiet"]) == 0
    assert (jobs[1][0].asset, jobs[1][1], jobs[1][2]) == (str(tmp_path / "other.obj"), "elsewhere", False)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("arguments", "initial", "optimize"),
    [
        (["--init", "sphere"], {"kind": "sphere", "mesh": None, "triangles": 3000}, None),
        (["--init", "low.obj"], {"kind": "mesh", "mesh": "low.obj", "triangles": None, "keep_uv": False}, None),
        (["--init", "low.obj", "--keep-uv", "-n", "9"], {"kind": "mesh", "keep_uv": True, "triangles": 9}, None),
        (["--fixed-shape"], {}, ("base_color", "roughness", "metallic", "normal")),
        (["--normal-only"], {}, ("normal",)),
        (["--skip", "kd, orm"], {}, ("vertices", "normal")),
        (["--skip", "kd", "--skip", "metallic", "--fixed-shape"], {}, ("roughness", "normal")),
    ],
)
def test_options_of_the_start_and_of_what_is_fitted(arguments, initial, optimize, monkeypatch, tmp_path):
    jobs = []

    def started(config, *args, **options):
        jobs.append(config)
        return SimpleNamespace(summary=str)

    monkeypatch.setattr(job, "run_job", started)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["simplify", "a.obj", *arguments]) == 0
    found = jobs[0].initial.model_dump()
    found["mesh"] = found["mesh"] and Path(found["mesh"]).name
    assert {key: found[key] for key in initial} == initial
    if optimize is not None:
        assert jobs[0].latent.optimize == optimize
        (tmp_path / "c.yaml").write_text("asset: b.obj\n")
        assert cli.main(["run", "c.yaml", *arguments]) == 0
        assert jobs[1].latent.optimize == optimize


# ------------------------------------------------------------------ end to end


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    """A folder with a sphere and the run of `simplify` over it, started from grey textures."""
    folder = tmp_path_factory.mktemp("toy")
    sphere = bumpy_sphere(folder)
    arguments = ["-n", "300", "--quiet", "--set", "optimizer.steps=60", "--set", "initial.textures=constant"]
    arguments += ["--set", "optimizer.decay=0.3", "--set", "optimizer.rates.base_color=0.03"]
    arguments += ["--set", "evaluation.baseline=true", "--tensorboard"]
    assert cli.main(["simplify", str(sphere), "-o", str(folder / "out"), *arguments, *TOY]) == 0
    return folder


def test_a_toy_job_comes_much_closer_and_writes_everything(toy):
    expected = {"config.yaml", "contact_sheet.png", "log.jsonl", "metrics.json", "report.html", "model.glb"}
    assert expected | {"model.obj", "model.mtl", "model.usdc", "model_base_color.png"} <= files(toy / "out")
    figures = json.loads((toy / "out" / "metrics.json").read_text())
    guess, result = figures["candidates"]["first guess"], figures["candidates"]["result"]
    assert result["triangles"] <= 300
    assert result["psnr"] > guess["psnr"] + 3
    assert list(figures["candidates"]) == ["quadrics", "first guess", "result"]
    assert figures["candidates"]["quadrics"]["triangles"] <= 300
    assert figures["run"]["transport"] == "direct"
    log = [json.loads(line) for line in (toy / "out" / "log.jsonl").read_text().splitlines()]
    assert log[-1]["step"] == 60
    assert log[-1]["loss"] < 0.5 * log[0]["loss"]
    assert len(list((toy / "out" / "tensorboard").iterdir())) == 1


def test_the_resolved_config_describes_the_run(toy):
    config = load_config(toy / "out" / "config.yaml")
    assert config.asset == str(toy / "sphere.ply")
    assert (config.optimizer.steps, config.initial.triangles, config.variant) == (60, 300, "llvm_ad_rgb")


def test_the_result_stands_where_the_input_stood(toy):
    from mi_simplify.scenes.load import load_asset

    before, after = load_asset(toy / "sphere.ply").bounds, load_asset(toy / "out" / "model.glb").bounds
    assert np.abs(before - after).max() < 0.05 * (before[1] - before[0]).max()


def test_evaluate_bake_and_render_on_the_result(toy, tmp_path, capsys):
    sphere, model = str(toy / "sphere.ply"), str(toy / "out" / "model.glb")
    small = ["--views", "2", "--resolution", "64", "--spp", "8"]
    assert cli.main(["evaluate", sphere, model, sphere, *small, "-o", str(tmp_path / "judged"), "-q"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 2
    assert "3200 triangles" in rows[1]
    figures = json.loads((tmp_path / "judged" / "metrics.json").read_text())["candidates"]
    assert figures[sphere]["psnr"] > figures[model]["psnr"]

    assert cli.main(["bake", sphere, model, "-o", str(tmp_path / "baked"), "--atlas-size", "64"]) == 0
    assert (tmp_path / "baked" / "model.glb").is_file()

    assert cli.main(["render", model, "-o", str(tmp_path / "p.png"), "--resolution", "48", "--spp", "8"]) == 0
    from PIL import Image

    image = np.asarray(Image.open(tmp_path / "p.png"))
    assert image.shape == (48, 48, 3)
    assert image[24, 24].min() > 20
    assert image[0, 0].max() == 0
    assert cli.main(["render", sphere, "-o", str(tmp_path / "p.exr"), "--resolution", "16", "--spp", "1"]) == 0
    assert (tmp_path / "p.exr").stat().st_size > 500


def test_the_report_of_a_run_is_built_again_from_its_folder(toy, tmp_path, capsys, rejected):
    folder = tmp_path / "moved"
    shutil.copytree(toy / "out", folder)
    before = (folder / "report.html").read_text()
    (folder / "report.html").unlink()
    assert cli.main(["report", str(folder)]) == 0
    assert capsys.readouterr().out == f"{folder / 'report.html'}\n"
    assert (folder / "report.html").read_text() == before
    assert all(part in before for part in ('id="viewer"', "reference, 3,200 triangles", 'id="curves"', "roughness"))
    (folder / "model.glb").write_bytes(b"glTF")
    assert "model.glb" in rejected("report", str(folder))
    assert "none holds no finished run; name a folder" in rejected("report", "none")


def test_candidates_are_compared_in_a_report(toy, tmp_path, capsys, rejected):
    sphere, model = str(toy / "sphere.ply"), str(toy / "out" / "model.glb")
    small = ["--views", "2", "--resolution", "48", "--spp", "4"]
    out = tmp_path / "side"
    assert cli.main(["compare", sphere, model, sphere, *small, "-o", str(out), "--quiet"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    text = (out / "report.html").read_text()
    assert text.count("<option") > 10
    assert "reference, 3,200 triangles" in text and "out/model.glb, 300 triangles" in text
    assert "already holds a run" in rejected("compare", sphere, model, "-o", str(out))
    assert "Missing option '--out'" in rejected("compare", sphere, model)


@pytest.fixture(scope="module")
def start(toy) -> tuple[Path, dict]:
    """A low-poly mesh with UVs of its own, and the first guess that `simplify --init` makes of it, not fitted."""
    low = toy / "out" / "model.obj"
    guess = ["simplify", str(toy / "sphere.ply"), "--init", str(low), "--keep-uv", "--set", "optimizer.steps=0"]
    guess += ["--set", "initial.textures=constant"]  # so that every quantity has something to gain
    assert cli.main([*guess, "-o", str(toy / "guess"), "--quiet", *TOY]) == 0
    return low, parts_of(toy / "guess" / "model.glb")


def parts_of(path: Path) -> dict[str, np.ndarray]:
    """What a fit may change, by the name that --skip has for it, and what it never does."""
    from mi_simplify.scenes.load import load_asset

    (part,) = load_asset(path).parts
    material = part.material
    return {"shape": part.vertices, "kd": material.base_color, "orm": material.specular, "normal": material.normal,
            "uvs": part.uvs, "faces": part.faces}  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "fitted"),
    [
        (["--normal-only"], {"normal"}),
        (["--fixed-shape"], {"kd", "orm", "normal"}),
        (["--skip", "kd,orm"], {"shape", "normal"}),
        (["--skip", "normal"], {"shape", "kd", "orm"}),
    ],
)
def test_what_is_not_fitted_stays_to_the_bit(arguments, fitted, start, toy, tmp_path):
    low, guess = start
    run = ["simplify", str(toy / "sphere.ply"), "--init", str(low), "--keep-uv", "--set", "optimizer.steps=8"]
    run += ["--set", "initial.textures=constant", "--set", "optimizer.batch=4", "--set", "optimizer.spp=4"]
    fast = [f"--set=optimizer.rates.{name}=0.05" for name in ("base_color", "specular", "normal")]
    assert cli.main([*run, *arguments, *fast, "--set=evaluation.every=8", "-o", str(tmp_path), "--quiet", *TOY]) == 0
    result = parts_of(tmp_path / "model.glb")
    changed = {name for name in result if not np.array_equal(result[name], guess[name])}
    assert changed == fitted


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_ctrl_c_leaves_the_model_as_far_as_it_got(tmp_path):
    sphere = bumpy_sphere(tmp_path)
    command = [sys.executable, "-m", "mi_simplify", "simplify", str(sphere), "-n", "300", "-o", "out", *TOY]
    process = subprocess.Popen(
        [*command, "--set", "optimizer.steps=100000"], cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
        text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not (tmp_path / "out" / "log.jsonl").exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err.strip().startswith("interrupted: out holds the best model of "), err
    assert err.strip().endswith("of 100000 steps; the same command with --resume goes on"), err
    assert (tmp_path / "out" / "model.glb").is_file()
