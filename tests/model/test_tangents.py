"""The tangent frame: known values on planes, mirrored charts, the sphere."""

import numpy as np
import pytest

from mi_simplify.model.mesh import Mesh
from mi_simplify.model.tangents import face_tangents, split_mirrored, vertex_tangents
from mi_simplify.model.topology import vertex_normals


def quad(uvs) -> Mesh:
    """Unit square in the xy plane, facing +z."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    return Mesh(positions, np.arange(4), np.float32(uvs), np.array([[0, 1, 2], [0, 2, 3]]))


def frame(mesh):
    n = vertex_normals(mesh.positions, mesh.position_faces)
    t, w = vertex_tangents(mesh, n)
    return t, w[:, None] * np.cross(n[mesh.position_index], t), w


@pytest.mark.parametrize(
    ("uvs", "t_expected", "b_expected", "w_expected"),
    [
        ([[0, 1], [1, 1], [1, 0], [0, 0]], [1, 0, 0], [0, 1, 0], 1),  # the image stands upright
        ([[1, 1], [0, 1], [0, 0], [1, 0]], [-1, 0, 0], [0, 1, 0], -1),  # mirrored left to right
        ([[0, 0], [1, 0], [1, 1], [0, 1]], [1, 0, 0], [0, -1, 0], -1),  # upside down, so mirrored too
        ([[0, 0], [0, 1], [1, 1], [1, 0]], [0, 1, 0], [-1, 0, 0], 1),  # turned by a quarter
    ],
)
def test_bitangent_points_up_the_image(uvs, t_expected, b_expected, w_expected):
    t, b, w = frame(quad(uvs))
    assert np.allclose(t, [t_expected] * 4) and np.allclose(b, [b_expected] * 4) and np.all(w == w_expected)


def test_mirrored_neighbours_are_split_and_keep_their_own_sign():
    positions = np.array([[-1, 0, 0], [0, 0, 0], [1, 0, 0], [-1, 1, 0], [0, 1, 0], [1, 1, 0]], float)
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    uvs = np.float32(np.stack([1 - np.abs(positions[:, 0]), 1 - positions[:, 1]], 1))
    mesh = split_mirrored(Mesh(positions, np.arange(6), uvs, faces))
    assert len(mesh.uvs) == 8 and len(mesh.positions) == 6
    t, b, w = frame(mesh)
    left = np.isin(np.arange(8), mesh.faces[:2])
    assert np.all(w[left] == 1) and np.all(w[~left] == -1)
    assert np.allclose(t[left], [1, 0, 0]) and np.allclose(t[~left], [-1, 0, 0])
    assert np.allclose(b, [0, 1, 0])
    assert split_mirrored(mesh) is mesh


def test_sphere_tangents_follow_the_parallels():
    phi, theta = np.meshgrid(np.linspace(0, np.pi, 33), np.linspace(0.6, np.pi - 0.6, 17))
    p = np.stack([np.cos(phi) * np.sin(theta), np.cos(theta), -np.sin(phi) * np.sin(theta)], -1).reshape(-1, 3)
    k = np.arange(17 * 33).reshape(17, 33)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    uvs = np.float32(np.stack([phi.ravel() / np.pi, theta.ravel() / np.pi], 1))
    mesh = Mesh(p, np.arange(len(p)), uvs, faces)
    t, b, w = frame(mesh)
    inside = k[2:-2, 2:-2].ravel()
    east = np.stack([-np.sin(phi), 0 * phi, -np.cos(phi)], -1).reshape(-1, 3)
    assert np.all(w == 1)
    assert np.einsum("vi,vi->v", t, east)[inside].min() > 0.999
    assert np.all(b[inside, 1] > 0.3)


def test_faces_without_uv_area_do_not_disturb():
    mesh = quad([[0, 1], [1, 1], [1, 0], [0.5, 0.5]])  # the second triangle is a line in UV space
    flat, sign = face_tangents(mesh)
    assert sign.tolist() == [1, 0] and np.allclose(flat[1], 0)
    t, _, w = frame(mesh)
    assert np.isfinite(t).all() and np.allclose(np.linalg.norm(t, axis=1), 1) and np.all(w == 1)
    assert np.allclose(t[:3], [1, 0, 0])
