"""Visibility from outside: known values."""

import numpy as np
import pytest

from mi_simplify.initial.reduce.decimate import decimate
from mi_simplify.initial.reduce.visibility import visibility
from mi_simplify.initial.sphere import sphere

SHEET = np.array([[-1.0, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]])
SHEET_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_a_convex_body_and_an_open_sheet_are_seen_from_everywhere():
    positions, faces = sphere(2000)
    seen = visibility(positions, faces)
    assert seen.mean() > 0.96 and seen.min() > 0.75  # 64 rays for each of six faces: a standard error of .05
    assert np.allclose(visibility(1e3 + SHEET, SHEET_FACES), 1)


def test_what_is_walled_in_is_not_seen_unless_the_walls_are_transparent():
    positions, faces = sphere(500)
    both, faces_of_both = np.concatenate([positions, 0.3 * positions]), np.concatenate([faces, faces + len(positions)])
    seen = visibility(both, faces_of_both)
    assert seen[: len(positions)].min() > 0.75 and seen[len(positions) :].max() == 0
    opaque = np.arange(len(faces_of_both)) >= len(faces)  # the inner one
    assert visibility(both, faces_of_both, opaque).min() > 0.75


def test_the_floor_of_a_pit_sees_the_sky_as_the_solid_angle_says():
    """A small floor in the depth 1 of an open cylinder of radius 1: the cap of 45 degrees."""
    k = 2 * np.pi * np.arange(96) / 96
    ring = np.stack([np.cos(k), np.zeros(96), np.sin(k)], 1)
    wall = np.concatenate([ring, ring + [0, 1, 0]])
    i, j = np.arange(96), np.roll(np.arange(96), -1)
    ring_faces = np.concatenate([np.stack([i, j, i + 96], 1), np.stack([j, j + 96, i + 96], 1)])
    bottom = np.concatenate([wall, 3 * SHEET]) - [0, 1e-3, 0]  # closes the cylinder below
    dot = 0.01 * SHEET + [0, 1e-3, 0]
    positions = np.concatenate([bottom, dot])
    faces = np.concatenate([ring_faces, SHEET_FACES + 192, SHEET_FACES + 196])
    expected = 2 * (1 - np.cos(np.pi / 4)) / 2  # of the sphere, doubled
    assert visibility(positions, faces)[-4:].mean() == pytest.approx(expected, abs=0.09)


def test_triangles_are_spent_where_the_importance_is():
    positions, faces = sphere(4000)
    positions = positions * (1 + 0.02 * np.sin(20 * positions).sum(1, keepdims=True))
    left_is_seen = np.where(positions[:, 0] < 0, 1.0, 0.05)
    for importance, low, high in ((None, 0.45, 0.55), (left_is_seen, 0.58, 0.95)):
        p, f = decimate(positions, faces, 800, importance)
        share = (p[f].mean(1)[:, 0] < 0).mean()
        assert len(f) <= 800 and low < share < high
