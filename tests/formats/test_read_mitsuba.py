"""Mitsuba scenes: what is tessellated and approximated for the first guess, and the scene itself as the reference."""

import json
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from support.tiny_models import corner_pixels, png

from mi_simplify import cli
from mi_simplify.errors import AssetError, UserError
from mi_simplify.formats.load import load_asset
from mi_simplify.formats.mitsuba.read import SceneAsset
from mi_simplify.machine.meshes import make_mesh
from mi_simplify.model.asset import Asset
from mi_simplify.model.color import srgb_to_linear
from mi_simplify.model.frame import Frame
from mi_simplify.scenes.references.path_traced import make_reference, scene_reference
from mi_simplify.scenes.references.reference import FramedReference
from mi_simplify.scenes.views import held_out_views, look_at

RED = '<bsdf type="diffuse"><rgb name="reflectance" value=".8, .2, .1"/></bsdf>'
PLACED = '<transform name="to_world"><rotate x=".6" y=".8" angle="40"/>%s<translate x="3" y="-2" z="5"/></transform>'


@pytest.fixture
def scene(tmp_path):
    """Writes a scene of the given elements, and a texture beside it; returns its path."""

    def write(*elements: str, name: str = "scene.xml") -> str:
        (tmp_path / "corners.png").write_bytes(png(corner_pixels()))
        path = tmp_path / name
        path.write_text('<scene version="3.0.0">\n' + "\n".join(elements) + "\n</scene>")
        return str(path)

    return write


def shape(plugin: str, *inside: str, id: str = "") -> str:
    return f'<shape type="{plugin}" id="{id or plugin}">{"".join(inside)}</shape>'


def scaled(x: float, y: float | None = None, z: float | None = None) -> str:
    y, z = (x if k is None else k for k in (y, z))
    return f'<transform name="to_world"><scale x="{x}" y="{y}" z="{z}"/></transform>'


def bitmap(name: str, *inside: str, raw: bool = False) -> str:
    flags = f'<string name="filename" value="corners.png"/><boolean name="raw" value="{str(raw).lower()}"/>'
    return f'<texture type="bitmap" name="{name}">{flags}{"".join(inside)}</texture>'


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def part_of(path: str):
    (part,) = load_asset(path).parts
    return part


# --- shapes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("scale", ['<scale value="2"/>', '<scale x="-2" y="2" z="2"/>'])
@pytest.mark.parametrize("plugin", ["sphere", "cylinder", "disk", "rectangle", "cube"])
def test_tessellated_shapes_are_where_mitsuba_has_them(scene, plugin, scale, flip):
    """Positions, normals, texture coordinates and winding at the points that random rays hit."""
    given = "" if plugin in ("rectangle", "cube") else '<float name="radius" value="1.5"/>'
    flipped = f'<boolean name="flip_normals" value="{str(flip).lower()}"/>' if plugin != "cube" else ""
    path = scene(shape(plugin, PLACED % scale, flipped, "" if plugin == "disk" else given))
    part = part_of(path)
    mesh = make_mesh("m", part.vertices, part.faces, part.normals, part.uvs)
    theirs, ours = mi.load_file(path, optimize=False), mi.load_dict({"type": "scene", "mesh": mesh})
    rng = np.random.default_rng(1)
    origin = rng.normal(size=(4000, 3))
    origin = origin / np.linalg.norm(origin, axis=1, keepdims=True) * 12 + [3, -2, 5]
    target = rng.uniform(-1.5, 1.5, (4000, 3)) + [3, -2, 5]
    ray = mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f((target - origin).T))
    a, b = theirs.ray_intersect(ray), ours.ray_intersect(ray)
    both = a.is_valid().numpy() & b.is_valid().numpy()
    assert both.sum() > 200 and (a.is_valid().numpy() ^ b.is_valid().numpy()).sum() < 15
    size = 2 if plugin in ("disk", "rectangle", "cube") else 3
    assert np.abs((a.p - b.p).numpy()[:, both]).max() < 0.02 * size
    assert np.median(np.abs((a.p - b.p).numpy()[:, both])) < 1e-3 * size
    for n in (b.sh_frame.n, b.n):  # shading and winding; Mitsuba shades by the former alone
        agree = np.sum(a.sh_frame.n.numpy() * n.numpy(), 0)[both]
        assert agree.min() > 0.97
    apart = np.abs((a.uv - b.uv).numpy()[:, both])
    assert np.quantile(np.minimum(apart, 1 - apart), 0.99) < 0.01


def test_meshes_keep_their_triangles_and_flat_ones_their_facets(scene, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.export(tmp_path / "ball.ply")
    for flat in (False, True):
        flag = f'<string name="filename" value="ball.ply"/><boolean name="face_normals" value="{str(flat).lower()}"/>'
        part = part_of(scene(shape("ply", flag, scaled(2))))
        assert len(part.faces) == 320
        assert np.abs(part.vertices).max() == pytest.approx(2, rel=1e-6)
        d = part.vertices / np.linalg.norm(part.vertices, axis=1, keepdims=True)
        agree = np.sum(d * part.normals, axis=1)
        if flat:
            p = part.vertices[part.faces]
            facet = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
            facet /= np.linalg.norm(facet, axis=1, keepdims=True)
            assert np.allclose(part.normals[part.faces], facet[:, None], atol=1e-5) and agree.min() < 0.995
        else:
            assert agree.min() > 0.998


def test_the_isosurface_of_a_grid_is_where_mitsuba_has_it(scene, tmp_path):
    """A lopsided grid, scaled and moved; seen from six sides. Mitsuba 3.9 hits nothing where a grid is no cube."""
    z, y, x = np.meshgrid(*(np.linspace(0, 1, n) for n in (24, 24, 24)), indexing="ij")
    distance = np.sqrt((x - 0.4) ** 2 + (2 * (y - 0.55)) ** 2 + (1.5 * (z - 0.6)) ** 2) / 2 - 0.15
    mi.VolumeGrid(distance[..., None].astype(np.float32)).write(str(tmp_path / "grid.vol"))
    placed = '<transform name="to_world"><scale x="2" y="3" z="1.5"/><translate x="3" y="-2" z="5"/></transform>'
    path = scene(shape("sdfgrid", '<string name="filename" value="grid.vol"/>', placed, RED))
    asset = load_asset(path)
    triangles = Asset(asset.parts, asset.instances)
    views = held_out_views(asset.bounds, 6, 64)
    ours = make_reference(triangles, transport="direct", spp=64).render(views)
    theirs = make_reference(asset, transport="direct", spp=64).render(views)
    assert theirs[..., 3].mean() > 0.1
    assert np.abs(ours[..., 3] - theirs[..., 3]).mean() < 0.01


def test_a_mesh_without_triangles_is_one_clear_line(scene, tmp_path):
    (tmp_path / "empty.obj").write_text("v 0 0 0\nvn 0 0 1\n")
    path = scene(shape("obj", '<string name="filename" value="empty.obj"/>', id="void"), shape("cube"))
    with pytest.raises(
        AssetError, match=r"scene.xml: obj 'void' \(scene.xml, line 2, col 2\) has no triangles; take it"
    ):
        load_asset(path)


def test_instances_stand_where_they_are_put(scene):
    group = shape("shapegroup", shape("cube", RED), shape("sphere", scaled(0.5)), id="pair")
    place = '<shape type="instance"><ref id="pair"/><transform name="to_world">%s</transform></shape>'
    path = scene(group, place % '<translate x="10"/>', place % '<scale x="-1" y="2" z="1"/><translate y="-5"/>')
    asset = load_asset(path)
    assert len(asset.parts) == 2 and len(asset.instances) == 4 and asset.n_triangles == 2 * (12 + 16128)
    assert np.allclose(asset.bounds, [[-1, -7, -1], [11, 1, 1]])
    views = held_out_views(asset.bounds, 2, 48)
    own = Asset(asset.parts, asset.instances)
    theirs, ours = (make_reference(a, spp=64).render(views) for a in (asset, own))
    assert psnr(theirs, ours) > 45 and theirs[..., 3].mean() > 0.02
    assert np.abs(theirs - ours)[..., 3].mean() < 1e-3


def test_the_same_picture_as_mitsuba_makes_of_the_file(scene):
    """Plugins made one by one, and references to shared ones, mean what they mean to ``mi.load_file``."""
    shared = f'<bsdf type="twosided" id="shared"><bsdf type="diffuse">{bitmap("reflectance")}</bsdf></bsdf>'
    merged = shape("merge", shape("rectangle", '<ref id="shared"/>', id="r"), shape("cube", scaled(0.3), RED))
    metal = '<bsdf type="roughconductor"><string name="material" value="Cu"/></bsdf>'
    ball = shape("sphere", '<point name="center" x="1" y="0" z="1"/><float name="radius" value=".5"/>', metal)
    views = look_at([[1, 2, 4]], [0, 0, 0], [[3, 3, 3]], width=48, height=32, irradiance=np.pi)
    arrays = views.arrays()
    x, y, z = arrays["origin"][0]
    sensor = f"""<integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <emitter type="point"><point name="position" x="3" y="3" z="3"/>
        <rgb name="intensity" value="{arrays["light_intensity"][0, 0]}"/></emitter>
        <sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
        <lookat origin="{x}, {y}, {z}" target="0, 0, 0" up="0, 1, 0"/></transform>
        <sampler type="multijitter"><integer name="sample_count" value="256"/></sampler>
        <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/><rfilter type="box"/>
        <string name="pixel_format" value="rgba"/><string name="component_format" value="float32"/></film></sensor>"""
    expected = mi.render(mi.load_file(scene(shared, merged, ball, sensor)), spp=256, seed=5).numpy()
    image = scene_reference(scene(shared, merged, ball), spp=256, max_depth=2).render(views, seed=5)[0]
    assert np.abs(expected - image)[..., 3].max() < 0.2 and np.abs(expected - image)[..., 3].mean() < 4e-3
    assert psnr(expected, image) > 50 and image[..., :3].max() > 0.4


# --- materials -------------------------------------------------------------------------------------------------------

F0_GOLD = [0.9667, 0.8020, 0.3241]  # ((η - 1)² + k²) / ((η + 1)² + k²) of Mitsuba's RGB constants for Au
BSDFS = {
    "diffuse": ('<bsdf type="diffuse"><rgb name="reflectance" value=".8, .2, .1"/></bsdf>', [0.8, 0.2, 0.1], [0, 1, 0]),
    "default": ("", [0.5] * 3, [0, 1, 0]),
    "plastic": ('<bsdf type="plastic"><rgb name="diffuse_reflectance" value=".1, .2, .3"/></bsdf>', [0.1, 0.2, 0.3],
                [0, 0, 0]),
    "roughplastic": ('<bsdf type="roughplastic"><float name="alpha" value=".25"/></bsdf>', [0.5] * 3, [0, 0.5, 0]),
    "roughconductor": ('<bsdf type="roughconductor"><string name="material" value="Au"/>'
                       '<float name="alpha" value=".16"/></bsdf>', F0_GOLD, [0, 0.4, 1]),
    "mirror": ('<bsdf type="conductor"><rgb name="specular_reflectance" value=".9, .8, .7"/></bsdf>', [0.9, 0.8, 0.7],
               [0, 0, 1]),
    "principled": ('<bsdf type="principled"><rgb name="base_color" value=".3, .6, .9"/>'
                   '<float name="roughness" value=".7"/><float name="metallic" value=".25"/>'
                   '<float name="specular" value=".2"/></bsdf>', [0.3, 0.6, 0.9], [0.6, 0.7, 0.25]),
    "principled by eta": ('<bsdf type="principled"><float name="eta" value="1.5"/></bsdf>', [0.5] * 3, [0, 0.5, 0]),
    "ggx_gamma": ('<bsdf type="ggx_gamma"><rgb name="base_color" value=".2, .4, .6"/><float name="gamma" value=".5"/>'
                  '<float name="roughness" value=".3"/></bsdf>', [0.2, 0.4, 0.6], [0.5, 0.3, 0]),
    "twosided": (f'<bsdf type="twosided">{RED}</bsdf>', [0.8, 0.2, 0.1], [0, 1, 0]),
    "blend": (f'<bsdf type="blendbsdf"><float name="weight" value=".25"/>{RED}<bsdf type="conductor"/></bsdf>',
              [0.85, 0.4, 0.325], [0, 0.75, 0.25]),
}  # fmt: skip


@pytest.mark.parametrize("name", BSDFS)
def test_constant_materials(scene, name):
    bsdf, color, specular = BSDFS[name]
    material = part_of(scene(shape("sphere", bsdf))).material
    assert material.base_color.shape == (1, 1, 4) and material.alpha_mode == "OPAQUE"
    assert np.allclose(material.base_color[0, 0], [*color, 1], atol=1e-3)
    assert np.allclose(material.specular[0, 0], specular, atol=1e-3)


@pytest.mark.parametrize("name", ["diffuse", "roughconductor", "principled", "ggx_gamma", "roughplastic"])
def test_the_first_guess_looks_like_the_bsdf(scene, name):
    """How near the approximation is on a sphere, whose reference is the BSDF itself."""
    least = {"diffuse": 45, "roughconductor": 40, "principled": 32, "ggx_gamma": 45, "roughplastic": 30}
    bsdf = BSDFS[name][0].replace("</bsdf>", '<string name="distribution" value="ggx"/></bsdf>')
    asset = load_asset(scene(shape("sphere", bsdf if name.startswith("rough") else BSDFS[name][0])))
    views = held_out_views(asset.bounds, 4, 48)
    theirs, ours = (make_reference(a, spp=64).render(views) for a in (asset, Asset(asset.parts, asset.instances)))
    assert psnr(theirs, ours) > least[name]


def test_approximations_are_noted(scene):
    coat = '<bsdf type="principled"><float name="clearcoat" value="1"/></bsdf>'
    asset = load_asset(scene(shape("sphere", coat), shape("cube", '<bsdf type="dielectric" id="glass"/>')))
    assert any("principled (scene.xml, line 2, col " in n and "without its clearcoat" in n for n in asset.notes)
    assert any("dielectric 'glass' (scene.xml, line 3" in n and "refraction" in n for n in asset.notes)
    assert not load_asset(scene(shape("sphere", RED))).notes


def linear_corners() -> np.ndarray:
    return srgb_to_linear(corner_pixels() / 255)


def test_bitmaps_become_textures_texel_by_texel(scene):
    part = part_of(scene(shape("rectangle", f'<bsdf type="diffuse">{bitmap("reflectance")}</bsdf>')))
    assert np.allclose(part.material.base_color[..., :3], linear_corners(), atol=2e-3)
    raw = part_of(scene(shape("rectangle", f'<bsdf type="principled">{bitmap("roughness", raw=True)}</bsdf>'))).material
    luminance = (corner_pixels() / 255) @ [0.2126, 0.7152, 0.0722]
    assert np.allclose(raw.specular[..., 1], luminance, atol=5e-3) and raw.base_color.shape == (1, 1, 4)


def test_texture_transforms_and_procedural_textures_look_alike(scene):
    moved = '<transform name="to_uv"><scale x="2" y="3"/><translate x=".25" y=".1"/></transform>'
    checks = '<texture type="checkerboard" name="reflectance"><transform name="to_uv"><scale value="4"/></transform>'
    checks += "</texture>"
    for texture in (bitmap("reflectance", moved), checks):
        asset = load_asset(scene(shape("rectangle", f'<bsdf type="diffuse">{texture}</bsdf>')))
        views = look_at([[0, 0, 4]], [0, 0, 0], [[0, 0, 4]], width=64, height=64, fov=30, irradiance=np.pi)
        own = Asset(asset.parts, asset.instances)
        theirs, ours = (make_reference(a, spp=64).render(views) for a in (asset, own))
        assert psnr(theirs, ours) > 35 and theirs[..., :3].std() > 0.1


def test_normal_maps_look_alike(scene, tmp_path):
    rng = np.random.default_rng(2)
    n = np.dstack([rng.uniform(-0.4, 0.4, (8, 8, 2)), np.ones((8, 8))])
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    path = scene(
        shape("rectangle", f'<bsdf type="normalmap">{bitmap("normalmap", raw=True)}<bsdf type="diffuse"/></bsdf>')
    )
    (tmp_path / "corners.png").write_bytes(png(np.uint8(np.round((n * 0.5 + 0.5) * 255))))
    asset = load_asset(path)
    upright = asset.parts[0].material.normal * [1, -1, 1]  # the image lies upside down on Mitsuba's rectangle
    assert np.allclose(upright, n, atol=0.01)
    views = look_at([[0, 0, 4]], [0, 0, 0], [[3, 2, 3]], width=64, height=64, fov=28, irradiance=np.pi)
    flat = replace(asset.parts[0], material=replace(asset.parts[0].material, normal=None))
    theirs, ours, without = (
        make_reference(a, spp=64).render(views)
        for a in (asset, Asset(asset.parts, asset.instances), Asset((flat,), asset.instances))
    )
    assert psnr(theirs, ours) > 35 and psnr(theirs, without) < 30


@pytest.mark.parametrize("transport", ["direct", "baked"])
def test_masks_keep_their_coverage(scene, transport):
    bsdf = f'<bsdf type="mask"><float name="opacity" value=".3"/>{RED}</bsdf>'
    asset = load_asset(scene(shape("rectangle", bsdf)))
    material = asset.parts[0].material
    assert material.alpha_mode == "BLEND" and material.base_color[0, 0, 3] == pytest.approx(0.3)
    views = look_at([[0, 0, 4]], [0, 0, 0], [[0, 0, 4]], width=8, height=8, fov=10, irradiance=np.pi)
    image = make_reference(asset, transport=transport, spp=512, max_depth=3).render(views)[0]
    assert image[..., 3].mean() == pytest.approx(0.3, abs=0.01)
    assert np.allclose(image[..., :3].mean((0, 1)), [0.24, 0.06, 0.03], rtol=0.05)


def test_masks_let_light_through_to_what_they_cover(scene):
    """`path` would let the invisible lid cast a full shadow."""
    lid = f'<bsdf type="mask"><float name="opacity" value="0"/>{RED}</bsdf>'
    lid = shape("rectangle", '<transform name="to_world"><translate z="1"/></transform>', lid)
    path = scene(shape("disk", scaled(3), RED), lid)
    views = look_at([[0, 0, 4]], [0, 0, 0], [[0, 0, 4]], width=8, height=8, fov=10, irradiance=np.pi)
    image = make_reference(load_asset(path), transport="baked", spp=16, max_depth=8).render(views)[0]
    assert np.allclose(image[3:5, 3:5], [0.8, 0.2, 0.1, 1], rtol=0.02)


def test_colors_that_only_vertices_know(scene, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    colors = np.uint8(np.round(255 * (0.5 + 0.5 * ball.vertices)))
    head = f"ply\nformat ascii 1.0\nelement vertex {len(colors)}\n"
    head += "".join(f"property float {k}\n" for k in ("x", "y", "z", "r", "g", "b"))
    rows = [*(" ".join(map(str, (*v, *c / 255))) for v, c in zip(ball.vertices, colors, strict=True))]
    rows += [" ".join(map(str, (3, *f))) for f in ball.faces]
    faces = f"element face {len(ball.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "ball.ply").write_text(head + faces + "\n".join(rows) + "\n")
    texture = '<texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture>'
    file = '<string name="filename" value="ball.ply"/>'
    asset = load_asset(scene(shape("ply", file, f'<bsdf type="diffuse">{texture}</bsdf>')))
    part = asset.parts[0]
    assert np.allclose(part.colors[:, :3], 0.5 + 0.5 * part.vertices, atol=0.01) and np.all(part.colors[:, 3] == 1)
    assert np.allclose(part.material.base_color, 1)
    views = held_out_views(asset.bounds, 2, 32)
    theirs, ours = (make_reference(a, spp=32).render(views) for a in (asset, Asset(asset.parts, asset.instances)))
    assert psnr(theirs, ours) > 45


# --- what stays out --------------------------------------------------------------------------------------------------

LAMP = shape("sphere", scaled(0.2), '<emitter type="area"><rgb name="radiance" value="40"/></emitter>', id="lamp")


def test_lights_stay_out_unless_asked_for(scene, caplog):
    path = scene(
        shape("disk", RED), '<emitter type="constant"><rgb name="radiance" value="1"/></emitter>',
        LAMP.replace("<emitter", '<point name="center" x="0" y="8" z="8"/><emitter', 1),
    )  # fmt: skip
    asset = load_asset(path)
    assert len(asset.parts) == 1 and "1 shapes are area lights and stay out" in asset.notes
    assert "scene.xml: 1 shapes are area lights and stay out" in caplog.text
    views = look_at([[0, 0, 4]], [0, 0, 0], [[0, 0, 4]], width=16, height=16, fov=70, irradiance=0)
    dark = make_reference(asset, transport="baked", spp=256).render(views)[0]
    assert np.all(dark[..., :3] == 0) and dark[8, 8, 3] == 1
    lit = make_reference(asset, transport="baked", spp=256, lights=True).render(views)[0]
    e = np.pi + 40 * np.pi * 0.2**2 / 5.12 * 0.5**0.5  # environment, and the lamp at (0, 1.6, 1.6)
    assert np.allclose(lit[7:9, 7:9, :3].mean((0, 1)), np.array([0.8, 0.2, 0.1]) * e / np.pi, rtol=0.05)
    assert np.allclose(lit[..., 3], dark[..., 3], atol=0.15) and np.all(lit[0] == 0)  # neither sky nor lamp is seen
    with pytest.raises(UserError, match="environment of its own takes no other"):
        make_reference(asset, transport="baked", lights=True, sky=1.0)


def test_a_medium_without_surface_is_in_the_reference_only(scene):
    medium = '<bsdf type="null"/><medium type="homogeneous" name="interior"><float name="scale" value="9"/></medium>'
    path = scene(shape("rectangle", RED), shape("sphere", '<point name="center" x="2" y="0" z="0"/>', medium, id="fog"))
    asset = load_asset(path)
    assert len(asset.parts) == 1 and any("'fog'" in n and "only the reference shows it" in n for n in asset.notes)
    views = look_at([[2, 0, 8]], [2, 0, 0], [[2, 0, 8]], width=9, height=9, fov=20, irradiance=np.pi)
    image = make_reference(asset, transport="baked", spp=64, max_depth=8).render(views)[0]
    assert image[4, 4, 0] > 0.05


# --- the frame -------------------------------------------------------------------------------------------------------


def textured_obj(tmp_path) -> None:
    """A torus away from the origin, with texture coordinates, normals and the texture of the scene."""
    torus = trimesh.creation.torus(0.8, 0.35, major_sections=48, minor_sections=24)
    a = np.arctan2(torus.vertices[:, 1], torus.vertices[:, 0]) / (2 * np.pi)
    lines = ["mtllib torus.mtl"]
    lines += [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in torus.vertices * 7 + [30, -20, 50]]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in zip(np.abs(2 * a), 0.5 + 0.45 * torus.vertices[:, 2], strict=True)]
    lines += [f"vn {x:.7f} {y:.7f} {z:.7f}" for x, y, z in torus.vertex_normals] + ["usemtl m"]
    lines += ["f " + " ".join(f"{i}/{i}/{i}" for i in f + 1) for f in torus.faces]
    (tmp_path / "torus.obj").write_text("\n".join(lines))
    (tmp_path / "torus.mtl").write_text("newmtl m\nmap_Kd corners.png\nPr 0.4\nPm 0.2\n")


@pytest.mark.parametrize("transport", ["direct", "baked"])
def test_an_obj_in_a_scene_gives_the_images_of_the_obj(scene, tmp_path, transport):
    """All of the frame: cameras, lights and their intensity, in the normalised box, on a film that is not square."""
    textured_obj(tmp_path)
    bsdf = f'<bsdf type="ggx_gamma">{bitmap("base_color")}<float name="roughness" value=".4"/>'
    bsdf += '<float name="metallic" value=".2"/></bsdf>'
    path = scene(shape("obj", '<string name="filename" value="torus.obj"/>', bsdf))
    from_xml, from_obj = load_asset(path), load_asset(tmp_path / "torus.obj")
    frame = Frame.around(from_obj.bounds)
    assert np.allclose(from_xml.bounds, from_obj.bounds, atol=1e-4) and frame.scale < 0.2
    a, b = (frame.normalised(asset) for asset in (from_xml, from_obj))
    eyes = [[1.5, 1.2, 2.4], [-2, 0.4, -2.2]]
    views = look_at(eyes, [0, 0, 0], [[2, 2, 2], [-3, 0, -1]], width=72, height=40, fov=50, irradiance=np.pi)
    theirs, ours = (make_reference(asset, transport=transport, spp=64).render(views, seed=3) for asset in (a, b))
    assert theirs.shape == (2, 40, 72, 4) and ours[..., :3].max() > 0.5
    assert psnr(theirs, ours) > 60
    assert isinstance(a, SceneAsset) and a.scale == pytest.approx(frame.scale) and np.allclose(a.center, frame.center)


def test_a_framed_reference_undoes_any_frame(scene):
    asset = load_asset(scene(shape("cube", RED, PLACED % "")))
    views = held_out_views(asset.bounds, 2, 32)
    plain = make_reference(asset, spp=16)
    assert isinstance(plain, FramedReference) and plain.scale == 1
    expected = plain.render(views)
    arrays = views.arrays()
    for scale, center in ((0.01, [3, -2, 5]), (50.0, [100, 0, 0])):
        to_frame = np.diag([scale, scale, scale, 1.0])
        to_frame[:3, 3] = -scale * np.array(center)
        moved = {name: (arrays[name] - center) * scale for name in ("origin", "light_position")}
        moved["light_intensity"] = arrays["light_intensity"] * scale**2
        there = make_reference(asset.transformed(to_frame), spp=16)
        image = there.render(type(views).from_arrays(arrays | moved, views.width, views.height))
        assert psnr(image, expected) > 50
    twice = asset.transformed(to_frame).transformed(np.diag([2.0, 2.0, 2.0, 1.0]))
    assert isinstance(twice, SceneAsset) and twice.scale == pytest.approx(100)
    assert np.allclose(twice.center, [100, 0, 0])
    with pytest.raises(ValueError, match="scaled uniformly and translated"):
        asset.transformed(np.diag([1.0, 2.0, 1.0, 1.0]))


@pytest.mark.parametrize("size", [1e-2, 1e5])
def test_scenes_of_any_size_are_seen(scene, size):
    """Mitsuba's default clipping planes end at 10,000 units."""
    asset = load_asset(scene(shape("sphere", scaled(size), RED)))
    image = make_reference(asset, spp=16).render(held_out_views(asset.bounds, 1, 24))[0]
    unit = load_asset(scene(shape("sphere", scaled(1), RED)))
    assert psnr(image, make_reference(unit, spp=16).render(held_out_views(unit.bounds, 1, 24))[0]) > 35
    assert image[12, 12, 3] == 1


# --- errors ----------------------------------------------------------------------------------------------------------

BROKEN = {
    "malformed": ("<shape", "cannot load this scene"),
    "unknown plugin": ('<shape type="teapot"/>', "line 2.*teapot.*not found"),
    "unknown parameter": ('<shape type="sphere"><float name="radios" value="1"/></shape>', "line 2.*'radios'"),
    "unknown element": ("<sphere/>", "line 2.*sphere"),
    "wrong type": ('<shape type="sphere"><string name="radius" value="big"/></shape>', "line 2.*radius"),
    "missing mesh": ('<shape type="obj"><string name="filename" value="gone.obj"/></shape>', "line 2.*gone.obj"),
    "missing texture": (shape("sphere", f'<bsdf type="diffuse">{bitmap("reflectance").replace("corners", "x")}</bsdf>'),
                        "line 2.*x.png"),
    "missing include": ('<include filename="gone.xml"/>', "line 2.*gone.xml"),
    "broken reference": ('<shape type="sphere"><ref id="gone"/></shape>', "line 2.*gone"),
    "undefined parameter": ('<shape type="sphere"><float name="radius" value="$r"/></shape>', "line 2.*r"),
    "nothing": ("", "no shapes"),
    "only lights": (LAMP, "no shapes"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_wrong_with_a_scene_is_one_line(scene, name):
    element, expected = BROKEN[name]
    with pytest.raises(AssetError, match=f"^scene.xml: .*{expected}") as error:
        load_asset(scene(element))
    assert "\n" not in str(error.value) and ".cpp" not in str(error.value)


def test_a_file_of_one_shape_is_no_scene(tmp_path):
    (tmp_path / "one.xml").write_text('<shape version="3.0.0" type="sphere"/>')
    with pytest.raises(AssetError, match="one.xml: it describes a shape, not a scene"):
        load_asset(tmp_path / "one.xml")


# --- end to end ------------------------------------------------------------------------------------------------------

TOY = ["optimizer.steps=2", "optimizer.resolution=32", "optimizer.batch=1", "optimizer.spp=1", "reference.spp=2",
       "reference.pool=2", "initial.atlas_size=64", "evaluation.views=2", "evaluation.resolution=32",
       "evaluation.spp=8"]  # fmt: skip
TOY = [word for setting in TOY for word in ("--set", setting)]


def two_shapes(scene) -> str:
    metal = '<bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value=".3"/></bsdf>'
    ball = shape("sphere", '<point name="center" x="50" y="3" z="0"/><float name="radius" value="3"/>',
                 f'<bsdf type="diffuse">{bitmap("reflectance")}</bsdf>')  # fmt: skip
    floor = '<transform name="to_world"><scale x="5" y=".4" z="4"/><translate x="50"/></transform>'
    return scene(ball, shape("cube", floor, metal))


def test_the_command_line_takes_a_scene_wherever_it_takes_a_model(scene, tmp_path, monkeypatch, capsys):
    two_shapes(scene)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "job.yaml").write_text("asset: scene.xml\ninitial: {triangles: 300}\nreference: {transport: baked}\n")
    assert cli.main(["run", "job.yaml", "-o", "out", *TOY, "-q"]) == 0
    figures = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert figures["candidates"]["result"]["psnr"] > 24 and figures["candidates"]["first guess"]["psnr"] > 24
    bounds = load_asset(tmp_path / "out" / "model.glb").bounds  # back in the scene's own units
    assert np.allclose(bounds, [[45, -0.4, -4], [55, 6, 4]], atol=0.3)
    capsys.readouterr()
    settings = ["--views", "2", "--resolution", "32", "--spp", "16", "-q"]
    assert cli.main(["evaluate", "scene.xml", "out/model.glb", "scene.xml", *settings]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 2 and "300 triangles" in rows[0] and "silhouette error 0.0000" in rows[1]
    assert cli.main(["render", "scene.xml", "-o", "scene.exr", "--resolution", "32", "--spp", "4"]) == 0
    assert 0.1 < np.array(mi.Bitmap("scene.exr"))[..., 3].mean() < 0.9


def test_what_has_no_triangles_starts_from_a_sphere(scene, tmp_path, monkeypatch, capsys):
    (tmp_path / "wire.txt").write_text("\n".join(f"{x} {np.sin(x)} 0 0.4" for x in np.linspace(0, 5, 12)))
    scene(shape("bsplinecurve", '<string name="filename" value="wire.txt"/>', RED))
    monkeypatch.chdir(tmp_path)
    for command in (["simplify", "scene.xml", "-n", "100"], ["bake", "scene.xml", "scene.xml"]):
        assert cli.main([*command, "-o", "out"]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "bsplinecurve (scene.xml, line 2, col " in error or "'bsplinecurve'" in error
        assert "--set initial.kind=sphere --set initial.textures=constant" in error
        assert not (tmp_path / "out").exists()
    start = ["--set", "initial.kind=sphere", "--set", "initial.textures=constant"]
    assert cli.main(["simplify", "scene.xml", "-n", "100", "-o", "out", *TOY, *start, "-q"]) == 0
    assert (tmp_path / "out" / "model.glb").is_file()
