"""
`direct_edge` in scenes made of Mitsuba's own BSDFs, sensors, films and lights, against finite differences.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.integrators.visibility.projections import sensor_projections
from mi_simplify.machine.meshes import make_mesh

from .finite_difference import compare
from .mitsuba_cases import CASES
from .mitsuba_scene import camera


@pytest.fixture(autouse=True)
def quiet():
    """Mitsuba's samplers warn about sample counts that they round."""
    level = mi.logger().log_level()
    mi.set_log_level(mi.LogLevel.Error)
    yield
    mi.set_log_level(level)


def _check(name: str, names: tuple[str, ...] | None = None, **options) -> None:
    scene = CASES[name]()
    wanted = [p for p in scene.parameters() if names is None or p.name in names]
    pairs = compare(scene, name, wanted, scene.weights(), **options)
    assert pairs and not [str(p) for p in pairs if not p.passes]


@pytest.mark.parametrize("name", ["diffuse", "orthographic", "shadow of a point light"])
def test_slice(name):
    _check(name, ("growth",), spp=128, gradient_spp=32, rounds=(4, 8))


_CROP = {"crop_offset_x": 10, "crop_offset_y": 5, "crop_width": 32, "crop_height": 20}
SENSORS = {
    "perspective": {},
    "crop window": {"film": _CROP},
    "principal point in a crop window": {
        "film": _CROP, "principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1,
    },
    "orthographic": {"kind": "orthographic", "film": _CROP},
}  # fmt: skip


@pytest.mark.parametrize("name", SENSORS)
def test_projections_are_those_of_mitsuba(name):
    """The ray of every film position is the sensor's own, and its points are seen there."""
    sensor = mi.load_dict(camera(**SENSORS[name]))
    projections = sensor_projections(sensor)
    rng, film = np.random.default_rng(1), sensor.film()
    u = mi.Point2f(rng.random((2, 100)).astype(np.float32))
    x, y = (mi.Float(u[k] * film.crop_size()[k] + film.crop_offset()[k]) for k in (0, 1))
    ray, _ = sensor.sample_ray(0.0, 0.5, u, mi.Point2f(0.5))
    view = dr.zeros(mi.UInt32, 100)
    _, direction = projections.ray(view, x, y)
    assert np.allclose(direction.numpy(), ray.d.numpy(), atol=2e-6)
    back = projections.project(view, ray(3.0))
    assert np.allclose(back.x.numpy(), x.numpy(), atol=2e-4) and np.allclose(back.y.numpy(), y.numpy(), atol=2e-4)


def test_rays_of_an_aperture_meet_in_focus():
    sensor = mi.load_dict(camera("thinlens", aperture_radius=0.2, focus_distance=2.0))
    projections = sensor_projections(sensor, seed=3)
    n = projections.n_views
    assert n == 64 and projections.share == 1 / 64
    view = dr.arange(mi.UInt32, n)
    origin, direction = projections.ray(view, mi.Float(13.0), mi.Float(20.0))
    pinhole = sensor_projections(mi.load_dict(camera()))
    o, d = pinhole.ray(mi.UInt32(0), mi.Float(13.0), mi.Float(20.0))
    forward = pinhole.fetch(mi.UInt32(0), 1).xyz
    focus = o + d * (2.0 / dr.dot(d, forward))
    off = dr.norm(dr.cross(mi.Vector3f(focus - origin), direction))
    assert dr.max(off)[0] < 1e-5
    spread = dr.norm(origin - o).numpy()
    assert 0.1 < spread.mean() < 0.15 and spread.max() < 0.2  # uniform on the disk: two thirds of its radius


def test_crop_window_leaves_out_what_is_outside():
    """An edge that no sample of the crop window and its filter border can see has no gradient."""
    from .mitsuba_scene import MitsubaScene

    film = {"crop_offset_x": 0, "crop_offset_y": 0, "crop_width": 4, "crop_height": 36}
    scene = MitsubaScene({"type": "diffuse"}, sensor=camera(rfilter="gaussian", film=film))
    gradient = scene.gradient(scene.weights(), 16, 1)["ball"]
    assert (scene.image(scene.start, 4, 1)[..., :3] == 0).all() and (gradient == 0).all()


@pytest.mark.parametrize("sign", [-1, 1])
def test_shadow_that_hardly_peeks_out(sign):
    """Where the border of a shadow runs along the silhouette of what casts it, a 250th of a pixel beside it."""
    width, height, seen = 32, 24, 2.6
    plate = make_mesh(
        "plate",
        np.float32([[-0.5, -0.4, 0], [0.5, -0.4, 0], [0.5, 0.4, 0], [-0.5, 0.4, 0]]),
        np.uint32([[0, 1, 2], [0, 2, 3]]),
        bsdf=mi.load_dict({"type": "twosided", "both": {"type": "diffuse", "reflectance": 0.2}}),
    )
    place = mi.ScalarTransform4f
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "direct_edge", "shadows": True},
        "sensor": camera("orthographic", film={"width": width, "height": height})
        | {"to_world": place().look_at([0, 0, -3], [0, 0, 0], [0, 1, 0]) @ place().scale([seen / 2, seen / 2, 1])},
        "plate": plate,
        "wall": {
            "type": "cube", "to_world": place().translate([0, 0, 2]).scale([4, 4, 1]),
            "bsdf": {"type": "diffuse", "reflectance": 0.8},
        },
        "sun": {"type": "directional", "direction": [sign * 0.004 * seen / width, 0, 1], "irradiance": 2.0},
    }, optimize=False)  # fmt: skip
    params = mi.traverse(scene)
    shift = mi.Float(0)
    dr.enable_grad(shift)
    start = mi.Point3f(dr.unravel(mi.Point3f, params["plate.vertex_positions"]))
    params["plate.vertex_positions"] = dr.ravel(start + mi.Vector3f(shift, 0, 0))
    params.update()
    image = mi.render(scene, params, spp=1024, seed=1)
    value = image.numpy()[height // 2, :, 0]
    shown = slice(0, width // 2) if sign > 0 else slice(width // 2, width)  # the camera's x axis points left
    dr.backward(dr.sum(image[:, shown, 0], axis=None))
    expected = sign * (value[width // 2] - value[0]) * 0.8 * (width / seen) ** 2
    assert dr.grad(shift)[0] == pytest.approx(expected, rel=0.002)
