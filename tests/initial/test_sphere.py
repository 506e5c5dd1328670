"""The tessellated sphere: every budget, closed, outward, even."""

import numpy as np
import pytest

from mi_simplify.errors import MeshError
from mi_simplify.initial.manifold import edge_pairs
from mi_simplify.initial.sphere import sphere


@pytest.mark.parametrize("n", [4, 5, 12, 301, 3000])
def test_it_is_closed_round_and_outward_for_every_budget(n):
    p, f = sphere(n, radius=2.0)
    assert len(f) == n - n % 2
    edges, _, counts = edge_pairs(f)
    assert (counts == 2).all() and len(p) - len(edges) + len(f) == 2
    assert np.allclose(np.linalg.norm(p, axis=1), 2)
    c = p[f]
    assert (np.einsum("fi,fi->f", c.mean(1), np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])) > 0).all()


def test_triangles_are_of_one_size_and_fill_the_sphere():
    p, f = sphere(3000)
    c = p[f]
    area = np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1) / 2
    assert area.std() < 0.2 * area.mean()
    assert area.sum() == pytest.approx(4 * np.pi, rel=3e-3)
    assert np.einsum("fi,fi->", c[:, 0], np.cross(c[:, 1], c[:, 2])) / 6 == pytest.approx(4 / 3 * np.pi, rel=5e-3)


def test_too_small_a_budget_is_refused():
    with pytest.raises(MeshError, match="budget of 3 triangles is too small"):
        sphere(3)
