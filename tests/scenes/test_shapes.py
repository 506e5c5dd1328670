"""Assets as Mitsuba shapes: arrays in and out, winding, instances, materials, vertex colours."""

import mitsuba as mi
import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.machine.meshes import MovingMesh, make_mesh, mesh_faces, mesh_normals, mesh_positions, mesh_uvs
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.model.model import Model
from mi_simplify.scenes import shapes
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.shapes import asset_shapes, bitmap, material_bsdf, part_normals
from mi_simplify.scenes.views import look_at

VERTICES = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UPRIGHT = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])


def lambert(color, alpha=1.0, **kwargs):
    """γ = 1 and a light at the camera: the picture shows the base colour (times cos/d², nearly constant)."""
    image = np.float32(color)
    image = image[None, None] if image.ndim == 1 else image
    image = np.concatenate([image, np.full((*image.shape[:2], 1), alpha, np.float32)], 2)
    return Material("m", image, np.float32([[[1, 0.5, 0]]]), **kwargs)


def picture(asset, size=16, eye=(0, 0, 8), fov=16.0, spp=16, **kwargs):
    views = look_at(list(eye), [0, 0, 0], list(eye), width=size, height=size, fov=fov, irradiance=np.pi)
    return make_reference(asset, spp=spp, **kwargs).render(views, seed=3)[0]


def one(part, to_world=None):
    return Asset((part,), (Instance(0, np.eye(4) if to_world is None else to_world),))


# --- arrays ----------------------------------------------------------------------------------------------------------


def test_mesh_gives_back_what_it_was_made_of():
    normals = np.tile(np.float32([0, 0.6, 0.8]), (4, 1))
    mesh = make_mesh("quad", VERTICES, FACES, normals, UPRIGHT)
    assert np.array_equal(mesh_positions(mesh).numpy().reshape(-1, 3), VERTICES)
    assert np.array_equal(mesh_faces(mesh), FACES) and mesh_faces(mesh).dtype == np.int64
    assert np.allclose(mesh_normals(mesh), normals) and np.array_equal(mesh_uvs(mesh), UPRIGHT)
    bare = make_mesh("bare", VERTICES, FACES)
    assert mesh_normals(bare) is None and mesh_uvs(bare) is None


def test_normals_are_the_files_or_angle_weighted_over_welded_positions():
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    soup = Part(cube[faces].reshape(-1, 3), np.arange(36).reshape(12, 3))
    assert np.allclose(part_normals(soup), soup.vertices / 3**0.5)
    own = np.tile(np.float32([0, 1, 0]), (36, 1))
    assert part_normals(Part(soup.vertices, soup.faces, own)) is own


def test_moving_mesh_is_hit_where_it_has_moved_to():
    mesh = MovingMesh(VERTICES, FACES)
    ray = mi.Ray3f(mi.Point3f(0.2, 0.1, 5), mi.Vector3f(0, 0, -1))
    assert mesh.scene.ray_intersect(ray).t[0] == pytest.approx(5)
    mesh.move(mi.Float((VERTICES + [0, 0, 2]).astype(np.float32).ravel()))
    assert mesh.scene.ray_intersect(ray).t[0] == pytest.approx(3)
    mesh.move(mi.Float((VERTICES + [3, 0, 0]).astype(np.float32).ravel()))
    assert not mesh.scene.ray_intersect(ray).is_valid()[0]


# --- materials -------------------------------------------------------------------------------------------------------


def test_first_texture_row_is_at_v_zero():
    image = np.zeros((2, 2, 3), np.float32)
    image[0, 0], image[0, 1], image[1, 0] = (1, 0, 0), (0, 1, 0), (0, 0, 1)  # top left, top right, bottom left
    got = picture(one(Part(VERTICES, FACES, uvs=UPRIGHT, material=lambert(image))))
    corners = got[4, 4, :3], got[4, 11, :3], got[11, 4, :3], got[11, 11, :3]
    assert np.allclose(corners, image.reshape(4, 3), atol=0.1)


def test_textures_repeat():
    image = np.linspace(0.1, 0.9, 16).reshape(4, 4, 1).repeat(3, 2).astype(np.float32)
    a, b = (
        picture(one(Part(VERTICES, FACES, uvs=UPRIGHT + s, material=lambert(image))), spp=4)
        for s in (np.float32([0, 0]), np.float32([3, -2]))
    )
    assert np.allclose(a, b, atol=1e-3) and np.ptp(a[..., 0]) > 0.5


def test_alpha_modes():
    half = [picture(one(Part(VERTICES, FACES, material=lambert([0.8] * 3, 0.4, alpha_mode=m))), spp=256)
            for m in ("OPAQUE", "BLEND", "MASK")]  # fmt: skip
    assert np.allclose(half[0][4:-4, 4:-4], [0.8] * 3 + [1], rtol=0.03)
    assert np.allclose(half[1][4:-4, 4:-4].mean((0, 1)), [0.32] * 3 + [0.4], rtol=0.05)
    assert np.all(half[2] == 0)
    low = lambert([0.8] * 3, 0.4, alpha_mode="MASK", alpha_cutoff=0.3)
    assert np.allclose(picture(one(Part(VERTICES, FACES, material=low)))[4:-4, 4:-4, 3], 1)


def test_every_channel_of_a_material_arrives():
    rng = np.random.default_rng(0)
    material = Material(
        "m", rng.random((4, 4, 4), np.float32), rng.random((4, 4, 3), np.float32), None, alpha_mode="BLEND"
    )
    params = mi.traverse(mi.load_dict(material_bsdf(material)))
    assert np.allclose(np.array(params["base_color.data"]), material.base_color[..., :3], atol=1e-6)
    assert np.allclose(np.array(params["opacity.data"])[..., 0], material.base_color[..., 3], atol=1e-6)
    for k, name in enumerate(("gamma", "roughness", "metallic")):
        assert np.allclose(np.array(params[f"{name}.data"])[..., 0], material.specular[..., k], atol=1e-6)
    plain = mi.traverse(mi.load_dict(material_bsdf(Material(specular=np.float32([[[0.1, 0.2, 0.3]]])))))
    assert [plain[f"{k}.value"][0] for k in ("gamma", "roughness", "metallic")] == pytest.approx([0.1, 0.2, 0.3])
    assert not any(k.startswith("opacity") for k in plain.keys())
    with pytest.raises(ValueError, match="1, 3 or 4 channels"):
        bitmap(np.zeros((2, 2, 2)))


def test_each_part_has_its_own_material_and_attributes():
    """Four quarters: red, green with a normal map, blue by its vertices, and red again, which is the same object."""
    red, green = lambert([0.8, 0, 0]), lambert([0, 0.8, 0], normal=np.tile(np.float32([0, 0, 1]), (2, 2, 1)))
    blue = np.tile(np.float32([0, 0, 1, 1]), (4, 1))
    quarter = lambda x, y, m, c=None: Part(VERTICES / 2 + [x, y, 0], FACES, None, UPRIGHT, c, m)  # noqa: E731
    parts = quarter(-0.5, 0.5, red), quarter(0.5, 0.5, green), quarter(-0.5, -0.5, red, blue), quarter(0.5, -0.5, red)
    parts = (*parts[:2], quarter(-0.5, -0.5, lambert([0.8] * 3), blue), parts[3])
    asset = Asset(parts, tuple(Instance(k) for k in range(4)))
    got = picture(asset)
    expected = [[0.8, 0, 0], [0, 0.8, 0], [0, 0, 0.8], [0.8, 0, 0]]
    assert np.allclose([got[y, x, :3] for y, x in ((4, 4), (4, 11), (11, 4), (11, 11))], expected, atol=0.03)
    shapes = asset_shapes(asset)
    assert shapes["part_0"].bsdf() is shapes["part_3"].bsdf()


def test_vertex_colours_multiply_base_colour_and_opacity():
    colors = np.float32([[1, 0, 0, 0.5], [0, 1, 0, 0.5], [0, 1, 0, 0.5], [1, 0, 0, 0.5]])  # red left, green right
    for base in (np.float32([0.5, 0.5, 0.5]), np.full((2, 2, 3), 0.5, np.float32)):
        part = Part(VERTICES, FACES, uvs=UPRIGHT, colors=colors, material=lambert(base))
        got = picture(one(part))
        x = (np.arange(16) + 0.5) / 16 * 2 - 1  # the square fills nearly all of the film
        expected = 0.5 * np.stack([(1 - x) / 2, (1 + x) / 2], 1)
        assert np.allclose(got[8, 2:-2, :2], expected[2:-2], atol=0.03) and np.all(got[8, 2:-2, 2] < 1e-6)
        assert np.allclose(got[8, 2:-2, 3], 1)  # OPAQUE ignores every opacity
        part = Part(VERTICES, FACES, uvs=UPRIGHT, colors=colors, material=lambert(base, 0.5, alpha_mode="BLEND"))
        assert picture(one(part), spp=128)[4:-4, 4:-4, 3].mean() == pytest.approx(0.25, abs=0.02)


def test_vertex_colours_survive_the_splitting_of_mirrored_charts():
    mesh = charted_sphere(4)
    normal = np.tile(np.float32([0, 0, 1]), (2, 2, 1))
    color = np.concatenate([np.abs(mesh.vertices), np.ones((len(mesh.uvs), 1))], 1).astype(np.float32)
    part = Part(mesh.vertices, mesh.faces, uvs=mesh.uvs, colors=color, material=lambert([0.8] * 3, normal=normal))
    flat = Part(mesh.vertices, mesh.faces, uvs=mesh.uvs, colors=color, material=lambert([0.8] * 3))
    a, b = (picture(one(p), eye=(4, 4, 4), fov=20, spp=4) for p in (part, flat))
    assert np.allclose(a, b, atol=2e-3)
    lit = b[b[..., 3] == 1]
    assert np.ptp(lit[:, 0] - lit[:, 1]) > 0.3  # colours, not white


# --- winding and instances -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("with_map", [False, True])
def test_inside_out_winding_is_lit_like_the_right_one(with_map):
    mesh = charted_sphere(4, noise=0.02)
    normal = np.tile(np.float32([0.36, 0.48, 0.8]), (2, 2, 1)) if with_map else None
    normals = (mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)).astype(np.float32)
    material = lambert([0.8] * 3, normal=normal)
    part = Part(mesh.vertices, mesh.faces, normals, mesh.uvs, material=material)
    turned = Part(mesh.vertices, mesh.faces[:, ::-1], normals, mesh.uvs, material=material)
    a, b = (picture(one(p), eye=(3, 2, 4), fov=25, spp=4) for p in (part, turned))
    assert np.allclose(a, b, atol=1e-4) and a[..., 0].max() > 0.5


def placements(n):
    """n small copies in a row, each turned another way, every other one mirrored."""
    out = []
    for k in range(n):
        turn = mi.ScalarTransform4f().rotate([0.3, 0.5, 0.8], 70 * k).scale(0.12)
        matrix = np.array(turn.matrix) @ np.diag([1 - 2 * (k % 2), 1, 1, 1])
        matrix[:3, 3] = (k % 4 - 1.5) * 0.5, (k // 4 - 1) * 0.5, 0
        out.append(Instance(0, matrix, f"i{k}"))
    return tuple(out)


@pytest.mark.parametrize("normal", [None, [0.48, 0.36, 0.8]])
@pytest.mark.parametrize("copied", [10**6, 0])
def test_many_placements_look_like_copies(normal, copied, monkeypatch):
    """More than a handful of placements become one mesh, or Mitsuba instances of one, turned and mirrored ones too."""
    monkeypatch.setattr(shapes, "_COPIED", copied)
    mesh, rng = charted_sphere(6, noise=0.01), np.random.default_rng(1)
    if normal is not None:
        normal = np.tile(np.float32(normal), (2, 2, 1))
    part = Part(mesh.vertices, mesh.faces, uvs=mesh.uvs, material=lambert(rng.random((8, 8, 3)), normal=normal))
    instances = placements(12)
    many = Asset((part,), instances)
    copies = Asset((part, part), tuple(Instance(k // 6, i.to_world) for k, i in enumerate(instances)))
    kinds = [type(s).__name__ for s in asset_shapes(many).values()]
    assert kinds == ["Mesh"] if copied else len(kinds) == 13 and "Mesh" not in kinds  # a group and its instances
    assert len(asset_shapes(copies)) == 12
    a, b = (picture(x, size=64, spp=16) for x in (many, copies))
    assert np.array_equal(a[..., 3] > 0, b[..., 3] > 0)
    error = np.abs(a - b)[..., :3]
    assert error.mean() < 0.01 * b[..., :3].mean() + 1e-4 and np.quantile(error, 0.999) < 0.1


def test_model_as_asset_keeps_its_mapped_normals():
    """Latent model, asset, shapes: the textures and tangents that the export writes are those that are rendered."""
    mesh = charted_sphere(2)
    base = np.full((2, 2, 4), 0.5, np.float32)
    tilted = np.tile(np.float32([0.6, 0, 0.8]), (2, 2, 1))
    flat = np.tile(np.float32([0, 0, 1]), (2, 2, 1))
    specular = np.tile(np.float32([1, 0.5, 0]), (2, 2, 1))
    a, b = (picture(Model(mesh, base, specular, n).as_asset(), eye=(0, 0, 4), fov=30) for n in (tilted, flat))
    assert np.array_equal(a[..., 3], b[..., 3]) and np.abs(a - b).max() > 0.1
