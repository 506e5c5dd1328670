"""The library of distance functions: known distances, bounds, warps that keep distances."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree

from mi_simplify.machine.upload import upload
from mi_simplify.scenes.implicit import sdf

POINTS = np.random.default_rng(3).uniform(-1.5, 1.5, (4000, 3))


def at(f, points=POINTS) -> np.ndarray:
    return f(upload(mi.Point3f, points)).numpy()


@pytest.mark.parametrize(
    ("f", "point", "distance"),
    [
        (lambda p: sdf.sphere(p, 0.5, (1, 0, 0)), (3, 0, 0), 1.5),
        (lambda p: sdf.box(p, (1, 2, 3)), (2, 3, 3), 2**0.5),
        (lambda p: sdf.box(p, (1, 2, 3), rounding=0.2), (0, 0, 0), -1.0),
        (lambda p: sdf.cylinder(p, 1.0, 0.5), (2, 1.5, 0), 2**0.5),
        (lambda p: sdf.torus(p, 1.0, 0.25), (0, 0, 0), 0.75),
        (lambda p: sdf.half_space(p, (0, 2, 0), 1.0), (5, 3, 1), 2.0),
        (lambda p: sdf.cone(p, (0, 0, 0), (0, 2, 0), 0.5, 0.5), (2, 1, 0), 1.5),
        (lambda p: sdf.cone(p, (0, 0, 0), (0, 2, 0), 0.5, 0.1), (0, 3, 0), 0.9),
        (lambda p: sdf.ellipsoid(p, (1, 2, 3)), (0, 0, 4), 1.0),
        (lambda p: sdf.union(sdf.sphere(p, 1), sdf.sphere(p, 1, (4, 0, 0))), (3.5, 0, 0), -0.5),
        (lambda p: sdf.subtract(sdf.sphere(p, 1), sdf.sphere(p, 0.5)), (0, 0, 0), 0.5),
        (lambda p: sdf.smooth_union(sdf.sphere(p, 1), sdf.sphere(p, 1), 0.4), (2, 0, 0), 0.9),
        (lambda p: sdf.smooth_union(sdf.sphere(p, 1), sdf.sphere(p, 1, (9, 0, 0)), 0.4), (2, 0, 0), 1.0),
        (lambda p: sdf.shell(sdf.sphere(p, 1), 0.2), (0, 0, 0), 0.9),
        (lambda p: sdf.sphere(sdf.moved(p, (0, 0, 2)), 1), (0, 0, 5), 2.0),
        (lambda p: sdf.sphere(sdf.mirrored(p), 1, (2, 0, 0)), (-4, 0, 0), 1.0),
        (lambda p: sdf.sphere(sdf.repeated(p, (2, 0, 0)), 0.5), (40.5, 0, 0), 0.0),
        (lambda p: sdf.sphere(sdf.repeated(p, (2, 0, 0), (1, 0, 0)), 0.5), (4, 0, 0), 1.5),
        (lambda p: sdf.sphere(sdf.repeated_around(p, 4), 0.5, (2, 0, 0)), (0, 0, -3), 0.5),
        (lambda p: sdf.box(sdf.turned(p, (0, 0, 1), 90), (2, 1, 1)), (0, 3, 0), 1.0),
    ],
)
def test_known_distances(f, point, distance):
    assert at(f, np.array([point]))[0] == pytest.approx(distance, abs=1e-5)


@pytest.mark.parametrize(
    "f",
    [
        lambda p: sdf.box(p, (0.4, 0.2, 0.3), rounding=0.05),
        lambda p: sdf.cylinder(p, 0.3, 0.4),
        lambda p: sdf.torus(p, 0.6, 0.2),
        lambda p: sdf.cone(p, (-0.5, 0, 0.1), (0.5, 0.3, 0), 0.3, 0.1),
    ],
)
def test_exact_distances_are_those_to_the_nearest_point_of_the_surface(f):
    """Newton steps from random points end on the surface, and none of the ends is nearer than the distance said."""
    surface = POINTS
    for _ in range(6):
        p = upload(mi.Point3f, surface)
        dr.enable_grad(p)
        d = f(p)
        dr.backward(dr.sum(d))
        surface = surface - (dr.grad(p) * dr.detach(d)).numpy().T
    assert np.abs(at(f, surface)).max() < 1e-4
    inside = at(f) < 0
    assert 5 < inside.sum()
    nearest, _ = cKDTree(surface).query(POINTS)
    np.testing.assert_allclose(np.abs(at(f)), nearest, atol=2e-3)


def test_a_twist_turns_by_the_height_and_a_bend_lifts_the_ends():
    square = lambda p: sdf.box(p, (1, 1, 0.2))  # noqa: E731
    assert at(lambda p: square(sdf.twisted(p, 90.0)), np.array([[0, 0.95, 0.9], [0.9, 0.05, 0]])).max() < 0
    assert at(square, np.array([[0, 0.95, 0.9]]))[0] > 0
    rod = lambda p: sdf.box(p, (1, 0.05, 0.05))  # noqa: E731
    assert at(lambda p: rod(sdf.bent(p, -40.0)), np.array([[0.8, 0.5, 0]]))[0] < at(rod, np.array([[0.8, 0.5, 0]]))[0]


def test_derivatives_are_finite_everywhere_even_inside_a_box():
    p = upload(mi.Point3f, np.concatenate([POINTS, np.zeros((1, 3))]))
    dr.enable_grad(p)
    parts = [sdf.box(p, (0.5, 0.5, 0.5)), sdf.torus(p, 0.5, 0.2), sdf.ellipsoid(p, (1, 0.2, 0.4)), sdf.sphere(p, 1)]
    dr.backward(dr.sum(sdf.smooth_union(*parts, sdf.cylinder(p, 0.2, 0.9), 0.1)))
    assert np.isfinite(dr.grad(p).numpy()).all()
