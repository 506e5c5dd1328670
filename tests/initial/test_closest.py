"""Closest points: against brute force, and on the side that is asked for."""

import numpy as np

from mi_simplify.initial.closest import ClosestPoints, closest_barycentric, sample_surface
from mi_simplify.initial.sphere import sphere


def brute(points, corners, n=60):
    """Least distance to any of the triangles, from a dense grid of barycentric coordinates."""
    k = np.linspace(0, 1, n)
    r, s = (g[np.add.outer(k, k) <= 1 + 1e-9] for g in np.meshgrid(k, k, indexing="ij"))
    grid = np.einsum("nc,fci->fni", np.stack([1 - r - s, r, s], 1), corners).reshape(-1, 3)
    return np.linalg.norm(points[:, None] - grid[None], axis=2).min(1)


def test_barycentric_coordinates_are_those_of_the_closest_point():
    rng = np.random.default_rng(0)
    corners, points = rng.normal(size=(200, 3, 3)), 2 * rng.normal(size=(200, 3))
    bary = closest_barycentric(points, corners)
    assert bary.min() >= 0 and np.allclose(bary.sum(1), 1)
    distance = np.linalg.norm(np.einsum("nc,nci->ni", bary, corners) - points, axis=1)
    expected = np.array([brute(p[None], c[None])[0] for p, c in zip(points, corners, strict=True)])
    assert (distance <= expected + 1e-12).all() and np.allclose(distance, expected, atol=0.05)
    regions = (bary == 0).sum(1)  # inside, on an edge, in a corner: all three kinds are among them
    assert set(regions) == {0, 1, 2}


def test_a_degenerate_triangle_is_a_segment_or_a_point():
    corners = np.array([[[0, 0, 0], [2, 0, 0], [1, 0, 0]], [[1, 1, 1]] * 3], float)
    bary = closest_barycentric(np.array([[1.5, 1, 0], [0, 0, 0]], float), corners)
    point = np.einsum("nc,nci->ni", bary, corners)
    assert np.isfinite(bary).all() and np.allclose(point, [[1.5, 0, 0], [1, 1, 1]])


def test_queries_find_the_closest_triangle_of_all():
    rng = np.random.default_rng(1)
    p, f = sphere(300)
    p = p * [3, 1, 0.2]  # thin: the other side is near
    surface = ClosestPoints(p, f)
    points = rng.normal(size=(100, 3)) * [3, 1, 0.5]
    found = surface.query(points)
    assert np.allclose(np.einsum("nc,nci->ni", found.barycentric, surface.corners[found.face]), found.point)
    assert np.allclose(np.linalg.norm(found.point - points, axis=1), found.distance)
    assert np.abs(found.distance - brute(points, surface.corners, 12)).max() < 0.05


def test_the_side_that_faces_alike_wins_over_the_nearer_one():
    p, f = sphere(400)
    slab = ClosestPoints(p * [1, 0.001, 1], f)  # thinner than its samples are apart
    points = np.array([[0.1, 0.0004, 0.1], [0.2, 0.0004, -0.1]])
    up = np.tile([0.0, 1, 0], (2, 1))
    assert (slab.query(points, up).point[:, 1] > 0).all()
    assert (slab.query(points, -up).point[:, 1] < 0).all()
    assert (slab.query(points).point[:, 1] > 0).all()


def test_no_points_are_no_problem():
    none = ClosestPoints(*sphere(20)).query(np.zeros((0, 3)))
    assert none.face.shape == (0,) and none.barycentric.shape == (0, 3)


def test_samples_are_spread_by_area_and_seeded():
    p, f = sphere(80)
    p = p * [1, 1, 5]
    corners = p[f]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    points, face = sample_surface(corners, area, 40_000, seed=0)
    count = np.bincount(face, minlength=80) - 1  # each has its centre besides
    assert np.abs(count - 40_000 * area / area.sum()).max() <= 1
    again, _ = sample_surface(corners, area, 40_000, seed=0)
    assert np.array_equal(points, again)
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / area[:, None]
    assert np.abs(np.einsum("ni,ni->n", points - corners[face, 0], n[face])).max() < 1e-12
