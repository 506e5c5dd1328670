"""Batches through Ray: on this machine, on two nodes of which one dies, and from the command line."""

import json
import os

import pytest
from support.short import SHORT
from support.toy import bumpy_sphere

from mi_simplify import cli
from mi_simplify.jobs.batch.batch import batch_job
from mi_simplify.jobs.batch.entries import Entry
from mi_simplify.machine.files import output_error

ray = pytest.importorskip("ray", reason="the extra [batch]")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600), pytest.mark.filterwarnings("default")]


def lines(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "results.jsonl").read_text().splitlines()]


def test_from_the_command_line_and_again(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").mkdir()
    for n in (10, 12):
        bumpy_sphere(tmp_path, n).rename(tmp_path / "models" / f"sphere{n}.ply")
    (tmp_path / "models" / "broken.glb").write_bytes(b"glTF")
    settings = [text for setting in [*SHORT, "export.formats=glb"] for text in ("--set", setting)]
    command = ["batch", "models", "-o", "out", "--triangles", "60", *settings]
    assert cli.main(command) == 2
    assert "broken: exit code 2: broken.glb: the GLB file is truncated" in capsys.readouterr().out
    assert {(row["name"], row["code"]) for row in lines(tmp_path / "out")} == {
        ("sphere10", 0), ("sphere12", 0), ("broken", 2),
    }  # fmt: skip
    for name in ("sphere10", "sphere12"):
        assert {"model.glb", "report.html", "thumbnail.jpg", "batch.json"} <= {
            path.name for path in (tmp_path / "out" / name).iterdir()
        }
    page = (tmp_path / "out" / "index.html").read_text()
    assert "sphere10/thumbnail.jpg" in page and "2 done, 1 failed, 0 waiting" in page
    made = (tmp_path / "out" / "sphere10" / "model.glb").stat().st_mtime_ns

    (tmp_path / "models" / "broken.glb").unlink()
    bumpy_sphere(tmp_path, 14).rename(tmp_path / "models" / "sphere12.ply")  # another asset by that name
    assert cli.main(command) == 0
    assert [row["name"] for row in lines(tmp_path / "out")[3:]] == ["sphere12"]
    assert (tmp_path / "out" / "sphere10" / "model.glb").stat().st_mtime_ns == made


def test_two_nodes_of_which_one_dies(tmp_path):
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    second = cluster.add_node(num_cpus=1)
    entries = [Entry(asset=f"m{k}.obj", name=f"m{k:03}", command="none") for k in range(300)]
    seen = []

    def kill_one(event) -> None:
        seen.append(event.step)
        if len(seen) == 40:
            cluster.remove_node(second, allow_graceful=False)

    try:
        made = batch_job(entries, tmp_path, kill_one, address=cluster.address)
    finally:
        cluster.shutdown()
    assert made.exit_code == 0 and seen[-1] == 300
    assert sorted(row["name"] for row in lines(tmp_path)) == [e.name for e in entries]  # none lost, none twice


def test_shards_share_a_folder(tmp_path):
    entries = [Entry(asset=f"m{k}.obj", name=f"m{k}", command="none") for k in range(7)]
    for i in (1, 2):
        made = batch_job(entries, tmp_path, shard=(i, 2), jobs=1)
        assert [e.name for e in made.entries] == [e.name for e in entries[i - 1 :: 2]] and made.exit_code == 0
    assert sorted(row["name"] for row in lines(tmp_path)) == [e.name for e in entries]


def test_what_cannot_be_written_ends_the_batch_with_one_line(tmp_path, capsys):
    (tmp_path / "a.ply").write_text("")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a").write_text("somebody's")
    assert cli.main(["batch", str(tmp_path / "a.ply"), "--command", "none", "-o", str(tmp_path / "out")]) == 2
    assert (
        capsys.readouterr().err
        == f"error: {output_error(tmp_path / 'out' / 'a', FileExistsError(17, 'File exists'))}\n"
    )


def test_without_a_cluster_there_is_one_line(tmp_path, capsys):
    (tmp_path / "a.ply").write_text("")
    os.environ.pop("RAY_ADDRESS", None)
    assert cli.main(["batch", str(tmp_path / "a.ply"), "-o", str(tmp_path / "out"), "--address", "127.0.0.1:1"]) == 2
    assert "no Ray cluster could be used at 127.0.0.1:1" in capsys.readouterr().err
