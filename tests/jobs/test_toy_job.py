"""A toy job end to end through the command line, and every command on its result."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support.toy import TOY, bumpy_sphere, files

from mi_simplify import cli
from mi_simplify.config import load_config


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
    from mi_simplify.formats.load import load_asset

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
    capsys.readouterr()
    assert cli.main(["render", sphere, "-o", str(tmp_path / "p.exr"), "--resolution", "16", "--spp", "1"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'p.exr'}\n"
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
def starts(toy) -> dict[float, tuple[Path, dict]]:
    """
    Low-poly meshes with UVs of their own by how large they are, so that shapes have something to gain as well, and the
    first guess that `simplify --init` makes of each, not fitted.
    """
    lines = [line.split() for line in (toy / "out" / "model.obj").read_text().splitlines()]
    out = {}
    for size in (1.0, 0.98):
        low, folder = toy / f"low{size}.obj", toy / f"guess{size}"
        scaled = [["v", *(str(size * float(x)) for x in line[1:])] if line[:1] == ["v"] else line for line in lines]
        low.write_text("\n".join(" ".join(line) for line in scaled if line[:1] not in (["mtllib"], ["usemtl"])))
        guess = ["simplify", str(toy / "sphere.ply"), "--init", str(low), "--keep-uv", "--set", "optimizer.steps=0"]
        guess += ["--set", "initial.textures=constant"]  # so that every quantity has something to gain
        assert cli.main([*guess, "-o", str(folder), "--quiet", *TOY]) == 0
        out[size] = low, parts_of(folder / "model.glb")
    return out


def test_what_no_step_changed_is_judged_alike(starts, toy):
    """The first guess as a file as well, for 8 bits a texel alone cost FLIP where models are good."""
    figures = json.loads((toy / "guess1.0" / "metrics.json").read_text())["candidates"]
    for key in ("psnr", "flip", "silhouette_error"):
        assert figures["result"][key] == pytest.approx(figures["first guess"][key], rel=1e-4)


def parts_of(path: Path) -> dict[str, np.ndarray]:
    """What a fit may change, by the name that --skip has for it, and what it never does."""
    from mi_simplify.formats.load import load_asset

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
def test_what_is_not_fitted_stays_to_the_bit(arguments, fitted, starts, toy, tmp_path):
    low, guess = starts[0.98 if "shape" in fitted else 1.0]
    run = ["simplify", str(toy / "sphere.ply"), "--init", str(low), "--keep-uv", "--set", "optimizer.steps=16"]
    run += ["--set", "initial.textures=constant", "--set", "optimizer.batch=4", "--set", "optimizer.spp=4"]
    fast = [f"--set=optimizer.rates.{name}=0.02" for name in ("base_color", "specular", "normal")]
    assert cli.main([*run, *arguments, *fast, "--set=evaluation.every=4", "-o", str(tmp_path), "--quiet", *TOY]) == 0
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
    first, *_, last = err.strip().splitlines()
    assert first == "warning: stopping after this step; once more stops at once", err
    assert last.startswith("interrupted: out holds the best model of "), err
    assert last.endswith("of 100000 steps; the same command with --resume goes on"), err
    assert (tmp_path / "out" / "model.glb").is_file()
