"""Welding, angles, normals and creases on shapes whose answers are known."""

import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.model.topology import corner_angles, fitted_normals, normal_groups, vertex_normals, weld

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CUBE_FACES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])


def test_weld_keeps_the_order_of_first_appearance():
    vertices = np.array([[3, 0, 0], [1, 0, 0], [3, 0, 0], [0.0, 0, 0], [-0.0, 0, 0], [1, 0, 0]])
    positions, index = weld(vertices)
    assert positions.tolist() == [[3, 0, 0], [1, 0, 0], [0, 0, 0]] and index.tolist() == [0, 1, 0, 2, 2, 1]
    assert np.array_equal(positions[index], vertices) and index.dtype == np.int64
    rng = np.random.default_rng(0)
    soup = rng.integers(0, 4, (500, 3)).astype(float)
    positions, index = weld(soup)
    assert np.array_equal(positions[index], soup) and len(np.unique(soup, axis=0)) == len(positions)
    nearly = np.array([[1.0, 0, 0], [1.0 + 1e-12, 0, 0]])
    assert len(weld(nearly)[0]) == 2  # equal, not close


def test_corner_angles():
    positions = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0, 0]], float)
    angles = np.degrees(corner_angles(positions, np.array([[0, 1, 2], [0, 3, 1], [0, 0, 1]])))
    assert np.allclose(angles[0], [90, 45, 45]) and np.allclose(angles[1], [0, 180, 0])  # a needle: no area,
    assert np.isfinite(angles[2]).all() and angles[2, 0] == 0  # an edge without length
    needle = np.array([[0, 0, 0], [1, 1e-9, 0], [1, 0, 0]])
    assert corner_angles(needle, np.array([[0, 1, 2]]))[0, 0] == pytest.approx(1e-9, rel=1e-3)


def test_normals_weigh_by_angle_not_by_area_or_number_of_triangles():
    """Two quads in a right angle, one cut differently and much longer: the shared edge points half way."""
    positions = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0], [0, 9, 1], [0, 9, 0]], float)
    floor, wall = [[0, 1, 2], [0, 2, 3]], [[0, 5, 1], [1, 5, 4]]
    n = vertex_normals(positions, np.array(floor + wall))
    expected = np.array([1, 1, 0]) / 2**0.5
    assert np.allclose(n[:2], [expected, expected]) and np.allclose(n[2:4], [0, 1, 0]) and np.allclose(n[4:], [1, 0, 0])
    assert np.allclose(vertex_normals(CUBE, CUBE_FACES), CUBE / 3**0.5)


def test_fitted_normals_keep_large_faces_flat_beside_narrow_ones():
    """The same two quads: the edge points along the longer one's normal, as that is 9 times as large."""
    positions = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0], [0, 9, 1], [0, 9, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 5, 1], [1, 5, 4]])
    n = fitted_normals(positions, faces, faces)
    assert n[:2, 0].min() > 0.95 and n[1, 0] > 0.99 and np.allclose(n[2:4, 1], 1, atol=0.1)
    assert (np.sum(fitted_normals(CUBE, CUBE_FACES, CUBE_FACES) * CUBE, axis=1) / 3**0.5).min() > 0.94
    assert np.allclose(fitted_normals(1e-6 * positions, faces, faces), n)


def test_fitted_normals_are_close_to_the_least_squares_of_those_of_the_faces():
    """Beside the exact solution with the mass matrix of linear elements, before both are made unit vectors."""
    mesh = charted_sphere(6, noise=0.1)
    faces = mesh.position_faces
    cross = np.cross(*(mesh.positions[faces[:, k]] - mesh.positions[faces[:, 0]] for k in (1, 2)))
    area = np.linalg.norm(cross, axis=1)
    mass, right = np.zeros((len(mesh.positions),) * 2), np.zeros((len(mesh.positions), 3))
    for i in range(3):
        np.add.at(right, faces[:, i], cross / 3)
        for j in range(3):
            np.add.at(mass, (faces[:, i], faces[:, j]), area * (1 + (i == j)) / 12)
    best = np.linalg.solve(mass, right)
    best /= np.linalg.norm(best, axis=1, keepdims=True)
    mean = right / np.linalg.norm(right, axis=1, keepdims=True)
    weights = np.random.default_rng(0).dirichlet(np.ones(3), 64)

    def missed(normals):
        n = np.einsum("sk,fki->sfi", weights, normals[faces])
        n /= np.linalg.norm(n, axis=2, keepdims=True)
        return (area * (1 - np.einsum("sfi,fi->sf", n, cross / area[:, None]))).mean()

    own = fitted_normals(mesh.positions, faces, faces)
    assert missed(own) < 1.01 * missed(best) and missed(best) < 0.98 * missed(mean)


def test_normals_of_a_sphere_point_outwards_and_degenerate_ones_up():
    mesh = charted_sphere(8)
    n = vertex_normals(mesh.positions, mesh.position_faces)
    assert np.sum(n * mesh.positions, axis=1).min() > 0.995 and np.allclose(np.linalg.norm(n, axis=1), 1)
    lost = vertex_normals(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]]), np.array([[0, 1, 2]]))
    assert np.array_equal(lost, np.tile([0.0, 1, 0], (4, 1)))


def test_creases_cut_a_cube_into_its_sides():
    groups = normal_groups(CUBE, CUBE_FACES, 60)
    assert groups.max() + 1 == 24
    n = fitted_normals(CUBE, CUBE_FACES, groups)[groups]
    flat = np.cross(CUBE[CUBE_FACES[:, 1]] - CUBE[CUBE_FACES[:, 0]], CUBE[CUBE_FACES[:, 2]] - CUBE[CUBE_FACES[:, 0]])
    assert np.allclose(n, (flat / np.linalg.norm(flat, axis=1, keepdims=True))[:, None])
    smooth = normal_groups(CUBE, CUBE_FACES, 100)
    assert smooth.max() + 1 == 8
    outwards = fitted_normals(CUBE, CUBE_FACES, smooth)[smooth] * CUBE[CUBE_FACES] / 3**0.5
    assert outwards.sum(2).min() > 0.94 and smooth.shape == CUBE_FACES.shape


def test_a_group_lies_at_one_position_and_no_crease_leaves_one_a_position():
    mesh = charted_sphere(4, noise=0.05)
    faces = mesh.position_faces
    for angle in (0, 10, 30, 180):
        groups = normal_groups(mesh.positions, faces, angle)
        owner = np.full(groups.max() + 1, -1)
        owner[groups.ravel()] = faces.ravel()
        assert np.array_equal(owner[groups], faces) and np.unique(groups).size == groups.max() + 1
    assert normal_groups(mesh.positions, faces, 180).max() + 1 == len(mesh.positions)
    assert normal_groups(mesh.positions, faces, 0).max() + 1 > len(mesh.positions)


def test_a_face_wound_the_wrong_way_keeps_its_corners_apart_or_with_the_right_ones():
    """Two coplanar triangles, the second turned over: its normals oppose, so the edge is a crease below 180°."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 3, 2]])
    assert normal_groups(positions, faces, 90).max() + 1 == 6
    joined = normal_groups(positions, faces, 180)
    assert joined[0, 0] == joined[1, 0] and joined[0, 2] == joined[1, 2] and joined.max() + 1 == 4
