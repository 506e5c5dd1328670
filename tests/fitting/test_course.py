"""When a run is over, and how its rates get there."""

import numpy as np
import pytest

from mi_simplify.config.optimizer import OptimizerSettings
from mi_simplify.errors import ConfigError
from mi_simplify.fitting.course import Course
from mi_simplify.progress import seconds_of


def course(interval: int = 10, spent: float = 0.0, **settings) -> Course:
    return Course(OptimizerSettings(**settings), interval, spent)


def test_without_limits_progress_is_the_share_of_the_steps():
    whole = course(steps=40, tolerance=0.0)
    for done, before, now in ((10, 1.0, 0.9), (20, 0.9, 0.9), (30, 0.9, 2.0)):  # falls, stands still, rises
        whole.measured(done, before, now)
    assert [whole.progress(done) for done in (0, 10, 40)] == [0.0, 0.25, 1.0]
    assert whole.is_over(40, 1e9) and not whole.is_over(39, 1e9)


def test_a_loss_that_stands_still_ends_the_run_with_rates_that_run_out():
    flat = course(steps=100, tolerance=0.01)
    flat.measured(10, 1.0, 0.98)
    flat.measured(20, 0.98, 0.969)
    assert flat.end == 100, "each fell by more than one percent"
    flat.measured(30, 0.969, 0.965)
    assert flat.end == 40 and not flat.is_over(39, 0.0) and flat.is_over(40, 0.0)
    assert [flat.progress(done) for done in (30, 35, 40)] == pytest.approx([0.3, 0.65, 1.0])
    flat.measured(39, 0.9, 0.899)
    assert flat.end == 40, "the end stands"
    late = course(steps=100, tolerance=0.01)
    late.measured(95, 1.0, 0.999)
    assert late.end == 100, "and is never later than without"


def test_a_rise_alone_ends_nothing_two_in_a_row_do():
    rough = course(steps=100, tolerance=0.01)
    for done, before, now in ((10, 1.0, 1.2), (20, 1.0, 0.9), (30, 0.9, 0.95)):
        rough.measured(done, before, now)
        assert rough.end == 100
    rough.measured(40, 0.9, 0.91)
    assert rough.end == 50


def test_the_first_measurement_and_coarse_images_end_nothing():
    begun = course(steps=100, tolerance=0.5)
    begun.measured(10, np.inf, 1.0)
    assert begun.end == 100
    coarse = course(steps=100, tolerance=0.5, resolution=(32, 64))
    coarse.measured(10, 1.0, 0.9)
    assert coarse.end == 100
    coarse.measured(50, 1.0, 0.9)
    assert coarse.end == 60


def test_a_time_limit_takes_progress_along_and_keeps_what_is_needed_free():
    timed = course(steps=100, time=20.0, spent=10.0)
    assert timed.progress(10, 1.0) == pytest.approx(0.1), "ten steps are more of the whole than ..."
    assert timed.progress(10, 5.0) == pytest.approx(0.5), "half of the ten seconds that are left"
    assert timed.is_over(10, 8.0, needed=2.0) and not timed.is_over(10, 7.9, needed=2.0)
    assert course(steps=100, time=5.0, spent=9.0).is_over(0, 0.1)


def test_what_later_steps_depend_on_goes_through_a_state():
    one, other = course(steps=100), course(steps=100)
    one.measured(20, 1.0, 1.1)
    other.restore(one.state())
    for either in (one, other):
        either.measured(30, 1.0, 1.1)
    assert (other.end, other.progress(33)) == (one.end, one.progress(33)) == (40, pytest.approx(0.3 + 0.7 * 0.3))


@pytest.mark.parametrize(("text", "seconds"), [("30s", 30), ("90", 90), ("1.5 min", 90), ("2h", 7200), ("5m", 300)])
def test_times_are_read_as_people_write_them(text, seconds):
    assert seconds_of(text) == seconds


@pytest.mark.parametrize("text", ["", "0s", "-3s", "fast", "3 days"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(ConfigError, match="write it as 30s, 5min or 1h"):
        seconds_of(text)
