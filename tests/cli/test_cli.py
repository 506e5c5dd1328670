"""The command line: every bad input is exit code 2, one line, nothing written; what options mean."""

import errno
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.features import made
from support.toy import bumpy_sphere, files

from mi_simplify import cli
from mi_simplify.export import write_glb, write_obj
from mi_simplify.jobs import job
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.model import Model
from mi_simplify.record.output import RunFolder


def tetrahedron() -> Model:
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Mesh(positions, np.arange(4), np.float32([[0, 0], [1, 0], [0, 1], [1, 1]]), faces)
    return Model(mesh, np.full((4, 4, 4), 0.5, np.float32), np.tile(np.float32([0, 0.5, 0]), (4, 4, 1)),
                 np.tile(np.float32([0, 0, 1]), (4, 4, 1)))  # fmt: skip


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
    (folder / "model.max").write_bytes(b"3D Studio")
    return "model.max"


def a_folder(folder: Path) -> str:
    (folder / "folder.obj").mkdir()
    return "folder.obj"


BAD_ASSETS = {
    "missing": (lambda folder: "none.obj", "none.obj' does not exist"),
    "unreadable": (a_folder, "folder.obj' is no file"),
    "unknown format": (unknown_format, "unknown format '.max'"),
    "an address": (lambda folder: "https://host.example/a.glb", "'https://host.example/a.glb' is an address"),
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
    for wrong, said in (("3", "greater than or equal to 4"), ("0%", "a share such"), ("120%", "a share such")):
        assert said in rejected("simplify", sphere, "-n", wrong, "-o", "out")
    assert "got '12 parsecs'" in rejected("simplify", sphere, "-n", "12 parsecs", "-o", "out")
    assert "two budgets for one thing" in rejected("simplify", sphere, "-n", "50", "--vertices", "90", "-o", "out")
    assert "`vertices` and `kind: mesh` do not go together" in (
        rejected("simplify", sphere, "--init", sphere, "--vertices", "90", "-o", "out")
    )
    assert "initial.triangles: should be greater than or equal to 4, got 3" in (
        rejected("simplify", sphere, "--set", "initial.triangles=3", "-o", "out")
    )
    assert "budget of 9999 triangles is above the input's own 200 (92 vertices); ask for fewer" in (
        rejected("simplify", sphere, "-n", "9999", "-o", "out")
    )
    assert "ask for fewer, as with --triangles 100" in rejected("simplify", sphere, "-o", "out")


def test_frames_of_what_has_no_skeleton_are_one_line(tmp_path, rejected):
    sphere = str(bumpy_sphere(tmp_path, 10))
    assert "sphere has no skeleton, so it has no frames; leave --frames" in (
        rejected("simplify", sphere, "-n", "50", "--frames", "1:3", "-o", "out")
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


def test_a_replaced_run_takes_its_textures_with_it_and_nobody_elses(tmp_path):
    (tmp_path / "displacement").mkdir()
    for name in ("model_normal.png", "model.mtl", "displacement/height.png"):
        (tmp_path / name).write_text("old")
    with RunFolder(tmp_path).opened() as folder:
        assert files(tmp_path) == {"model_normal.png", "model.mtl", "displacement", "displacement/height.png"}
        folder.log(step=1)
    with RunFolder(tmp_path, overwrite=True).opened():
        assert files(tmp_path) == set()


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

    for argv in (["version"], ["--version"]):
        assert cli.main(argv) == 0
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
        alarm = None
        growth: tuple = ()

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
    quick = config.evaluation
    assert cli.main(["run", "c.yaml", "-o", "elsewhere", "--quiet", "--time", "1.5min", "--evaluate", "full"]) == 0
    config = jobs[1][0]
    assert config.optimizer.time == 90 and config.evaluation.baseline and config.evaluation.spp > quick.spp
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
        (["--skip", "kd, orm"], {}, ("vertices", "displacement", "vertex_sets", "skinning", "normal")),
        (["--skip", "kd", "--skip", "metallic", "--fixed-shape"], {}, ("roughness", "normal")),
    ],
)
def test_options_of_the_start_and_of_what_is_fitted(arguments, initial, optimize, monkeypatch, tmp_path):
    jobs = []

    def started(config, *args, **options):
        jobs.append(config)
        return SimpleNamespace(summary=str, alarm=None, growth=())

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


def test_inspect_lists_what_a_file_holds(tmp_path, capsys):
    path = tmp_path / "a.glb"
    path.write_bytes(made("emission", "clear coat", "mask", "lights").bytes())
    assert cli.main(["inspect", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["triangles"] == 2 and found["parts"] == [
        {"name": "quad", "triangles": 2, "placed": 1, "material": "m"}
    ]  # fmt: skip
    (material,) = found["materials"]
    assert material["alpha_mode"] == "MASK" and material["textures"] == {"base colour": "8 x 8", "emission": "8 x 8"}
    assert {"emission", "opacity", "base colour"} <= set(found["baked"])
    assert "KHR_materials_clearcoat of 'm': its factors" in found["kept"]
    assert "lights were left out" in found["left_out"] and "KHR_lights_punctual" in found["extensions"]
    assert cli.main(["inspect", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "a.glb: 2 triangles, 1 x 1 x 0" and "  lights were left out" in lines
    assert cli.main(["inspect", str(tmp_path / "missing.glb")]) == 2
