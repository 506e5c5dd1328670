"""Reference renderers: against analytic radiance and coverage, and what each transport contains."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh
from support.models import textured_sphere

from mi_simplify.errors import AssetError, UserError
from mi_simplify.integrators.camera import Cameras
from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.latent.latent import Latent
from mi_simplify.machine.upload import upload
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.scenes.references.direct import DirectReference
from mi_simplify.scenes.references.mitsuba import MitsubaReference
from mi_simplify.scenes.references.path_traced import make_reference, scene_reference
from mi_simplify.scenes.references.reference import CallableReference, is_aligned
from mi_simplify.scenes.views import goniometer, look_at

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]])


def matt(color=(0.8, 0.8, 0.8), opacity=1.0, mode="OPAQUE"):
    """γ = 1: nothing but Lambert where light comes from the viewer."""
    base_color = np.float32([[[*color, opacity]]])
    return Material("matt", base_color, np.float32([[[1, 0.5, 0]]]), alpha_mode=mode)


def asset(*parts):
    return Asset(tuple(parts), tuple(Instance(k) for k in range(len(parts))))


def square(z=0.0, half=1.0, center=(0, 0), **kwargs):
    vertices, faces = SQUARE
    return Part(vertices * half + [*center, z], faces, material=matt(**kwargs))


def from_above(width=16, height=16, fov=40.0, distance=4.0, light=None):
    """Looking down -z, up the image is +y, the light at the camera by default."""
    eye = [0, 0, distance]
    return look_at(eye, [0, 0, 0], light or eye, width=width, height=height, fov=fov, irradiance=np.pi)


def film_points(width, height, fov, distance, per_pixel=8):
    """Points of the plane z = 0 under the film, shape (height·per_pixel, width·per_pixel, 3)."""
    half = distance * np.tan(np.radians(fov) / 2)
    x, y = (((np.arange(n * per_pixel) + 0.5) / (n * per_pixel) * 2 - 1) * half for n in (width, height))
    return np.stack(np.broadcast_arrays(x[None], -y[:, None] * height / width, 0.0), -1)


def block_mean(x, k=8):
    return x.reshape(x.shape[0] // k, k, x.shape[1] // k, k, *x.shape[2:]).mean((1, 3))


# --- analytic values -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("transport", ["direct", "baked"])
@pytest.mark.parametrize("form", ["gltf", "paper"])
def test_plane_under_a_point_light_at_the_camera(transport, form):
    color, distance = np.array([0.8, 0.5, 0.2]), 4.0
    reference = make_reference(asset(square(half=5, color=color)), transport=transport, spp=64, form=form)
    image = reference.render(from_above(12, 8))[0]
    p = film_points(12, 8, 40, distance)
    d2 = np.sum((p - [0, 0, distance]) ** 2, -1)
    intensity = np.pi * distance**2  # look_at: π arrives at the target
    expected = block_mean(intensity * (distance / np.sqrt(d2)) / (np.pi * d2))[..., None] * color
    assert image.shape == (8, 12, 4) and image.dtype == np.float32
    assert np.allclose(image[..., :3], expected, rtol=0.01)
    assert np.allclose(image[..., 3], 1)


def test_sphere_under_a_point_light_at_the_camera():
    """Radiance kd·cos·I / (π d²) over the visible cap, coverage that of the disk under which it is seen."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    part = Part(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64), material=matt())
    n, k, distance, fov = 24, 64, 4.0, 40.0  # k²: slivers of the disk are in some pixels
    image = make_reference(asset(part), spp=256).render(from_above(n, n))[0]
    p = film_points(n, n, fov, distance, k)
    d = (p - [0, 0, distance]) / np.linalg.norm(p - [0, 0, distance], axis=-1, keepdims=True)
    b = -distance * d[..., 2]
    disc = b**2 - (distance**2 - 1)
    t = b - np.sqrt(np.maximum(disc, 0))
    normal = [0, 0, distance] + t[..., None] * d
    value = 0.8 * distance**2 / t**2 * np.maximum(-np.sum(normal * d, -1), 0)
    expected, coverage = (block_mean(x, k) for x in (np.where(disc > 0, value, 0), 1.0 * (disc > 0)))
    assert image[..., 3].sum() == pytest.approx(coverage.sum(), rel=0.005)  # the mesh lies inside of the sphere
    assert np.abs(image[..., 3] - coverage).max() < 0.08
    inside = coverage == 1
    assert inside.sum() > 100
    assert np.abs(image[inside][:, 0] - expected[inside]).max() < 0.02
    assert np.abs(image[8:16, 8:16, 0] - expected[8:16, 8:16]).max() < 0.01
    outside = coverage == 0
    assert outside.sum() > 100 and np.all(image[outside] == 0)
    edge = ~inside & ~outside  # premultiplied: no more light than surface
    assert np.abs(image[edge][:, 0] - expected[edge]).max() < 0.04


@pytest.mark.parametrize(("width", "height"), [(48, 16), (16, 48)])
def test_film_is_not_transposed_nor_flipped(width, height):
    """Coloured squares at three places come out where the camera model of the latent renderer says."""
    spots = {(0.5, 0.2): (1, 0, 0), (-0.4, -0.3): (0, 1, 0), (-0.3, 0.35): (0, 0, 1)}
    parts = [square(half=0.06, center=c, color=color) for c, color in spots.items()]
    eyes, fov = [[0, 0, 3], [0.5, 0.3, 2.9]], 70 if width > height else 32
    views = look_at(eyes, [0, 0, 0], [0, 0, 3], width=width, height=height, fov=fov, up=[0.2, 1, 0], irradiance=np.pi)
    images = make_reference(asset(*parts), spp=64).render(views)
    y, x = np.mgrid[:height, :width] + 0.5
    for k in range(2):
        for channel, c in enumerate(spots):
            film = Cameras.of(views).project(mi.UInt32(k), mi.Point3f(*c, 0)).numpy().ravel()
            weight = images[k, ..., channel]
            assert np.sum(weight * x) / weight.sum() == pytest.approx(film[0], abs=0.15)
            assert np.sum(weight * y) / weight.sum() == pytest.approx(film[1], abs=0.15)


# --- transports ------------------------------------------------------------------------------------------------------

SHADOW = dict(width=16, height=16, fov=40.0, distance=6.0, light=[3.0, 0.0, 4.0])


def lid_over_floor(**kwargs):
    """A small square between the light, which stands to the right, and the middle of a floor."""
    return asset(square(half=4), square(z=2.0, half=0.5, center=(1.5, 0.0), **kwargs))


def test_direct_has_no_shadow_and_baked_has():
    direct = make_reference(lid_over_floor(), transport="direct", spp=16).render(from_above(**SHADOW))[0]
    baked = make_reference(lid_over_floor(), transport="baked", spp=16, max_depth=2).render(from_above(**SHADOW))[0]
    middle = (slice(7, 9), slice(7, 9))  # the ray from the light to the origin passes through (1.5, 0, 2)
    assert np.allclose(baked[middle][..., :3], 0) and np.all(direct[middle][..., 0] > 0.3)
    left = (slice(0, 16), slice(0, 4))
    assert np.allclose(direct[left], baked[left], rtol=0.03)
    assert np.array_equal(direct[..., 3], baked[..., 3])


def test_baked_has_indirect_light_and_matched_is_path_traced_alike():
    """Two walls of a corner light each other; path tracing to depth 2 does not."""
    wall = Part(np.array([[-2, -2, 0], [-2, 2, 0], [-2, 2, 4], [-2, -2, 4]], float), SQUARE[1], material=matt())
    corner, views = asset(square(half=2), wall), from_above(8, 8, fov=30, light=[2, 0, 3.5])
    direct, once, deep = (
        make_reference(corner, transport=t, spp=256, max_depth=m).render(views)[0, ..., 0]
        for t, m in (("direct", 6), ("baked", 2), ("baked", 6))
    )
    assert np.allclose(direct, once, rtol=0.02)
    assert np.all((deep - once)[:, :2] > 0.03) and np.all(deep[:, 0] - once[:, 0] > deep[:, -1] - once[:, -1])
    matched = make_reference(corner, transport="matched", spp=256, max_depth=6).render(views)[0, ..., 0]
    assert np.array_equal(matched, deep)


def test_sky_lights_but_is_not_seen():
    """A white Lambert plane shows the radiance of the sky over it (F90 takes and gives a little at grazing angles)."""
    reference = make_reference(asset(square(half=1.0, color=(1, 1, 1))), transport="baked", spp=256, sky=2.0)
    views = from_above(16, 16, fov=60.0, light=[0, 0, -5.0])  # the light is behind
    image = reference.render(views)[0]
    assert np.allclose(image[7:9, 7:9, :3], 2, rtol=0.1)
    assert np.allclose(image[7:9, 7:9, 3], 1) and np.all(image[0] == 0)


@pytest.mark.parametrize("transport", ["direct", "baked"])
def test_opacity_is_coverage_and_premultiplies(transport):
    views = from_above(8, 8, fov=20.0)
    quality = dict(transport=transport, spp=512, max_depth=3)
    solid, glass = (
        make_reference(asset(square(opacity=0.25, mode=m)), **quality).render(views)[0] for m in ("OPAQUE", "BLEND")
    )
    assert np.allclose(solid[..., 3], 1) and np.allclose(glass[..., 3].mean(), 0.25, atol=0.01)
    assert np.allclose(glass[..., :3].mean((0, 1)), solid[..., :3].mean((0, 1)) * 0.25, rtol=0.03)
    half = make_reference(asset(square(opacity=0.25, mode="MASK")), transport=transport, spp=16).render(views)[0]
    assert np.all(half == 0)  # below the cutoff


def test_unknown_transport_is_named():
    with pytest.raises(UserError, match="unknown transport 'magic': expected one of direct, baked, matched"):
        make_reference(asset(square()), transport="magic")


# --- the interface ---------------------------------------------------------------------------------------------------


def test_each_view_has_its_own_camera_and_light():
    reference = make_reference(asset(square(half=5)), transport="direct", spp=1)
    views = look_at(
        [[0, 0, 4]] * 4, [[0, 0, 0]] * 4, [[0, 0, 4], [0, 0, 4], [0, 0, 4], [3, 0, 4]],
        width=12, height=12, fov=np.array([40, 40, 20, 40]), irradiance=np.array([[1.0], [2.0], [1.0], [1.0]]),
    )  # fmt: skip
    a = reference.render(views, seed=5)
    assert np.allclose(a[1], [2, 2, 2, 1] * a[0], rtol=1e-6)  # the same places in all views
    assert np.ptp(a[2, ..., 0]) < 0.6 * np.ptp(a[0, ..., 0])  # half the angle: less of the falling off
    assert a[3, :, -1, 0].mean() > a[3, :, 0, 0].mean() * 1.5  # lit from the right
    assert np.array_equal(reference.render(views, seed=5), a) and not np.array_equal(reference.render(views, seed=6), a)


def test_each_path_traced_view_has_its_own_noise():
    reference = make_reference(asset(square(half=5)), transport="baked", spp=1)
    a = reference.render(from_above(12, 12).take(np.array([0, 0])), seed=5)
    assert np.allclose(a[1], a[0], rtol=0.2) and not np.array_equal(a[1], a[0])


def test_film_size_may_change_between_calls():
    reference = make_reference(asset(square(half=0.7)), spp=64)
    small = reference.render(from_above(8, 8))[0]
    wide = reference.render(from_above(32, 16))[0]
    assert wide.shape == (16, 32, 4) and np.array_equal(reference.render(from_above(8, 8))[0], small)
    fine = reference.render(from_above(16, 16))[0]
    assert np.allclose(block_mean(fine, 2), small, atol=0.15)


def test_no_kernel_is_compiled_for_further_views():
    reference = make_reference(asset(square(half=0.7)), transport="direct", spp=2)
    rng = np.random.default_rng(0)
    reference.render(goniometer(2, rng, width=16, height=16, irradiance=np.pi), seed=1)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        reference.render(goniometer(3, rng, width=16, height=16, fov=50, irradiance=np.pi), seed=2)
        history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert len(history) >= 3 and len({k["hash"] for k in history}) < len(history)
    assert all(k["cache_hit"] for k in history)


def test_callable_reference_checks_what_it_is_given():
    views = from_above(6, 4)
    image = np.ones((1, 4, 6, 4))
    got = CallableReference(lambda v: image * len(v)).render(views)
    assert got.shape == image.shape and got.dtype == np.float32
    with pytest.raises(UserError, match=r"returned shape \(1, 6, 4, 4\), expected \(1, 4, 6, 4\)"):
        CallableReference(lambda v: image.transpose(0, 2, 1, 3)).render(views)
    with pytest.raises(UserError, match=r"returned shape \(1, 4, 6, 3\)"):
        CallableReference(lambda v: image[..., :3]).render(views)
    for bad in (np.nan, np.inf):
        with pytest.raises(UserError, match="NaN or infinite"):
            CallableReference(lambda v, bad=bad: image * bad).render(views)


# --- Mitsuba scenes --------------------------------------------------------------------------------------------------

SCENE = """<scene version="3.0.0">
    <integrator type="direct"/>
    <emitter type="constant"><rgb name="radiance" value="7, 7, 7"/></emitter>
    <sensor type="perspective"/>
    %s
</scene>"""
DISK = '<shape type="disk"><bsdf type="diffuse"><rgb name="reflectance" value=".8, .4, .2"/></bsdf>%s</shape>'


def test_mitsuba_scene_is_seen_with_our_light_only(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(SCENE % (DISK % ""))
    for transport in ("baked", "direct"):
        image = scene_reference(str(path), transport=transport, spp=64).render(from_above(9, 9, fov=40))[0]
        assert np.allclose(image[4, 4], [0.8, 0.4, 0.2, 1], rtol=0.02) and np.all(image[0, 0] < 1e-6)


def test_mitsuba_scene_leaves_its_area_lights_out(tmp_path, caplog):
    path = tmp_path / "lamp.xml"
    lamp = """<shape type="sphere"><point name="center" x="2" y="0" z="2"/>
        <emitter type="area"><rgb name="radiance" value="9, 9, 9"/></emitter></shape>"""
    path.write_text(SCENE % (DISK % "" + lamp))
    image = scene_reference(str(path), spp=64).render(from_above(9, 9, fov=40))[0]
    assert np.allclose(image[4, 4], [0.8, 0.4, 0.2, 1], rtol=0.02)
    assert "lamp.xml: 1 shapes are area lights and stay out" in caplog.text


def test_mitsuba_scene_errors_are_one_line(tmp_path):
    with pytest.raises(AssetError, match="missing.xml"):
        scene_reference(str(tmp_path / "missing.xml"))
    broken, empty = tmp_path / "broken.xml", tmp_path / "empty.xml"
    broken.write_text("<scene version='3.0.0'><shape type='nonsense'/></scene>")
    empty.write_text(SCENE % "")
    with pytest.raises(AssetError, match="broken.xml: Mitsuba cannot load this scene: .+") as error:
        scene_reference(str(broken))
    assert "\n" not in str(error.value)
    with pytest.raises(AssetError, match="empty.xml: the scene has no shapes"):
        scene_reference(str(empty))


def test_direct_light_sees_what_the_latent_renderer_sees_at_the_same_places():
    """The same model by both, with two samples: noise of 4 % in either, hardly any between them."""
    model = textured_sphere()
    reference = make_reference(model.as_asset())
    assert is_aligned(reference)
    assert not is_aligned(make_reference(model.as_asset(), sky=0.1))
    views = goniometer(3, np.random.default_rng(1), width=64, height=64)
    latent = Latent(model)
    positions = upload(mi.Float, latent.topology.mesh.positions.ravel())
    renderer = DeferredRenderer(latent.topology)
    renderer.move(positions)
    surface = latent.evaluate(positions)
    with dr.suspend_grad():
        frame = renderer.render(surface, latent.textures, views, spp=2, seed=dr.opaque(mi.UInt32, 7))
    theirs = reference.render(views, seed=7, spp=2)
    difference = np.abs(frame.images() - theirs).max(-1)
    assert (difference > 1e-3).mean() < 1e-3  # rays that graze an edge
    other = reference.render(views, seed=8, spp=2)
    assert np.abs(other - theirs).mean() > 20 * difference.mean()


def test_direct_light_is_that_of_mitsubas_own_lamp():
    """A launch for all views, and one a view under a point light in the scene: shadowless, see-through, glowing."""
    glass = square(z=0.5, half=0.5, opacity=0.4, mode="BLEND")
    glowing = replace(matt(), emission=np.float32([[[0.2, 0.1, 0.0]]]))
    seen = asset(glass, replace(square(), material=glowing))
    views = goniometer(2, np.random.default_rng(2), width=32, height=32)
    reference = make_reference(seen)
    assert isinstance(reference, DirectReference)
    one_by_one = MitsubaReference(reference.shapes, {"type": "direct_edge", "layers": 8}, 64, True)
    assert np.abs(reference.render(views, 3, spp=64) - one_by_one.render(views, 3)).mean() < 2e-3
