"""Stochastic simplification: budget, area, contrast, determinism."""

import numpy as np
import pytest

from mi_simplify.errors import MeshError
from mi_simplify.initial.guess import mean_material
from mi_simplify.initial.stochastic import stochastic
from mi_simplify.scenes.samples.catalogue import sample_asset


@pytest.fixture(scope="module")
def shrub():
    return sample_asset("shrub:20k")


def area(asset) -> float:
    corners = np.concatenate([p.vertices[p.faces] for p in asset.placed()])
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(cross, axis=1).sum() / 2)


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_area_stays_and_the_budget_is_met(shrub, share):
    budget = int(share * shrub.n_triangles)
    less = stochastic(shrub, budget)
    smallest = min(len(p.faces) for p in shrub.parts)
    assert budget - smallest < less.n_triangles <= budget
    assert area(less) == pytest.approx(area(shrub), rel=1e-6)
    low, high = shrub.bounds
    middle = less.bounds.mean(0)
    assert ((middle > low) & (middle < high)).all()


def test_colors_move_to_the_mean_as_far_as_pixels_average(shrub):
    deviation = lambda a, m: np.abs(a.parts[0].material.base_color[..., :3] - m).mean()  # noqa: E731
    mean = mean_material(shrub)[0][:3]
    kept = stochastic(shrub, shrub.n_triangles)
    assert deviation(kept, mean) == pytest.approx(deviation(shrub, mean), rel=1e-4)
    quarter = stochastic(shrub, shrub.n_triangles // 20, per_pixel=4)
    assert deviation(quarter, mean) == pytest.approx(0.5 * deviation(shrub, mean), rel=0.05)
    alone = stochastic(shrub, shrub.n_triangles // 20, per_pixel=1)
    assert deviation(alone, mean) == pytest.approx(deviation(shrub, mean), rel=1e-4)


def test_the_same_seed_drops_the_same(shrub):
    a, b, c = (stochastic(shrub, 2000, seed=s) for s in (3, 3, 4))
    assert [i.name for i in a.instances] == [i.name for i in b.instances]
    assert all(np.array_equal(x.to_world, y.to_world) for x, y in zip(a.instances, b.instances, strict=True))
    assert [i.node + i.name for i in a.instances] != [i.node + i.name for i in c.instances]
    with pytest.raises(MeshError, match="all would be dropped"):
        stochastic(shrub, 3)
