"""What is on the disk of a batch, whatever interrupted it; and the page of it."""

import json
import os

import pytest

from mi_simplify.errors import OutputError
from mi_simplify.jobs.batch import work
from mi_simplify.jobs.batch.batch import Batch
from mi_simplify.jobs.batch.entries import Entry
from mi_simplify.jobs.batch.ledger import Ledger, Outcome
from mi_simplify.jobs.batch.needs import expected_memory
from mi_simplify.jobs.batch.overview import write_overview


def entries(n: int) -> list[Entry]:
    return [Entry(asset=f"model{k}.obj", name=f"m{k}", command="none") for k in range(n)]


def outcome(entry: Entry, code: int = 0, **more) -> Outcome:
    return Outcome(entry.name, entry.fingerprint(), code, "" if code == 0 else "it failed", **more)


def test_what_is_done_and_unchanged_is_not_left(tmp_path):
    ours = entries(5)
    ledger = Ledger(tmp_path, ours)
    for entry, code in zip(ours, (0, 0, 2, 1), strict=False):
        if code == 0:
            work.work(entry, entry.fingerprint(), str(tmp_path), work.Limits())
        ledger.append(outcome(entry, code))
    with open(tmp_path / "results.jsonl", "a") as file:
        file.write('{"name": "m4", "fingerp')  # the machine stopped here
    ours[1] = ours[1].model_copy(update={"triangles": "7"})  # asked for anew, otherwise
    left = Ledger(tmp_path, ours).left(ours)
    assert [e.name for e in left] == ["m1", "m2", "m3", "m4"]
    assert [row["name"] for row in json.loads((tmp_path / "manifest.json").read_text())["assets"]] == [
        e.name for e in ours
    ]


def test_a_result_without_its_line_counts_and_a_line_without_its_result_does_not(tmp_path):
    ours = entries(2)
    work.work(ours[0], ours[0].fingerprint(), str(tmp_path), work.Limits())  # the driver died before it wrote the line
    Ledger(tmp_path, ours).append(outcome(ours[1]))
    ledger = Ledger(tmp_path, ours)
    assert [e.name for e in ledger.left(ours)] == ["m1"]
    assert (tmp_path / "results.jsonl").read_text().count('"m0"') == 1


def test_a_torn_line_is_followed_by_a_whole_one(tmp_path):
    ours = entries(1)
    (tmp_path / "results.jsonl").write_text('{"name":')
    ledger = Ledger(tmp_path, ours)
    work.work(ours[0], ours[0].fingerprint(), str(tmp_path), work.Limits())
    ledger.append(outcome(ours[0]))
    assert Ledger(tmp_path, ours).left(ours) == []


def test_a_full_disk_is_one_line(tmp_path, monkeypatch):
    ours = entries(1)
    ledger = Ledger(tmp_path, ours)
    write = os.write
    monkeypatch.setattr("os.write", lambda handle, line: write(handle, line[:3]))
    with pytest.raises(OutputError, match=r"cannot write .*results\.jsonl: No space left on device"):
        ledger.append(outcome(ours[0], 2))
    monkeypatch.undo()  # somebody made room
    ledger.append(outcome(ours[0], 2))
    assert Ledger(tmp_path, ours).outcomes == {"m0": outcome(ours[0], 2)}


def test_a_full_disk_is_not_the_fault_of_an_entry(tmp_path, monkeypatch):
    program = tmp_path / "program"
    program.write_text(
        "#!/bin/sh\necho error: cannot write m0: No space left on device\\; choose another >&2\nexit 2\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr(work.sys, "executable", str(program))
    with pytest.raises(OutputError, match="^cannot write m0: No space left on device; make room, and the same command"):
        work.work(Entry(asset="a.ply", name="m0"), "f", str(tmp_path), work.Limits())


def test_memory_is_forecast_by_settings_and_headers(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\n" * 100_000)
    entry = Entry(asset=str(path), name="a")
    expected = expected_memory(entry)
    assert 1 << 30 < expected < 3 << 30
    assert expected_memory(entry.model_copy(update={"settings": {"initial.atlas_size": 2048}})) > expected + (2 << 30)
    assert expected_memory(entry, 5 << 30) == 5 << 30
    assert expected_memory(entry.model_copy(update={"command": "none"})) == 1 << 20
    assert expected_memory(entry.model_copy(update={"settings": {"initial.atlas": 1}})) > 1 << 29  # it fails by itself
    path.write_text("v 0 0 0\n" * 10_000_000)
    assert expected_memory(entry) > expected + (2 << 30)


def test_exit_codes_say_whose_fault_it_was(tmp_path):
    ours = entries(3)

    def batch(*codes):
        return Batch(tmp_path, ours, {e.name: outcome(e, c) for e, c in zip(ours, codes, strict=False)})

    assert [batch(*codes).exit_code for codes in ((0, 0, 0), (0, 2, 0), (0, 2, 1), (0, 0))] == [0, 2, 1, 1]
    assert batch(0, 2, 0).summary().splitlines()[0] == "m1: exit code 2: it failed"


def test_a_broken_file_fails_in_its_own_process_and_leaves_nothing(tmp_path):
    path = tmp_path / "broken.glb"
    path.write_bytes(b"glTF")
    entry = Entry(asset=str(path), name="broken")
    ended = work.work(entry, "f", str(tmp_path / "out"), work.Limits())
    assert ended.code == 2 and "truncated" in ended.line and ended.seconds > 0
    assert not (tmp_path / "out" / "broken").exists()


def test_a_process_over_its_limit_is_taken_down(tmp_path):
    entry = Entry(asset="sample:relic", name="relic")
    ended = work.work(entry, "f", str(tmp_path), work.Limits(seconds=0.2))
    assert ended.code == work.OVER_LIMIT and "took longer than 0.2 s; raise --timeout" in ended.line


def test_the_page_has_failures_first_then_the_worst(tmp_path):
    ours = entries(4)
    figures = [{"psnr": 40.0}, {"psnr": 30.5, "triangles": 1200}, {}]
    outcomes = {e.name: outcome(e, figures=f) for e, f in zip(ours, figures, strict=False)}
    outcomes["m2"] = Outcome("m2", "f", 2, "<b>no faces</b>")
    text = write_overview(tmp_path, ours, outcomes).read_text()
    assert [text.index(f">{name}<") for name in ("m2", "m1", "m0", "m3")] == sorted(
        text.index(f">{name}<") for name in ("m0", "m1", "m2", "m3")
    )
    assert "&lt;b&gt;no faces" in text and "<b>no" not in text and "1,200" in text and "30.50" in text


def test_the_page_of_a_thousand_is_small(tmp_path):
    ours = entries(1000)
    figures = {"psnr": 33.3, "flip": 0.01, "triangles": 1000, "vertices": 1500, "bytes": 123456}
    page = write_overview(tmp_path, ours, {e.name: Outcome(e.name, "f", 0, figures=figures) for e in ours})
    assert page.stat().st_size < 2e6
