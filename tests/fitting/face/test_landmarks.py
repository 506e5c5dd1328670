"""Poses, scale and weights of a morphable model from landmarks: known ones come back, noise costs little, mistakes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mi_simplify.errors import UserError
from mi_simplify.fitting.face.landmarks import aligned, fit_landmarks

FOCAL, SIZE = 600.0, (480, 640)


def scene(noise: float = 0.0, scale: float = 1.0, seed: int = 0):
    """40 landmarks with 3 modes, seen by 4 cameras a few times as far away as the model is large."""
    rng = np.random.default_rng(seed)
    points, offsets = rng.normal(size=(40, 3)), rng.normal(size=(3, 40, 3)) * 0.2
    weights = rng.normal(size=3)
    rotations = Rotation.from_rotvec(rng.normal(size=(4, 3)) * 0.4).as_matrix()
    translations = np.array([0, 0, 9 * scale]) + rng.normal(size=(4, 3)) * 0.3 * scale
    moved = scale * (points + np.tensordot(weights, offsets, axes=1))
    local = np.einsum("bij,lj->bli", rotations, moved) + translations[:, None]
    seen = FOCAL * local[..., :2] / local[..., 2:] + np.array(SIZE) / 2 + noise * rng.normal(size=(4, 40, 2))
    return points, offsets, seen, local[..., 2], weights, rotations, translations, scale


def test_what_made_the_landmarks_is_found():
    points, offsets, seen, _, weights, rotations, translations, _ = scene()
    fit = fit_landmarks(points, offsets, seen, FOCAL, SIZE, prior=1e-4)
    np.testing.assert_allclose(fit.weights, weights, atol=1e-3)
    np.testing.assert_allclose(fit.rotations, rotations, atol=1e-3)
    np.testing.assert_allclose(fit.translations, translations, atol=1e-2)
    assert fit.error < 0.02 and fit.scale == pytest.approx(1, abs=1e-6)


def test_depth_gives_the_scale():
    points, offsets, seen, depth, weights, _, translations, scale = scene(noise=0.5, scale=7.0)
    depth[0, :5] = np.nan
    fit = fit_landmarks(points, offsets, seen, FOCAL, SIZE, depth=depth, prior=0.1)
    assert fit.scale == pytest.approx(scale, rel=0.01)
    np.testing.assert_allclose(fit.weights, weights, atol=0.05)
    np.testing.assert_allclose(fit.translations, translations, atol=0.3)


def test_a_landmark_far_off_hardly_matters():
    points, offsets, seen, _, weights, *_ = scene(noise=0.3)
    seen[1, 3] += 60
    fit = fit_landmarks(points, offsets, seen, FOCAL, SIZE, prior=0.1)
    np.testing.assert_allclose(fit.weights, weights, atol=0.08)


def test_alignment_undoes_what_is_rigid():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(20, 3))
    moved = 2.5 * points @ Rotation.from_rotvec([0.3, 1, -2]).as_matrix().T + [1, 2, 3]
    np.testing.assert_allclose(aligned(points, moved, with_scale=True), moved, atol=1e-9)
    np.testing.assert_allclose(aligned(points, moved / 2.5), moved / 2.5, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda p, o, s: (p, o, s[:, :39]), "the model has 40 landmarks, but the images"),
        (lambda p, o, s: (p[:5], o[:, :5], s[:, :5]), "at least 6 landmarks, got 5"),
        (lambda p, o, s: (p, o, s - [300, 0]), "outside its 480 × 640"),
    ],
)
def test_mistakes_are_one_line(change, line):
    with pytest.raises(UserError, match=line):
        fit_landmarks(*change(*scene()[:3]), FOCAL, SIZE)
    with pytest.raises(UserError, match="depth of landmarks"):
        fit_landmarks(*scene()[:3], FOCAL, SIZE, depth=np.ones((4, 3)))
