"""Steps on vertices: Adam by vertex, through the diffusion of Large Steps or without."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.sparse import coo_array, eye_array
from scipy.sparse.linalg import spsolve
from support.tiny_meshes import charted_sphere

from mi_simplify.fitting.parameters.vertices import VertexSteps


@pytest.fixture
def mesh():
    return charted_sphere(4, noise=0.05)


class VertexAdam:
    """Adam whose second moment is that of a vertex's gradient length, averaged with the mean of all, in float64."""

    def __init__(self, x, rate):
        self.x, self.rate, self.m, self.v, self.t = x.copy(), rate, 0 * x, np.zeros((len(x), 1)), 0

    def step(self, g, factor):
        self.t += 1
        self.m, self.v = 0.9 * self.m + 0.1 * g, 0.99 * self.v + 0.01 * (g**2).sum(1, keepdims=True)
        scale = np.sqrt((self.v + self.v.mean()) / 2 / (1 - 0.99**self.t))
        self.x -= self.rate * factor * self.m / (1 - 0.9**self.t) / scale


def system(faces, n, lambda_):
    """I + λL with the combinatorial Laplacian, from its definition."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    i, j = np.concatenate([edges, edges[:, ::-1]]).T
    adjacency = coo_array((np.ones(len(i)), (i, j)), shape=(n, n)).tocsc()
    degree = np.asarray(adjacency.sum(1)).ravel()
    diagonal = coo_array((degree, (np.arange(n), np.arange(n))), shape=(n, n)).tocsc()
    return (eye_array(n, format="csc") + lambda_ * (diagonal - adjacency)).tocsc()


def numpy(positions):
    return dr.detach(positions).numpy().reshape(-1, 3).astype(np.float64)


def advance(steps, gradient, factor=1.0):
    positions = steps.positions()
    steps.step(mi.Float(np.asarray(gradient, np.float32).ravel()), positions, factor)
    return numpy(steps.positions())


@pytest.mark.parametrize("lambda_", [0.0, 0.5, 19.0])
def test_starts_where_the_mesh_is(mesh, lambda_):
    steps = VertexSteps(mesh.positions, mesh.position_faces, 0.01, lambda_)
    assert np.abs(numpy(steps.positions()) - mesh.positions).max() < 2e-6 * (1 + lambda_)


def test_without_diffusion_it_is_adam_by_vertex(mesh):
    rng = np.random.default_rng(1)
    steps, reference = VertexSteps(mesh.positions, mesh.position_faces, 0.01, 0.0), VertexAdam(mesh.positions, 0.01)
    for k in range(6):
        g = rng.normal(size=mesh.positions.shape) * 10.0**-k
        got = advance(steps, g, 0.8**k)
        reference.step(g, 0.8**k)
        assert np.abs(got - reference.x).max() < 2e-6


@pytest.mark.parametrize("lambda_", [0.3, 2.0, 19.0])
def test_with_diffusion_it_is_adam_on_the_differential_form(mesh, lambda_):
    """u = (I + λL) v, and the gradient by u is (I + λL)⁻¹ times that by v."""
    rng, n = np.random.default_rng(2), len(mesh.positions)
    a = system(mesh.position_faces, n, lambda_)
    steps = VertexSteps(mesh.positions, mesh.position_faces, 0.05, lambda_)
    reference = VertexAdam(a @ mesh.positions, 0.05)
    for k in range(4):
        g = rng.normal(size=(n, 3))
        got = advance(steps, g, 0.9**k)
        reference.step(spsolve(a, g), 0.9**k)
        assert np.abs(got - spsolve(a, reference.x)).max() < 2e-5 * (1 + lambda_ / 4)


def test_a_translation_passes_through_the_diffusion(mesh):
    """A gradient that is the same everywhere moves everything alike, by the rate, whatever λ."""
    for lambda_ in (0.0, 0.5, 19.0):
        steps = VertexSteps(mesh.positions, mesh.position_faces, 0.01, lambda_)
        moved = advance(steps, np.tile([3.0, 0, 0], (len(mesh.positions), 1))) - mesh.positions
        assert np.allclose(moved, [-0.01, 0, 0], atol=5e-5)


def test_steps_do_not_depend_on_the_axes(mesh):
    """Turned mesh and gradients give the turned result."""
    rng = np.random.default_rng(4)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    gradients = rng.normal(size=(3, *mesh.positions.shape)) * [1, 5, 0.1]
    plain, turned = (VertexSteps(p, mesh.position_faces, 0.01, 0.5) for p in (mesh.positions, mesh.positions @ turn))
    for g in gradients:
        a, b = advance(plain, g), advance(turned, g @ turn)
    assert np.abs(a @ turn - b).max() < 1e-5


def test_diffusion_spreads_a_single_gradient(mesh):
    g = np.zeros_like(mesh.positions)
    g[7, 1] = 1
    neighbours = np.unique(mesh.position_faces[np.any(mesh.position_faces == 7, axis=1)])
    alone, spread = (
        advance(VertexSteps(mesh.positions, mesh.position_faces, 0.01, lam), g) - mesh.positions for lam in (0.0, 5.0)
    )
    assert np.flatnonzero(np.abs(alone).max(1) > 1e-6).tolist() == [7]
    ring = np.setdiff1d(neighbours, [7])
    assert np.all(spread[ring, 1] < -1e-4)
    far = np.argsort(np.linalg.norm(mesh.positions - mesh.positions[7], axis=1))[-20:]
    assert spread[far, 1].min() > spread[ring, 1].max()  # less, the farther away
    assert np.abs(spread[:, [0, 2]]).max() < 1e-5


def test_positions_of_equal_coordinates_are_not_welded():
    """Two separate triangles in one place: a gradient on one leaves the other where it is."""
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    steps = VertexSteps(np.concatenate([triangle, triangle]), np.array([[0, 1, 2], [3, 4, 5]]), 0.01, 3.0)
    g = np.zeros((6, 3))
    g[:3, 2] = 1
    moved = advance(steps, g)
    assert np.allclose(moved[:3, 2], -0.01 / np.sqrt((3 + 1.5) / 6), atol=1e-5)
    assert np.allclose(moved[3:], triangle, atol=1e-6)


def test_gradients_do_not_pile_up_over_steps(mesh):
    """Each step sees its own gradient only: after a large one, a zero one just follows the momentum."""
    steps, reference = VertexSteps(mesh.positions, mesh.position_faces, 0.01, 0.0), VertexAdam(mesh.positions, 0.01)
    for g in (np.ones_like(mesh.positions), 0 * mesh.positions, -np.ones_like(mesh.positions)):
        got = advance(steps, g)
        reference.step(g, 1.0)
    assert np.abs(got - reference.x).max() < 1e-6
