"""The differentiable surface: the same normals and tangents as in NumPy, and their derivatives."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.latent.surface import MeshTopology
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.tangents import vertex_tangents


def numpy_packets(mesh: Mesh, positions: np.ndarray) -> np.ndarray:
    """The same in float64: (p, u) (n, v) (t, w) of every vertex, shape (V, 12)."""
    mesh = replace(mesh, positions=positions)
    n = mesh.normals()
    t, w = vertex_tangents(mesh, n)
    n = n[mesh.normal_groups]
    return np.column_stack([mesh.vertices, mesh.uvs[:, 0], n, mesh.uvs[:, 1], t, w])


def flat(positions):
    return mi.Float(np.asarray(positions, np.float32).ravel())


def packets(topology: MeshTopology, positions) -> np.ndarray:
    return topology.surface(flat(positions)).packets.numpy().reshape(-1, 12)


@pytest.fixture(params=["smooth", "creased"])
def sphere(request) -> MeshTopology:
    """Smooth everywhere, or with a crease around every chart."""
    mesh = charted_sphere(4, noise=0.05, seed=1)
    creased = request.param == "creased"
    return MeshTopology(replace(mesh, normal_index=np.arange(len(mesh.uvs))) if creased else mesh)


def test_surface_equals_the_numpy_functions(sphere):
    mesh = sphere.mesh
    got, expected = packets(sphere, mesh.positions), numpy_packets(mesh, mesh.positions)
    assert np.abs(got - expected).max() < 2e-6
    assert sphere.n_positions == 98 and sphere.n_faces == 192 and sphere.n_vertices == 155  # five split at the fold
    assert set(got[:, 11]) == {-1.0, 1.0}
    faces = sphere.surface(flat(mesh.positions)).faces.numpy().reshape(-1, 4)
    assert np.array_equal(faces[:, :3], mesh.faces)
    # One normal a position, whatever the seams, unless a crease parts them.
    spread = max(np.ptp(got[mesh.position_index == p, 4:7], axis=0).max() for p in range(98))
    assert spread == 0 if mesh.normal_index is None else spread > 0.1


def test_surface_follows_moving_positions(sphere):
    """Topology and UVs stay, the rest is made anew of whatever positions come."""
    moved = sphere.mesh.positions + 0.1 * np.random.default_rng(2).normal(size=(98, 3))
    assert np.abs(packets(sphere, moved) - numpy_packets(sphere.mesh, moved)).max() < 5e-6
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    a, b = packets(sphere, moved), packets(sphere, moved @ turn.T * 2 + [1, 2, 3])
    for columns in (slice(4, 7), slice(8, 11)):
        assert np.allclose(a[:, columns] @ turn.T, b[:, columns], atol=1e-5)
    assert np.allclose(a[:, [3, 7, 11]], b[:, [3, 7, 11]])


@pytest.mark.parametrize("part", ["positions", "normals", "tangents", "all"])
def test_derivative_by_positions(sphere, part):
    rng, mesh = np.random.default_rng(4), sphere.mesh
    weight = rng.normal(size=(155, 12))
    columns = {"positions": range(3), "normals": range(4, 7), "tangents": range(8, 11), "all": range(12)}[part]
    weight[:, [k for k in range(12) if k not in columns]] = 0
    positions = flat(mesh.positions)
    dr.enable_grad(positions)
    dr.backward(dr.sum(sphere.surface(positions).packets * mi.Float(weight.astype(np.float32).ravel())))
    got = dr.grad(positions).numpy().reshape(-1, 3)
    x, eps = mesh.positions.astype(np.float32).astype(np.float64), 1e-5
    loss = lambda x: np.sum(numpy_packets(mesh, x) * weight)  # noqa: E731
    for _ in range(4):  # along random directions,
        d = rng.normal(size=(98, 3))
        expected = (loss(x + eps * d) - loss(x - eps * d)) / (2 * eps)
        assert np.sum(got * d) == pytest.approx(expected, rel=2e-3, abs=2e-3)
    for p, axis in ((0, 0), (17, 1), (53, 2), (97, 1)):  # and single coordinates
        d = np.zeros((98, 3))
        d[p, axis] = eps
        assert got[p, axis] == pytest.approx((loss(x + d) - loss(x - d)) / (2 * eps), rel=2e-3, abs=2e-3)


def test_forward_mode_agrees_with_backward_mode(sphere):
    rng = np.random.default_rng(5)
    direction, weight = (mi.Float(rng.normal(size=n).astype(np.float32)) for n in (98 * 3, 155 * 12))
    positions = flat(sphere.mesh.positions)
    dr.enable_grad(positions)
    out = sphere.surface(positions).packets
    dr.set_grad(positions, direction)
    dr.enqueue(dr.ADMode.Forward, positions)
    dr.traverse(dr.ADMode.Forward)
    forward = dr.sum(dr.grad(out) * weight)[0]
    positions = flat(sphere.mesh.positions)
    dr.enable_grad(positions)
    dr.backward(dr.sum(sphere.surface(positions).packets * weight))
    assert dr.dot(dr.grad(positions), direction)[0] == pytest.approx(forward, rel=1e-3)


def test_derivative_by_given_normals(sphere):
    """Those of the packets are the given ones, which the tangents are made perpendicular to."""
    rng = np.random.default_rng(6)
    given = sphere.mesh.normals() + 0.2 * rng.normal(size=sphere.mesh.normals().shape)
    given /= np.linalg.norm(given, axis=1, keepdims=True)
    weight, direction = rng.normal(size=(155, 12)), rng.normal(size=given.shape)
    direction -= given * np.sum(direction * given, axis=1, keepdims=True)  # they stay of unit length

    def moved(eps):
        normals = given + eps * direction
        own = replace(sphere.mesh, own_normals=normals / np.linalg.norm(normals, axis=1, keepdims=True))
        return numpy_packets(own, own.positions)

    positions, normals = flat(sphere.mesh.positions), flat(given)
    np.testing.assert_allclose(sphere.surface(positions, normals).packets.numpy().reshape(-1, 12), moved(0), atol=2e-5)
    difference = np.sum((moved(1e-5) - moved(-1e-5)) / 2e-5 * weight)
    adjoint, along = mi.Float(weight.astype(np.float32).ravel()), flat(direction)
    dr.enable_grad(normals)
    dr.backward(dr.sum(sphere.surface(positions, normals).packets * adjoint))
    assert dr.dot(dr.grad(normals), along)[0] == pytest.approx(difference, rel=2e-3)
    assert np.abs(dr.grad(positions).numpy()).max() == 0  # they asked for no gradient

    normals = flat(given)
    dr.enable_grad(normals)
    out = sphere.surface(positions, normals).packets
    dr.set_grad(normals, along)
    dr.enqueue(dr.ADMode.Forward, normals)
    dr.traverse(dr.ADMode.Forward)
    assert dr.sum(dr.grad(out) * adjoint)[0] == pytest.approx(difference, rel=2e-3)


def test_degenerate_faces_leave_everything_finite():
    """A face without area, two positions at one place, a face without UV area, a position without a face."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [1, 0, 0], [5, 5, 5], [0, -1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 4, 2], [0, 6, 1]])
    uvs = np.float32([[0, 1], [1, 1], [0, 0], [0.5, 1], [1, 1], [0, 0], [0.5, 1]])
    topology = MeshTopology(Mesh(positions, np.arange(7), uvs, faces))
    x = flat(positions)
    dr.enable_grad(x)
    out = topology.surface(x).packets
    got = out.numpy().reshape(-1, 12)
    assert np.isfinite(got).all() and np.allclose(np.linalg.norm(got[:, 4:7], axis=1), 1, atol=1e-5)
    assert np.allclose(np.linalg.norm(got[:, 8:11], axis=1), 1, atol=1e-5)
    assert np.allclose(got[5, 4:7], [0, 1, 0])
    assert np.allclose(got, numpy_packets(topology.mesh, positions), atol=1e-5)
    dr.backward(dr.sum(out))
    assert np.isfinite(dr.grad(x).numpy()).all()


def test_vertices_without_a_tangent_of_their_own_get_the_exported_one():
    """No UV area at all: what the fit shades with is what the file will say, whatever the normal."""
    mesh = charted_sphere(2, noise=0.1)
    topology = MeshTopology(Mesh(mesh.positions, mesh.position_index, mesh.uvs * 0, mesh.faces))
    assert np.abs(packets(topology, mesh.positions) - numpy_packets(topology.mesh, mesh.positions)).max() < 2e-6


def test_meshes_of_other_sizes_do_not_disturb_each_other():
    """Frozen functions are recorded anew for other sizes, of the positions alone too."""
    mesh = charted_sphere(4, noise=0.05, seed=1)
    spare = replace(mesh, positions=np.concatenate([mesh.positions, np.ones((40, 3))]))
    for m in (mesh, spare, charted_sphere(6, noise=0.05, seed=1), mesh):
        topology, positions = MeshTopology(m), flat(m.positions)
        dr.enable_grad(positions)
        result = topology.surface(positions).packets
        assert np.abs(result.numpy().reshape(-1, 12) - numpy_packets(topology.mesh, m.positions)).max() < 5e-6
        dr.backward(dr.sum(result))
        grad = dr.grad(positions).numpy().reshape(-1, 3)
        assert np.array_equal(np.any(grad != 0, axis=1), np.isin(np.arange(len(m.positions)), m.position_index))
