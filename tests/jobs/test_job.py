"""The job in Python: the frame, the snippet of the documentation, the progress shown."""

import re
import signal

import numpy as np
import pytest
from support.paths import ROOT

from mi_simplify.config import load_config
from mi_simplify.display import Bar, Lines, Silent
from mi_simplify.errors import AssetError
from mi_simplify.model.asset import Asset, Instance, Part
from mi_simplify.model.frame import Frame
from mi_simplify.progress import Progress
from mi_simplify.record.interrupt import DeferredInterrupt
from mi_simplify.subjects.subject import reference_for


def two_triangles(offset=(0.0, 0.0, 0.0)) -> Asset:
    vertices = np.array([[0, 0, 0], [4, 0, 0], [0, 1, 0], [0, 0, 2.0]]) + offset
    part = Part(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    return Asset((part,), (Instance(0),))


def test_the_frame_is_a_box_of_side_two_around_zero_and_is_undone_exactly():
    asset = two_triangles(offset=(100.0, -7.0, 3.0))
    frame = Frame.around(asset.bounds)
    bounds = frame.normalised(asset).bounds
    assert np.allclose(bounds, [[-1, -0.25, -0.5], [1, 0.25, 0.5]], atol=1e-12)
    scale, offset = 1 / frame.scale, frame.center
    assert np.allclose(bounds * scale + offset, asset.bounds, atol=1e-12)


def test_a_missing_environment_map_is_named():
    overrides = ["asset=sample:relic", "reference.transport=baked", "reference.environment=none.exr"]
    with pytest.raises(AssetError, match="none.exr' does not exist"):
        reference_for(two_triangles(), load_config(None, overrides))


def test_an_environment_map_lights_the_reference(tmp_path):
    import mitsuba as mi

    from mi_simplify.report.portrait import portrait_view

    sky = np.zeros((8, 16, 3), np.float32)
    sky[..., 1] = 2.0
    mi.Bitmap(sky).write(str(tmp_path / "sky.exr"))
    overrides = ["asset=x.obj", "reference.transport=baked", "reference.spp=16"]
    dark, lit = (
        reference_for(two_triangles(), load_config(None, [*overrides, *more]))
        for more in ([], [f"reference.environment={tmp_path / 'sky.exr'}"])
    )
    views = portrait_view(two_triangles().bounds, resolution=32, azimuth=0.0)
    before, after = dark.render(views)[0], lit.render(views)[0]
    gain = (after - before)[before[..., 3] > 0.99][:, :3].mean(0)
    assert gain[1] > 0.3
    assert abs(gain[0]) < 0.1


def test_the_documented_python_works(tmp_path, monkeypatch, capsys):
    """The snippet of docs/getting-started.md, at a size for tests."""
    page = (ROOT / "docs" / "getting-started.md").read_text()
    snippet = re.search(r"```python\n(.*?)```", page, re.DOTALL)[1]
    tiny = ["initial.triangles=120", "optimizer.steps=3", "optimizer.resolution=32", "optimizer.batch=1"]
    tiny += ["reference.spp=1", "evaluation.views=1"]
    shrunk = snippet
    for text, small in (
        ('"initial.triangles=2000"', ", ".join(f'"{text}"' for text in tiny)),
        ("triangles=config.initial.triangles", "triangles=120, atlas_size=64"),
        ('"result": model.as_asset()}', '"result": model.as_asset()}, n_views=1, resolution=32, spp=2'),
    ):
        assert text in shrunk
        shrunk = shrunk.replace(text, small)
    import trimesh

    trimesh.creation.icosphere(3).export(tmp_path / "statue.obj")
    monkeypatch.chdir(tmp_path)
    exec(compile(shrunk, "getting-started.md", "exec"), {})
    assert (tmp_path / "out" / "statue" / "model.glb").is_file()
    assert "'psnr': " in capsys.readouterr().out
    assert len([line for line in snippet.splitlines() if line.strip()]) <= 14


def test_every_public_name_exists():
    import mi_simplify

    for name in mi_simplify.__all__:
        assert getattr(mi_simplify, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        mi_simplify.nothing  # noqa: B018


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_interrupt_waits_and_the_second_does_not(number, caplog):
    before = signal.getsignal(number)
    with DeferredInterrupt() as interrupt:
        interrupt.check()
        signal.raise_signal(number)
        assert interrupt.pending and caplog.messages == ["stopping after this step; once more stops at once"]
        interrupt.left_behind = "how to go on"
        with pytest.raises(KeyboardInterrupt):
            interrupt.check()
        with pytest.raises(KeyboardInterrupt, match="how to go on"):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before


def run_of_progress(display) -> None:
    with display:
        display(Progress("load", message="x.obj"))
        for step in range(5):
            display(Progress("fit", step + 1, 5, loss=0.5 / (step + 1), psnr=30.0 if step == 4 else None))


def test_plain_lines_begin_and_end_every_stage():
    lines: list[str] = []
    run_of_progress(Lines(lines.append, interval=1000.0))
    assert lines == ["load  x.obj", "fit  1/5  loss 0.5", "fit  5/5  loss 0.1  PSNR 30.0 dB"]
    lines.clear()
    run_of_progress(Lines(lines.append, interval=0.0))
    assert len(lines) == 6
    assert lines[3].startswith("fit  3/5  loss 0.1667")


def test_the_bar_shows_loss_and_psnr():
    import io

    from rich.console import Console

    stream = io.StringIO()
    run_of_progress(Bar(Console(file=stream, force_terminal=True, width=120)))
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue())
    assert "5/5" in shown
    assert "loss 0.1  PSNR 30.0 dB" in shown


def test_silence_is_silent(capsys):
    run_of_progress(Silent())
    assert capsys.readouterr() == ("", "")
