"""The uniform Laplacian: known values, its relative form, its derivative."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.fitting.parameters.laplacian import Laplacian


def flat(x):
    return mi.Float(np.asarray(x, np.float32).ravel())


def grid(n=5):
    """Plane of n x n positions, each quad cut the same way, so that inner rings are centrally symmetric."""
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (s.ravel() for s in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1).astype(float), faces


def ref_differentials(positions, faces):
    """v - mean of its one-ring, with a loop over positions."""
    rings = [set() for _ in positions]
    for f in faces:
        for c in range(3):
            rings[f[c]] |= {f[(c + 1) % 3], f[(c + 2) % 3]}
    rings = [sorted(ring - {k}) for k, ring in enumerate(rings)]
    return np.array([p - positions[r].mean(0) if r else 0 * p for p, r in zip(positions, rings, strict=True)])


def test_a_plane_is_zero_inside():
    positions, faces = grid()
    delta = Laplacian(faces, positions, False).differentials(flat(positions)).numpy().T.reshape(5, 5, 3)
    assert np.allclose(delta[1:-1, 1:-1], 0, atol=1e-6)
    assert np.allclose(delta[0, 2], [-0.5, -0.25, 0])  # ring (0,1) (0,3) (1,2) (1,3)
    assert np.allclose(delta[..., 2], 0)


def test_one_raised_position_by_hand():
    """Its own δ is its height; each of its six neighbours, of degree six, sinks by a sixth of it."""
    positions, faces = grid(7)
    positions[24, 2] = 0.6
    laplacian = Laplacian(faces, positions, False)
    delta = laplacian.differentials(flat(positions)).numpy()[2]
    assert delta[24] == pytest.approx(0.6) and np.isclose(delta, -0.1).sum() == 6
    plane, _ = grid(7)
    border = float(Laplacian(faces, plane, False).loss(flat(plane))[0])
    assert laplacian.loss(flat(positions))[0] - border == pytest.approx((0.36 + 6 * 0.01) / 49, rel=1e-3)


def test_any_mesh_equals_the_loop():
    mesh = charted_sphere(4, noise=0.1)
    faces = mesh.position_faces
    expected = ref_differentials(mesh.positions, faces)
    laplacian = Laplacian(faces, mesh.positions, False)
    assert np.allclose(laplacian.differentials(flat(mesh.positions)).numpy().T, expected, atol=1e-6)
    value = np.sum(expected**2) / len(expected)
    assert laplacian.loss(flat(mesh.positions))[0] == pytest.approx(value, rel=1e-4)
    assert laplacian.absolute_start == pytest.approx(value, rel=1e-4)


def test_relative_starts_at_zero_and_ignores_translation():
    mesh = charted_sphere(4, noise=0.1)
    laplacian = Laplacian(mesh.position_faces, mesh.positions, True)
    # Sums of the rings by atomic additions: their order, and so the last bit of a float32, is not ours to fix.
    assert laplacian.loss(flat(mesh.positions))[0] < np.finfo(np.float32).eps ** 2
    assert laplacian.loss(flat(mesh.positions + [1.0, -2, 0.5]))[0] < 1e-10
    assert laplacian.loss(flat(mesh.positions * 1.1))[0] == pytest.approx(0.01 * laplacian.absolute_start, rel=1e-3)
    # The default weight is balanced against the absolute one, which the relative form keeps.
    assert laplacian.absolute_start > 1e-3
    assert Laplacian(mesh.position_faces, mesh.positions, False).absolute_start == laplacian.absolute_start


@pytest.mark.parametrize("relative", [False, True])
def test_derivative(relative):
    mesh, rng = charted_sphere(2, noise=0.1), np.random.default_rng(1)
    faces, start = mesh.position_faces, mesh.positions
    laplacian = Laplacian(faces, start, relative)
    target = ref_differentials(start, faces) if relative else 0
    moved = start + 0.05 * rng.normal(size=start.shape)
    x = flat(moved)
    dr.enable_grad(x)
    dr.backward(laplacian.loss(x))
    got = dr.grad(x).numpy().reshape(-1, 3)
    loss = lambda p: np.sum((ref_differentials(p, faces) - target) ** 2) / len(p)  # noqa: E731
    eps = 1e-5
    for k in range(0, len(start), 5):
        for axis in range(3):
            d = np.zeros_like(moved)
            d[k, axis] = eps
            expected = (loss(moved + d) - loss(moved - d)) / (2 * eps)
            assert got[k, axis] == pytest.approx(expected, rel=1e-3, abs=1e-5)
    assert np.allclose(got.sum(0), 0, atol=1e-5)  # nothing pulls the whole mesh


def test_positions_without_a_ring_and_degenerate_faces():
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9]], float)
    laplacian = Laplacian(np.array([[0, 1, 2], [0, 0, 1]]), positions, False)
    x = flat(positions)
    dr.enable_grad(x)
    loss = laplacian.loss(x)
    delta = laplacian.differentials(dr.detach(x)).numpy().T
    assert np.allclose(delta, [[-0.5, -0.5, 0], [1, -0.5, 0], [-0.5, 1, 0], [0, 0, 0]])
    dr.backward(loss)
    grad = dr.grad(x).numpy()
    assert np.isfinite(grad).all() and np.all(grad[9:] == 0)
