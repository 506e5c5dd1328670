"""Geometry images: discs out of surfaces, maps without folds, grids that follow deformations."""

import numpy as np
import pytest
import trimesh

from mi_simplify.errors import MeshError
from mi_simplify.model.topology import weld
from mi_simplify.transfer.surfaces.borders import border_loops, genus
from mi_simplify.transfer.surfaces.disc import make_disc
from mi_simplify.transfer.surfaces.image import geometry_image, grid_faces
from mi_simplify.transfer.surfaces.square import map_to_square, n_flipped


def grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A bumpy square, n × n vertices."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    return np.stack([x.ravel(), y.ravel(), 0.3 * np.sin(3 * x.ravel()) * y.ravel()], 1), grid_faces(n)


def sphere() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(3)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def with_holes() -> tuple[np.ndarray, np.ndarray]:
    """The bumpy square less two pieces of its inside."""
    vertices, faces = grid(20)
    middle = vertices[faces].mean(1)[:, :2]
    inside = [(np.abs(middle - c) < 0.1).all(1) for c in ([0.3, 0.3], [0.7, 0.6])]
    return vertices, faces[~(inside[0] | inside[1])]


def test_borders_and_genus():
    assert [len(loop) for loop in border_loops(with_holes()[1])] == [76, 18, 18]
    assert genus(with_holes()[1], 3) == 0 and genus(sphere()[1], 0) == 0
    assert genus(np.asarray(trimesh.creation.torus(1, 0.3).faces), 0) == 1


def test_a_grid_comes_back_as_itself():
    """At its own resolution the map of a flat grid is the identity, but for a turn of the square."""
    vertices, faces = grid(17)
    vertices[:, 2] = 0
    image = geometry_image(vertices, faces, 17)
    assert image.figures["flipped"] == 0 and image.figures["stretch"] == pytest.approx(1, abs=1e-6)
    assert image.figures["distance"] < 1e-5
    found = image.positions(vertices).astype(np.float64)
    assert np.abs(np.sort(found @ [1, 17, 0]) - np.sort(vertices @ [1, 17, 0])).max() < 1e-5


@pytest.mark.parametrize("surface", [grid(20), sphere(), with_holes()], ids=["grid", "sphere", "holes"])
def test_no_triangle_folds_and_the_grid_lies_on_the_surface(surface):
    image = geometry_image(*surface, 48, close_holes=True)
    assert image.figures["flipped"] == 0
    assert image.figures["distance"] < 2e-3
    assert np.abs(image.sampler.sum(axis=1) - 1).max() < 1e-9 and image.sampler.data.min() >= 0


def test_clamped_weights_do_not_fold_where_cotangents_do():
    """A fan of slivers, whose cotangent weights are far below zero."""
    rng = np.random.default_rng(3)
    vertices, faces = grid(12)
    inside = (vertices[:, :2] > 0.05).all(1) & (vertices[:, :2] < 0.95).all(1)
    vertices[inside, :2] += rng.uniform(-0.1, 0.1, (inside.sum(), 2))
    vertices[:, 2] = rng.uniform(0, 0.5, len(vertices))
    disc = make_disc(vertices, faces)
    places = disc.source @ vertices
    assert n_flipped(disc.faces, map_to_square(disc, places)) == 0


def test_edges_from_border_to_border_are_split():
    """Two triangles alone: their diagonal would fall together with a side of the square."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, -0.3, 0]], float)
    disc = make_disc(vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1]]))
    assert len(disc.faces) == 7 and disc.notes == ("2 edges split that ran from border to border",)
    assert n_flipped(disc.faces, map_to_square(disc, disc.source @ vertices)) == 0


def test_a_closed_surface_stays_closed_in_the_grid():
    image = geometry_image(*sphere(), 33)
    positions = image.positions(sphere()[0])
    np.testing.assert_allclose(positions, positions[image.weld], atol=1e-6)
    assert np.count_nonzero(image.weld != np.arange(33**2)) == 63
    normals = image.normals(positions)
    outwards = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    assert (normals * outwards).sum(1).min() > 0.9


def test_the_grid_follows_deformations():
    vertices, faces = with_holes()
    image = geometry_image(vertices, faces, 24, close_holes=True)
    affine = np.array([[1, 0.2, 0], [0, 2, 0.5], [0.3, 0, 1]])
    both = image.positions(np.stack([vertices, vertices @ affine]))
    np.testing.assert_allclose(both[1], both[0] @ affine, atol=1e-5)


def test_what_has_no_such_form_is_refused_with_the_way_out():
    torus = trimesh.creation.torus(1, 0.3)
    two = np.concatenate([sphere()[1], sphere()[1] + 642])
    three = np.concatenate([sphere()[1], [[0, 1, 5]], [[0, 1, 9]]])
    nan = grid(5)[0] * np.where(np.arange(25) == 7, np.nan, 1)[:, None]
    for (vertices, faces), message in [
        ((np.asarray(torus.vertices), np.asarray(torus.faces)), "without handles expected, it has 1; cut it"),
        (with_holes(), "one border expected, it has 3; close its holes with 'close_holes: true'"),
        ((np.tile(sphere()[0], (2, 1)), two), "it has 2 pieces; choose one with 'part'"),
        ((sphere()[0], three), "have more than two faces|wound against"),
        ((nan, grid(5)[1]), "finite positions expected"),
    ]:
        with pytest.raises(MeshError, match=message):
            geometry_image(vertices, faces, 16)


@pytest.mark.parametrize("narrow", [6706, 9409])
def test_the_face_is_flat_enough(shared_assets, narrow):
    data = np.load(shared_assets / "face" / "ict_face.npz")
    quads = data["quads"][(data["quads"] < narrow).all(1)]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    image = geometry_image(data["neutral"], faces, 64, close_holes=True)
    assert image.figures["flipped"] == 0 and image.figures["distance"] < 5e-3


def test_shared_open_surfaces_do_not_fold(shared_assets):
    from mi_simplify.formats.load import load_asset

    n = 0
    for part in load_asset(shared_assets / "alpha_blend" / "AlphaBlendModeTest.glb").placed():
        vertices, index = weld(part.vertices)
        faces = index[part.faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
        try:
            disc = make_disc(vertices, faces)
        except MeshError:
            continue
        n += 1
        assert n_flipped(disc.faces, map_to_square(disc, disc.source @ vertices)) == 0
    assert n == 6
