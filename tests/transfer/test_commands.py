"""The commands, through real files."""

import json

import pytest

from mi_simplify import cli

SMALL = ["--size", "16", "--frames", "6", "--directions", "16", "--quiet"]


def test_bake_and_predict(tmp_path, capsys):
    out = tmp_path / "fish.npz"
    assert cli.main(["transfer", "bake", "sample:fish:2000", "-o", str(out), *SMALL]) == 0
    assert cli.main(["transfer", "predict", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["linear", "unshadowed"]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("sample:relic", "an animated model expected"),
        ("sample:walker", "choose with 'part' one of"),
        ("none.npz", "blend shapes expected"),
    ],
)
def test_what_cannot_be_baked_is_one_line(rejected, source, message):
    assert message in rejected("transfer", "bake", source, "-o", "data.npz", *SMALL)


OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nv 3 0 0\nv 3 1 0\n"
STRIP, RING = "f 1 2 3\nf 1 3 4\n", "f 1 2 3\nf 1 3 4\nf 2 5 6\nf 2 6 3\nf 5 7 8\nf 5 8 6\nf 7 1 4\nf 7 4 8\n"


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([OBJ + RING, OBJ + RING], "one border expected, it has 2; close its holes"),
        ([OBJ + STRIP, OBJ + STRIP.replace("1 3 4", "1 4 3")], "the faces of 0.obj expected, this frame has others"),
        ([OBJ + STRIP, OBJ.replace("v 1 1 0", "v 1 nan 0") + STRIP], "1.obj"),
    ],
    ids=["two borders", "other topology", "NaN"],
)
def test_folders_that_cannot_be_baked_are_one_line(rejected, tmp_path, frames, message):
    (tmp_path / "frames").mkdir()
    for k, text in enumerate(frames):
        (tmp_path / "frames" / f"{k}.obj").write_text(text)
    assert message in rejected("transfer", "bake", "frames", "-o", "data.npz", *SMALL)


def settings(tmp_path, text: str) -> str:
    path = tmp_path / "transfer.yaml"
    path.write_text(f"source: cloth\nbake: {{size: 8, frames: 12, directions: 8}}\n{text}")
    return str(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("train: {model: large}", "train.model"),
        ("train: {minuts: 3}", "did you mean 'minutes'"),
        ("shown: 0", "shown"),
    ],
)
def test_settings_of_a_run_are_checked(rejected, tmp_path, text, message):
    assert message in rejected("transfer", "run", settings(tmp_path, text), "-o", str(tmp_path / "out"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_run_leaves_everything_and_goes_on(rejected, tmp_path, capsys):
    for name in ("torch", "onnxruntime", "onnxscript"):
        pytest.importorskip(name, reason=f"no {name}: install the extra 'transfer'")
    config, out = settings(tmp_path, "train: {epochs: 2}"), tmp_path / "out"
    assert cli.main(["transfer", "run", config, "-o", str(out), "--quiet"]) == 0
    network = (out / "network.onnx").read_bytes()
    figures = json.loads((out / "figures.json").read_text())
    assert len(figures["history"]) == 2 and {"network", "linear", "unshadowed"} == set(figures["models"])
    (out / "report.html").unlink()
    assert cli.main(["transfer", "run", config, "-o", str(out)]) == 0
    assert (out / "network.onnx").read_bytes() == network and (out / "report.html").exists()
    capsys.readouterr()
    fine = str(tmp_path / "fine.npz")
    assert cli.main(["transfer", "bake", "cloth", "-o", fine, *SMALL]) == 0
    assert "images of 8² pixels expected by this network, these have 16²" in rejected(
        "transfer", "predict", fine, str(out / "network.onnx")
    )
    other = settings(tmp_path, "train: {epochs: 3}")
    assert "a run with other settings" in rejected("transfer", "run", other, "-o", str(out))
