"""Environments of coefficients: projection, turns, exposure."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mi_simplify.model.light.harmonics import harmonics
from mi_simplify.transfer.cast import unshadowed
from mi_simplify.transfer.light import SKIES, rotation, shade, sky, spiral, turned, turning_series


def at(light: np.ndarray, directions: np.ndarray) -> np.ndarray:
    return np.stack(np.broadcast_arrays(*harmonics(3, *directions.T)), 1) @ light


def test_a_rotation_moves_the_function():
    light, turn = np.random.default_rng(1).normal(size=(16, 3)), Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix()
    d = spiral(50)
    np.testing.assert_allclose(at(rotation(3, turn) @ light, d), at(light, d @ turn), atol=1e-8)


def test_rotations_are_orthogonal_and_compose():
    a, b = (Rotation.from_rotvec(v).as_matrix() for v in ([0.3, -1.2, 0.7], [1.0, 0.1, 0.2]))
    np.testing.assert_allclose(rotation(3, a) @ rotation(3, a).T, np.eye(16), atol=1e-7)
    np.testing.assert_allclose(rotation(3, a @ b), rotation(3, a) @ rotation(3, b), atol=1e-7)


def test_a_quarter_turn_takes_z_to_x():
    light = np.zeros((16, 3), np.float32)
    light[2] = 1  # the basis function of z
    wanted = np.zeros((16, 3))
    wanted[3] = 1  # that of x
    np.testing.assert_allclose(turned(light, 90), wanted, atol=1e-6)


@pytest.mark.parametrize("degrees", [0, 17, 123.4, -80])
def test_the_series_is_the_turned_light(degrees):
    light = sky("evening")
    terms = turning_series(light)
    a = np.radians(degrees)
    weights = np.concatenate([[1.0], *([np.cos(k * a), np.sin(k * a)] for k in (1, 2, 3))])
    np.testing.assert_allclose(np.tensordot(weights, terms, 1), turned(light, degrees), atol=1e-5)


@pytest.mark.parametrize("name", SKIES)
def test_skies_are_exposed_for_a_white_plane(name):
    assert shade(unshadowed(np.array([0, 1.0, 0]), albedo=1.0), sky(name)).max() == pytest.approx(1, abs=1e-5)
