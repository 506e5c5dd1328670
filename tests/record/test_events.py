"""TensorBoard's own reader finds what a fit wrote; a missing package and a full disk are told in one line."""

import importlib.util

import numpy as np

from mi_simplify import cli
from mi_simplify.record.events import Events


def read(folder):
    """Everything in a folder, as TensorBoard itself reads it."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder), size_guidance={"scalars": 0, "images": 0})
    return events.Reload()


def test_tensorboard_reads_curves_and_pictures(tmp_path):
    events = Events(tmp_path)
    for step in (1, 11, 21):
        events.figures(step, loss=1.0 / step, psnr=30.0 if step == 21 else None)
    events.picture(21, "now", np.full((4, 8, 3), 200, np.uint8))
    events.close()
    found = read(tmp_path)
    assert [(e.step, round(e.value, 6)) for e in found.Scalars("loss")] == [(1, 1.0), (11, 0.090909), (21, 0.047619)]
    assert [e.step for e in found.Scalars("psnr")] == [21]
    assert [(e.step, e.width, e.height) for e in found.Images("now")] == [(21, 8, 4)]


def test_a_resumed_fit_takes_the_place_of_the_steps_that_it_repeats(tmp_path):
    for start, steps in ((0, (1, 11, 21)), (11, (12, 22))):
        events = Events(tmp_path, start)
        for step in steps:
            events.figures(step, loss=float(start))
        events.close()
    assert [e.step for e in read(tmp_path).Scalars("loss")] == [1, 11, 12, 22]


def test_a_folder_that_cannot_be_made_does_not_cost_the_run(tmp_path, caplog):
    (tmp_path / "file").write_text("")
    events = Events(tmp_path / "file" / "tensorboard")
    events.figures(1, loss=1.0)
    events.close()
    assert caplog.text.count("no more events for TensorBoard") == 1


def test_a_missing_package_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert cli.main(["simplify", "sample:relic", "--tensorboard", "-o", "out"]) == 2
    assert capsys.readouterr().err == (
        "error: --tensorboard needs the package tensorboard: pip install 'mi-simplify[tensorboard]'\n"
    )
    assert not (tmp_path / "out").exists()
