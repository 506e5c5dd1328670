"""Normals split by gain: the budget, the seams and the asset's own edges on shapes whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from mi_simplify.initial.sphere import sphere
from mi_simplify.initial.unwrap.charting import unwrap
from mi_simplify.initial.unwrap.splits import split_where_it_pays
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.topology import area_vectors

BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
BOX_FACES = np.concatenate([SIDES[:, [0, 1, 2]], SIDES[:, [0, 2, 3]]])


def bumpy() -> tuple[np.ndarray, np.ndarray]:
    p, f = sphere(400)
    return p * (1 + 0.15 * np.sin(6 * p[:, :1]) * np.cos(5 * p[:, 1:2])) * [1, 1.4, 0.8], f


def cost(mesh: Mesh) -> float:
    """Σ A (1 - n·m) over the corners, by area alone."""
    vectors = np.repeat(area_vectors(mesh.positions[mesh.position_faces]), 3, axis=0)
    groups = mesh.normal_groups[mesh.faces].ravel()
    total = np.stack([np.bincount(groups, column) for column in vectors.T], 1)
    return float(np.linalg.norm(vectors, axis=1).sum() - np.linalg.norm(total, axis=1).sum())


def roof(height: float) -> Mesh:
    """Two triangles that meet in a ridge."""
    p = np.array([[0, height, 0], [0, height, 2], [1, 0, 1], [-1, 0, 1]], float)
    f = np.array([[0, 1, 2], [1, 0, 3]])
    return Mesh(p, np.arange(4), p[:, [0, 2]].astype(np.float32), f)


def test_the_vertices_of_a_ridge_split_and_its_sides_are_flat():
    mesh = split_where_it_pays(roof(1.0), 20.0, 6)
    assert len(mesh.uvs) == 6
    n = mesh.normals()[mesh.normal_groups[mesh.faces]]
    assert np.allclose(n, n[:, :1])
    assert cost(mesh) == pytest.approx(0, abs=1e-9) and cost(roof(1.0)) > 1
    assert len(split_where_it_pays(roof(1.0), 20.0, 5).uvs) == 5


@pytest.mark.parametrize(("height", "angle"), [(0.1, 20.0), (1.0, 180.0), (1.0, 91.0)])
def test_what_turns_by_less_than_the_angle_is_not_split(height, angle):
    mesh = roof(height)
    same = split_where_it_pays(mesh, angle, 100)
    assert np.array_equal(same.faces, mesh.faces) and len(np.unique(same.normal_groups)) == 4


def test_more_vertices_cost_less_and_the_budget_holds():
    p, f = bumpy()
    nowhere, costs = np.zeros(f.shape, bool), []
    seams = len(unwrap(p, f, atlas_size=256, crease_angle=5.0, hard=nowhere)[0].uvs)
    for split in (1.0, 1.5, 1.7, 2.0):
        mesh, _ = unwrap(p, f, atlas_size=256, crease_angle=5.0, hard=nowhere, split=split)
        assert len(mesh.uvs) == max(seams, int(split * len(p)))
        assert np.array_equal(mesh.position_faces, f)
        costs.append(cost(mesh))
    assert costs == sorted(costs, reverse=True) and costs[-1] < 0.7 * costs[0]


def test_hard_edges_are_kept_whatever_the_budget():
    everywhere = np.ones(BOX_FACES.shape, bool)
    mesh, _ = unwrap(BOX, BOX_FACES, atlas_size=128, crease_angle=30, hard=everywhere, split=1.0)
    assert len(mesh.uvs) == 24
    assert cost(mesh) == pytest.approx(0, abs=1e-9)


def test_normals_split_along_seams_for_nothing():
    """Without a budget creases add no vertex to those of the charts, but normals."""
    p, f = bumpy()
    smooth, _ = unwrap(p, f, atlas_size=256)
    mesh, _ = unwrap(p, f, atlas_size=256, crease_angle=5.0, hard=np.zeros(f.shape, bool))
    assert len(mesh.uvs) == len(smooth.uvs)
    assert len(np.unique(mesh.normal_groups)) > len(np.unique(smooth.normal_groups)) == len(p)
    assert cost(mesh) < cost(smooth)
