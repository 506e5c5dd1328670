"""The picture of a running fit: when it is written, what it shows, and what a full disk does to it."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from support.models import textured_sphere

from mi_simplify.config import load_config
from mi_simplify.fitting import Run
from mi_simplify.record import preview
from mi_simplify.record.preview import SHARE, Preview
from mi_simplify.scenes.references.path_traced import make_reference


class Clock:
    """A clock that moves when told to."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(preview, "time", clock)
    return clock


def run_of(clock: Clock, cost: float) -> SimpleNamespace:
    """A fit of which a picture costs so many seconds: white reference, black state."""

    def picture():
        clock.now += cost
        return np.ones((1, 8, 8, 4), np.float32), np.zeros((1, 8, 8, 4), np.float32)

    return SimpleNamespace(fit=SimpleNamespace(preview=picture))


@pytest.mark.parametrize("cost", [0.001, 0.2])
def test_previews_take_a_hundredth_of_the_time_at_most(tmp_path, clock, cost):
    show, run = Preview(tmp_path / "preview.png", interval=3.0), run_of(clock, cost)
    begin, times = clock.now, []
    for _ in range(2000):
        clock.now += 0.1
        before = clock.now
        if show(run) is not None:
            times.append(before)
    assert len(times) * cost <= SHARE * (clock.now - begin)
    assert np.diff(times).min() >= max(3.0, cost / SHARE) - 1e-6
    assert np.diff(times).max() < max(3.0, cost / SHARE) + 0.2


def test_the_picture_is_reference_beside_state(tmp_path, clock):
    path = tmp_path / "preview.png"
    show, run = Preview(path, interval=1.0), run_of(clock, 0.0)
    assert show(run) is None and not path.exists()
    clock.now += 1.5
    assert show(run).shape == (8, 16, 3)
    image = np.asarray(Image.open(path))
    assert (image[:, :8] == 255).all() and (image[:, 8:] == 0).all()
    assert [p.name for p in tmp_path.iterdir()] == ["preview.png"]


def test_a_folder_that_cannot_be_written_is_told_once(tmp_path, clock, caplog):
    show, run = Preview(tmp_path / "gone" / "preview.png", interval=1.0), run_of(clock, 0.0)
    for _ in range(3):
        clock.now += 5
        show(run)
    assert caplog.text.count("no preview: cannot write") == 1


def test_a_real_fit_is_seen_and_not_disturbed(tmp_path):
    target = textured_sphere()
    settings = ["optimizer.resolution=48", "optimizer.batch=2", "evaluation.views=2", "reference.spp=16"]
    config = load_config(overrides=["asset=sample:relic", "optimizer.steps=2", *settings])
    run = Run(target, make_reference(target.as_asset(), transport="direct", spp=64), config)
    run.step()
    before = run.fit.parameters()
    picture = Preview(tmp_path / "preview.png", interval=0.0)(run).astype(float) / 255
    for name, value in run.fit.parameters().items():
        np.testing.assert_array_equal(value, before[name])
    assert picture.shape == (48, 96, 3)
    reference, current = picture[:, :48], picture[:, 48:]
    assert reference.std() > 0.1
    assert -10 * np.log10(((reference - current) ** 2).mean()) > 25
