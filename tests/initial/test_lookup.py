"""Looking from a low-poly surface at a detailed one: points, textures, rays, and what is read at a hit."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.initial.soup import merge
from mi_simplify.model.asset import PLAIN, Asset, Instance, Material, Part
from mi_simplify.model.mesh import Mesh

QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
QUAD_UV = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])  # seen from +z the image stands upright
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def quad(z=0.0, uvs=QUAD_UV, faces=FACES, **more) -> Part:
    return Part(QUAD + [0, 0, z], faces, uvs=uvs, **more)


def soup_of(*parts: Part):
    return merge(Asset(parts, tuple(Instance(k) for k in range(len(parts)))))


def low(uvs=QUAD_UV, reach=1.0):
    from mi_simplify.initial.bake.lookup import LowPoly

    return LowPoly(Mesh(QUAD, np.arange(4), np.float32(uvs), FACES), np.full(4, reach))


def look(low_poly, *parts, size=4):
    """Points, hits, and the 18 numbers of every texel, shape (size, size, 18)."""
    from mi_simplify.initial.bake.lookup import Detail
    from mi_simplify.machine.meshes import MISS

    detail = Detail(soup_of(*parts))
    points = low_poly.points(size, (0.5, 0.5))
    hits = detail.search(points)
    face = hits.face.numpy().reshape(size, size)
    hits.face = dr.select(hits.face == MISS, 0, hits.face)
    values = np.stack([x.numpy() for x in detail.shade(points, hits)], 1).reshape(size, size, 18)
    return face, values


def test_texels_know_where_they_lie_on_the_surface():
    points = low(reach=0.3).points(4, (0.5, 0.5))
    p = points.p.numpy().T.reshape(4, 4, 3)
    x, y = np.meshgrid([-0.75, -0.25, 0.25, 0.75], [0.75, 0.25, -0.25, -0.75])
    assert points.active.numpy().all()
    np.testing.assert_allclose(p, np.stack([x, y, 0 * x], 2), atol=1e-6)
    for vector, expected in ((points.n, [0, 0, 1]), (points.ray, [0, 0, 1]), (points.t, [1, 0, 0])):
        np.testing.assert_allclose(vector.numpy().T, np.tile(expected, (16, 1)), atol=1e-6)
    assert (points.w.numpy() == 1).all() and np.allclose(points.reach.numpy(), 0.3)


def test_coordinates_that_leave_the_texture_repeat():
    inside = low().points(8, (0.5, 0.5))
    moved = low(QUAD_UV + [2.25, -1.5]).points(8, (0.5, 0.5))
    a, b = (x.p.numpy().T.reshape(8, 8, 3) for x in (inside, moved))
    assert moved.active.numpy().all()
    np.testing.assert_allclose(b, np.roll(a, (4, 2), (0, 1)), atol=1e-5)


@pytest.mark.parametrize("uv", [(0.5, 0.5), (0.1, 0.9), (-0.3, 1.7), (0.0, 0.0)])
def test_images_are_bilinear_and_repeat(uv):
    from mi_simplify.initial.bake.lookup import Images

    rng = np.random.default_rng(0)
    textures = [rng.random((3, 5, 4)).astype(np.float32), rng.random((2, 2, 3)).astype(np.float32)]
    for k, texture in enumerate(textures):
        h, w = texture.shape[:2]
        x, y = uv[0] * w - 0.5, uv[1] * h - 0.5
        x0, y0 = int(np.floor(x)), int(np.floor(y))
        expected = sum(
            (x - x0 if dx else 1 - x + x0) * (y - y0 if dy else 1 - y + y0) * texture[(y0 + dy) % h, (x0 + dx) % w]
            for dx in (0, 1)
            for dy in (0, 1)
        )
        value = Images(textures, [PLAIN] * 2).at(mi.UInt32(k), [mi.Point2f(*uv)]).numpy().ravel()
        np.testing.assert_allclose(value[: len(expected)], expected, atol=1e-6)


def test_of_the_surfaces_that_face_alike_the_closest_is_seen():
    face, values = look(low(), quad(0.6), quad(-0.2), quad(0.05, faces=FACES[:, ::-1]))
    assert set(face.ravel()) <= {2, 3}  # the third one is nearer, but turned away
    np.testing.assert_allclose(values[..., 13], -0.2, atol=1e-5)
    face, values = look(low(), quad(0.1), quad(-0.2))
    assert set(face.ravel()) <= {0, 1}
    np.testing.assert_allclose(values[..., 13], 0.1, atol=1e-5)


def test_nothing_within_reach_is_no_face():
    from mi_simplify.initial.bake.lookup import MISS

    face, _ = look(low(reach=0.1), quad(0.2))
    assert (face == MISS).all()


def test_material_numbers_are_those_of_the_file():
    base = np.float32([[[0.8, 0.4, 0.2, 0.25]]])
    specular = np.float32([[[0.1, 0.6, 0.9]]])
    _, v = look(low(), quad(material=Material("m", base, specular, alpha_mode="BLEND")))
    expected = [0.2, 0.1, 0.05, 0.8, 0.4, 0.2, 0.25, 0.1, 0.6, 0.9, 0, 0, 1, 0, 0, 0, 0, 1]
    np.testing.assert_allclose(v[0, 0], expected, atol=1e-5)
    _, v = look(low(), quad(material=Material("m", base, specular)))  # OPAQUE ignores opacity
    assert np.allclose(v[..., 6], 1) and np.allclose(v[..., :3], [0.8, 0.4, 0.2])
    for cutoff, opacity in ((0.2, 1), (0.3, 0)):
        _, v = look(low(), quad(material=Material("m", base, specular, alpha_mode="MASK", alpha_cutoff=cutoff)))
        assert (v[..., 6] == opacity).all()


def test_vertex_colours_tint_the_texture():
    colors = np.tile(np.float32([0.5, 1, 0.25, 1]), (4, 1))
    _, v = look(low(), quad(colors=colors, material=Material("m", np.float32([[[0.8, 0.4, 0.2, 1]]]))))
    np.testing.assert_allclose(v[..., 3:6], np.broadcast_to([0.4, 0.4, 0.05], (4, 4, 3)), atol=1e-5)


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
@pytest.mark.parametrize("mirror", [False, True])
def test_a_normal_map_is_turned_from_one_texture_space_into_the_other(turn, mirror):
    """The detail's UVs lie turned or mirrored under the low-poly's: the world-space normal must survive."""
    lean = np.float32([0.3, 0.5, 0])
    lean[2] = np.sqrt(1 - lean @ lean)
    a = np.radians(turn)
    spin = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    uvs = (QUAD_UV - 0.5) @ spin.T * ([-1, 1] if mirror else [1, 1]) + 0.5
    _, v = look(low(), quad(uvs=np.float32(uvs), material=Material("m", normal=lean.reshape(1, 1, 3))))
    d = np.linalg.solve((QUAD[1:3, :2] - QUAD[0, :2]), uvs[1:3] - uvs[0])  # d uv / d (x, y)
    t = np.array([d[0, 0], d[1, 0]]) / np.hypot(d[0, 0], d[1, 0])  # where u grows
    b = -np.array([d[0, 1], d[1, 1]]) / np.hypot(d[0, 1], d[1, 1])  # where v falls
    expected = np.append(lean[0] * t + lean[1] * b, lean[2])
    np.testing.assert_allclose(v[1, 1, 10:13], expected, atol=1e-5)


def test_a_normal_that_turns_away_is_laid_onto_the_surface():
    steep = np.tile(np.float32([1, 0, -0.3]) / np.float32(np.hypot(1, 0.3)), (4, 1))
    _, v = look(low(), quad(normals=steep))
    assert 0.04 < v[1, 1, 12] < 0.06 and v[1, 1, 10] > 0.99
