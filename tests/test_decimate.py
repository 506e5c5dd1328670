"""Quadric edge collapse: budgets, what a reduced surface keeps, and what it must not become."""

import numpy as np
import pytest

from mi_simplify.errors import MeshError
from mi_simplify.initial.decimate import decimate
from mi_simplify.initial.sphere import sphere


def grid(n, height=lambda x, y: 0 * x):
    """A sheet of 2·n² triangles over [0, 1]²."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    corner = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :n].ravel()
    a, b, c, d = corner, corner + n + 1, corner + n + 2, corner + 1
    positions = np.stack([x.ravel(), y.ravel(), height(x, y).ravel()], axis=1)
    return positions, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def areas(p, f):
    return np.linalg.norm(np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]]), axis=1) / 2


@pytest.mark.parametrize("budget", [4, 50, 333])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_meets_the_budget_at_any_size(budget, scale):
    p, f = sphere(5000)
    q, g = decimate(p * scale + scale, f, budget)
    assert 0.98 * budget <= len(g) <= budget
    assert areas(q, g).min() > 0 and np.array_equal(np.unique(g), np.arange(len(q)))
    assert all(len(set(face)) == 3 for face in g.tolist())


def test_a_sphere_keeps_its_radius_and_stays_closed():
    q, g = decimate(*sphere(20_000), 500)
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 0.03
    edges = np.sort(np.concatenate([g[:, [0, 1]], g[:, [1, 2]], g[:, [2, 0]]]), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)
    volume = np.einsum("ij,ij->i", q[g[:, 0]], np.cross(q[g[:, 1]], q[g[:, 2]])).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi, rel=0.03)  # wound outwards still


def test_a_flat_sheet_keeps_its_outline():
    q, g = decimate(*grid(40), 20)
    assert np.abs(q[:, 2]).max() < 1e-9 and areas(q, g).sum() == pytest.approx(1, abs=1e-4)


def test_triangles_go_where_the_surface_bends():
    q, g = decimate(*grid(60, lambda x, y: np.where(x > 0.5, 0.1 * np.sin(20 * x) * np.sin(20 * y), 0)), 400)
    assert (q[g].mean(1)[:, 0] > 0.5).mean() > 0.8


def test_a_thin_spike_beside_a_large_body_survives():
    """What outlines are made of: a needle as long as the body is wide, with a thousandth of its area."""
    p, f = sphere(20_000)
    tip = p * [0.01, 0.01, 1.0] + [0, 0, 1.9]
    q, g = decimate(np.concatenate([p, tip[: len(p)]]), np.concatenate([f, f + len(p)]), 600)
    assert q[:, 2].max() > 2.5 and len(g) <= 600


def test_the_same_input_gives_the_same_mesh():
    first, second = decimate(*sphere(3000), 200), decimate(*sphere(3000), 200)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_too_small_a_budget_is_refused():
    with pytest.raises(MeshError, match="at least 4"):
        decimate(*sphere(100), 3)
