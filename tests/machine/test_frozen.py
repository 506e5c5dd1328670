"""Functions that are traced once: replayed where that is safe, recorded anew where it is not."""

from __future__ import annotations

import gc
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.machine.frozen import frozen
from mi_simplify.machine.upload import upload


def floats(n, seed=0):
    return np.random.default_rng(seed).random(n).astype(np.float32)


@dataclass
class Table:
    data: mi.Float
    scale: float


@frozen("index")
def adjoint(table, index, weight):
    """Of ``scale · data[index]``, as wide as the table: a buffer that the function allocates."""
    data = mi.Float(table.data)
    dr.enable_grad(data)
    value = dr.gather(mi.Float, data, index) * table.scale
    dr.set_grad(value, weight)
    dr.enqueue(dr.ADMode.Backward, value)
    dr.traverse(dr.ADMode.Backward)
    return dr.grad(data)


def check(width, n, scale=2.0):
    index = np.random.default_rng(n).integers(0, width, n)
    got = adjoint(Table(upload(mi.Float, floats(width)), scale), upload(mi.UInt32, index), dr.opaque(mi.Float, 0.5))
    expected = np.bincount(index, minlength=width) * scale * 0.5
    assert got.numpy() == pytest.approx(expected, abs=1e-5)


def test_varying_widths_are_replayed_and_right():
    check(40, 7)
    before = adjoint.n_recordings
    for n in (9, 30, 31, 100, 3, 1000):
        check(40, n)
    assert adjoint.n_recordings == before


def test_other_widths_and_numbers_are_recorded_anew():
    check(50, 20)
    for width, scale in ((80, 2.0), (5000, 2.0), (80, 3.0)):
        before = adjoint.n_recordings
        check(width, 20, scale)
        assert adjoint.n_recordings == before + 1
    before = adjoint.n_recordings
    for width, scale in ((50, 2.0), (80, 3.0), (5000, 2.0), (80, 2.0)):
        check(width, 21, scale)
    assert adjoint.n_recordings == before


@dataclass
class Film:
    value: mi.Float
    width: int
    height: int
    spp: int


@frozen()
def exposed(film):
    return film.value * film.spp


def test_numbers_that_equal_others_count():
    """Dr.Jit's own comparison passes over a number that it met before: 64 and 32 here."""
    for spp in (64, 32, 48, 2):
        got = exposed(Film(upload(mi.Float, np.ones(5, np.float32)), 64, 32, spp))
        assert got.numpy() == pytest.approx(spp)


class Rubbish:
    """Tells when it is collected, which takes a collection: it refers to itself."""

    def __init__(self, told):
        self.itself, self.told = self, told

    def __del__(self):
        self.told.append(True)


@pytest.mark.parametrize("fails", [False, True])
def test_nothing_is_collected_during_a_call(fails):
    """What a collection frees there may be a scene, of which the recording knows nothing."""
    told, seen = [], []

    @frozen()
    def littered(x):
        kept = [[[]] for _ in range(1000)]
        seen.extend([*told, gc.isenabled()])
        if fails:
            raise ValueError(len(kept))
        return x + 1

    threshold = gc.get_threshold()
    gc.collect()
    gc.set_threshold(20, 1, 1)
    try:
        Rubbish(told)
        if fails:
            with pytest.raises(RuntimeError):  # what Dr.Jit makes of any
                littered(mi.Float(1))
        else:
            assert littered(mi.Float(1)).numpy() == 2
        assert seen == [False] and gc.isenabled()
        kept = [[[]] for _ in range(1000)]
        assert told == [True] and len(kept) == 1000
    finally:
        gc.set_threshold(*threshold)
