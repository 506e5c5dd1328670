"""Schedules at the points that the paper states, and stretched to any length."""

import numpy as np
import pytest

from mi_simplify.fitting.schedules import PAPER_STEPS, exponential, laplacian_weight, resolution_at


def test_exponential_decay_is_the_papers():
    """10^(-0.0002·step) over 10,000 steps ends at a hundredth, wherever the run is that long."""
    assert exponential(0, 0.01) == 1 and exponential(1, 0.01) == pytest.approx(0.01)
    for step in (1, 1234, 5000, 9999):
        assert exponential(step / PAPER_STEPS, 0.01) == pytest.approx(10 ** (-0.0002 * step))
    assert [exponential(p, 1.0) for p in (0, 0.5, 1)] == [1, 1, 1]


def test_laplacian_weight_follows_the_papers_recursion():
    """λ_t = (λ_{t-1} - λ_min) 10^(-kt) + λ_min, k = 1e-6, step by step."""
    weight, floor = 1.0, 0.02
    for t in range(1, 3001):
        weight = (weight - floor) * 10 ** (-1e-6 * t) + floor
        if t in (1, 10, 500, 1000, 3000):
            assert laplacian_weight(t / PAPER_STEPS, floor) == pytest.approx(weight, rel=1e-6)
    assert laplacian_weight(0, floor) == 1 and laplacian_weight(1, floor) == pytest.approx(0.02)
    values = [laplacian_weight(p, 0.1) for p in np.linspace(0, 1, 50)]
    assert np.all(np.diff(values) <= 0) and min(values) >= 0.1


def test_resolution_goes_from_coarse_to_fine():
    at = [resolution_at(k / 100, (64, 128, 256)) for k in range(100)]
    assert at[:25] == [64] * 25 and at[25:50] == [128] * 25 and at[50:] == [256] * 50
    assert {resolution_at(p, (192,)) for p in (0, 0.3, 0.99, 1)} == {192}
    assert resolution_at(1.0, (64, 128)) == 128
