"""
Every command and every Python snippet of README.md and docs/ runs, in a folder with the files that they name.
"""

import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support import heads
from support.paths import ROOT
from support.short import SHORT

from mi_simplify import cli
from mi_simplify.formats.captured.write import write_captured
from mi_simplify.formats.load import load_asset
from mi_simplify.initial.sphere import sphere
from mi_simplify.judging import switching
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import goniometer

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.S | re.M)


def commands() -> list[str]:
    lines = [line for page in PAGES for block in blocks(page, "sh") for line in block.splitlines()]
    found = {line.split(" #")[0].strip() for line in lines if line.startswith("mi-simplify ")}
    return sorted({line.replace(" -n ", " --triangles ") for line in found})


def write_obj(path: Path, positions: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x} {y} {z}" for x, y, z in positions] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("finished")
    write_obj(folder / "statue.obj", *waves(2400))
    assert run(f"mi-simplify simplify {folder}/statue.obj --triangles 200 -o {folder}/run --quiet") == 0
    return folder / "run"


@pytest.fixture
def workplace(finished, tmp_path, monkeypatch) -> Path:
    """The current folder, with the files that the documentation speaks of."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(switching, "SIZES", (64, 32))  # of `lod`
    write_obj(tmp_path / "statue.obj", *waves(2400))
    positions, faces = waves(2400)
    np.savetxt(tmp_path / "statue.soup", positions[faces].reshape(-1, 9))
    for path in finished.glob("model*"):
        shutil.copy(path, tmp_path)
    (tmp_path / "model.obj").rename("my_lowpoly.obj")
    (tmp_path / "model.glb").rename("other.glb")
    shutil.copy("other.glb", "initial.glb")
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    (tmp_path / "models").mkdir()
    shutil.copy("statue.obj", "models")
    for page in PAGES:
        for block in blocks(page, "yaml"):
            if block.startswith("asset: statue.obj"):
                (tmp_path / "statue.yaml").write_text(block)
            if block.startswith("defaults:"):
                (tmp_path / "library.yaml").write_text(block)
        for block in blocks(page, "python"):
            if block.startswith(("# mushroom.py", "# mine.py")):
                (tmp_path / block.split()[1]).write_text(block)
    views = goniometer(12, np.random.default_rng(0), width=32, height=32, irradiance=np.pi)
    write_captured("images", views.arrays(), make_reference(load_asset("statue.obj"), spp=4).render(views))
    return tmp_path


def waves(n: int) -> tuple[np.ndarray, np.ndarray]:
    positions, faces = sphere(n)
    return positions * (1 + 0.1 * np.sin(5 * positions)), faces


def run(line: str) -> int:
    """The exit code of a command, of which a documented run is made a short one."""
    argv = shlex.split(line)[1:]
    if argv[0] == "simplify":
        argv = ["300" if before == "--triangles" else text for before, text in zip(["", *argv], argv, strict=False)]
    if argv[0] in ("simplify", "fit", "run", "lod", "batch"):
        argv += [x for setting in SHORT for x in ("--set", setting)]
    if argv[0] in ("evaluate", "compare"):
        argv += ["--views", "1", "--resolution", "32", "--spp", "4"]
    return cli.main(argv)


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", [line for line in commands() if "--resume" not in line and "--renderer three" not in line]
)  # see test_checkpoint.py and test_three.py
def test_a_documented_command_succeeds(line, workplace, finished, capsys):
    """Folders and files of earlier runs are there where the command does not write them."""
    argv = shlex.split(line)
    written = argv[argv.index("-o") + 1] if "-o" in argv else ""
    if argv[1] == "face":
        heads.portraits(workplace)
    for folder in {"out/statue", "out/demo"} - {written}:
        shutil.copytree(finished, workplace / folder)
    assert run(line) == 0, capsys.readouterr().err


def documented(start: str, **words: object) -> list[str]:
    """Words of the line of docs/batch.md that begins so, with others for those that stand for something."""
    line = next(x for b in blocks(ROOT / "docs" / "batch.md", "text") for x in b.splitlines() if x.startswith(start))
    for word, value in words.items():
        line = line.replace(word, str(value))
    return shlex.split(line, comments=True)


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.slow
def test_the_documented_cluster_makes_the_library(workplace):
    """Nodes and driver are processes of their own, since Ray keeps what it once read of its environment."""
    pytest.importorskip("ray", reason="the extra [batch]")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"127.0.0.1:{port}"
    mode = documented("export RAY_AUTH_MODE")[1].partition("=")[2]
    own = {"RAY_ADDRESS": address, "RAY_AUTH_MODE": mode, "RAY_AUTH_TOKEN": "5" * 64}  # 'auto' is the address named
    head, other = documented("ray start --head"), documented("ray start --address", **{"HEAD:6379": address})
    nodes = []
    try:
        for line in ([*head, f"--port={port}", "--include-dashboard=false"], other):
            line = [str(Path(sys.executable).with_name("ray")), *line[1:], "--num-cpus=1", "--block"]
            nodes.append(subprocess.Popen(line, env=os.environ | own, stdout=subprocess.DEVNULL))
            while not _answers(port):
                assert nodes[0].poll() is None
                time.sleep(0.1)
        words = documented("mi-simplify batch", **{"/shared": workplace / "shared"})[1:]
        words += [x for setting in SHORT for x in ("--set", setting)]
        line = [sys.executable, "-m", "mi_simplify", *words]
        done = subprocess.run(line, env=os.environ | own, capture_output=True, text=True, timeout=200, check=False)
        assert done.returncode == 0, done.stderr
    finally:
        for node in reversed(nodes):
            node.terminate()
            node.wait(60)
    lines = [json.loads(x) for x in (workplace / "shared" / "library" / "results.jsonl").read_text().splitlines()]
    assert sorted((x["name"], x["code"]) for x in lines) == [("statue", 0), ("statue-far", 0)]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of Ray
def test_the_documented_array_of_slurm_takes_every_asset_once(workplace):
    """As a dry line: what a job of the array runs, with its number, and assets of which nothing is made."""
    pytest.importorskip("ray", reason="the extra [batch]")
    sbatch, array, wrap, line = documented("sbatch", **{"/shared": workplace / "shared"})
    first, last = map(int, re.fullmatch(r"--array=(\d+)-(\d+)", array).groups())
    assert (sbatch, wrap) == ("sbatch", "--wrap") and line.endswith(f"/{last}")
    for k in range(first, last + 1):
        assert cli.main([*shlex.split(line.replace("$SLURM_ARRAY_TASK_ID", str(k)))[1:], "--command", "none"]) == 0
    lines = [json.loads(x) for x in (workplace / "shared" / "library" / "results.jsonl").read_text().splitlines()]
    assert sorted(x["name"] for x in lines) == ["statue", "statue-far"]


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.name)
def test_documented_snippets_run_in_their_order(page, workplace, monkeypatch):
    import mi_simplify as ms

    load = ms.load_config
    monkeypatch.setattr(ms, "load_config", lambda *, overrides: load(overrides=[*overrides, *SHORT]))
    names: dict = {}
    for snippet in blocks(page, "python"):
        if not snippet.startswith("# mine.py"):  # which a documented command runs
            exec(compile(snippet, page.name, "exec"), names)
