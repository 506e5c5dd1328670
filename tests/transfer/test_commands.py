"""The commands, through real files."""

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
