"""Cameras and lights: their statistics, their axes, and the same rays as Mitsuba's own sensor."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from mi_simplify.errors import UserError
from mi_simplify.integrators.camera import Cameras, film_samples
from mi_simplify.scenes.references.mitsuba import view_sensor
from mi_simplify.scenes.views import Views, goniometer, held_out_views, look_at

N = 4000


def draw(n=N, seed=0, **kwargs):
    return goniometer(n, np.random.default_rng(seed), width=64, height=64, **kwargs).arrays()


def unit(x):
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def assert_orthonormal(a):
    axes = np.stack([a["right"], a["up"], a["forward"]], 1).astype(np.float64)
    assert np.allclose(axes @ axes.transpose(0, 2, 1), np.eye(3), atol=1e-6)
    assert np.allclose(np.cross(a["forward"], a["up"]), a["right"], atol=1e-6)


# --- the virtual photo-goniometer ------------------------------------------------------------------------------------


def test_goniometer_cameras_are_uniform_over_the_sphere():
    center = np.array([1.0, -2.0, 0.5])
    a = draw(center=center, distance=5.0)
    offset = a["origin"] - center
    assert np.allclose(np.linalg.norm(offset, axis=1), 5, rtol=1e-5)
    for axis in range(3):  # Archimedes: every coordinate of a uniform direction is uniform
        assert stats.kstest(offset[:, axis] / 5, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert_orthonormal(a)


def test_goniometer_rolls_and_aims_at_random():
    center, jitter = np.array([1.0, -2.0, 0.5]), 0.4
    a = draw(center=center, jitter=jitter)
    # Roll: the angle of the image's up direction around the view axis, against any fixed frame, is uniform.
    side = unit(np.cross(a["forward"], [0.3, 0.8, 0.5]))
    roll = np.arctan2(np.sum(a["up"] * side, 1), np.sum(a["up"] * np.cross(a["forward"], side), 1))
    assert stats.kstest(roll, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
    # Aim: the view axis meets the box of the targets, and no smaller one. What is left of a uniform offset across
    # the axis has two thirds of its variance, jitter²/3, the same in every direction.
    miss = center - a["origin"]
    miss -= a["forward"] * np.sum(miss * a["forward"], 1, keepdims=True)
    assert 0.9 * jitter < np.linalg.norm(miss, axis=1).max() < jitter * 3**0.5
    assert np.allclose(np.cov(miss.T) / (jitter**2 * 2 / 9), np.eye(3), atol=0.1)
    assert np.linalg.norm(draw(jitter=0.0)["forward"] + unit(draw(jitter=0.0)["origin"]), axis=1).max() < 1e-6
    assert np.allclose(
        goniometer(3, np.random.default_rng(0), width=8, height=8, fov=60, irradiance=np.pi).fov, 60, atol=1e-4
    )


@pytest.mark.parametrize("exponent", [0.0, 1.0, 8.0])
def test_goniometer_light_stands_in_a_cosine_lobe_around_the_camera(exponent):
    center = np.array([1.0, -2.0, 0.5])
    a = draw(center=center, distance=2.0, light_exponent=exponent, irradiance=3.0)
    light, camera = a["light_position"] - center, unit(a["origin"] - center)
    assert np.allclose(np.linalg.norm(light, axis=1), 2, rtol=1e-5)
    cos = np.sum(unit(light) * camera, 1)
    assert stats.kstest(np.clip(cos, 0, 1) ** (exponent + 1), stats.uniform.cdf).pvalue > 1e-3  # density ~ cos^exponent
    side = unit(np.cross(camera, [0.3, 0.8, 0.5]))
    azimuth = np.arctan2(np.sum(light * side, 1), np.sum(light * np.cross(camera, side), 1))
    assert stats.kstest(azimuth, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
    # What arrives at the target is what was asked for.
    target = a["origin"] + a["forward"] * np.sum((center - a["origin"]) * a["forward"], 1, keepdims=True)
    arriving = a["light_intensity"][:, 0] / np.sum((a["light_position"] - target) ** 2, 1)
    assert np.median(np.abs(arriving - 3)) < 0.5
    still = draw(100, center=center, distance=2.0, jitter=0.0, irradiance=3.0)
    assert np.allclose(still["light_intensity"], 3.0 * 4, rtol=1e-4)


def test_goniometer_repeats_itself_and_refuses_nothing_to_draw():
    a, b, c = draw(8, seed=1), draw(8, seed=1), draw(8, seed=2)
    assert all(np.array_equal(a[k], b[k]) for k in a) and not np.allclose(a["origin"], c["origin"])
    with pytest.raises(UserError, match="at least one view, got 0"):
        draw(0)


def test_held_out_views_are_spread_and_drawn_by_no_fit():
    bounds = np.array([[-1.0, -1, -1], [1, 1, 1]])
    views = held_out_views(bounds, n=16, resolution=48)
    a = views.arrays()
    assert (views.width, views.height, len(views)) == (48, 48, 16)
    assert_orthonormal(a)
    d = unit(a["origin"])
    nearest = (d @ d.T - 2 * np.eye(16)).max(1)
    assert np.degrees(np.arccos(nearest)).min() > 20  # spread over the sphere,
    assert (d > 0.3).any(0).all() and (d < -0.3).any(0).all()  # on every side,
    fitted = draw()
    gap = np.linalg.norm(a["origin"][:, None] - fitted["origin"][None], axis=2)
    assert gap.min() > 0.5  # from where no camera of a fit stands (by default)
    angle = np.degrees(np.arccos(np.sum(unit(a["light_position"]) * d, 1)))
    assert np.all((angle[::2] > 29) & (angle[::2] < 76)) and np.all((angle[1::2] > 4) & (angle[1::2] < 31))
    again, other = held_out_views(bounds, n=16).arrays(), held_out_views(bounds, n=16, seed=1).arrays()
    assert np.array_equal(a["origin"], again["origin"]) and not np.allclose(a["origin"], other["origin"])


def test_held_out_views_scale_with_what_they_look_at():
    bounds = np.array([[-1.0, -2, -3], [4, 5, 6]])
    a, b = held_out_views(bounds).arrays(), held_out_views(bounds * 100).arrays()
    assert np.allclose(a["origin"] * 100, b["origin"], rtol=1e-4)
    # The whole box is on the picture (to a hundredth), in the middle.
    corners = np.stack(np.meshgrid(*bounds.T), -1).reshape(-1, 3)
    film = project(held_out_views(bounds, resolution=100), corners)
    assert film[..., :2].min() > -1 and film[..., :2].max() < 101
    assert np.allclose(project(held_out_views(bounds, resolution=100), [bounds.mean(0)])[..., :2], 50, atol=1e-2)


# --- look_at and the struct ------------------------------------------------------------------------------------------


def test_look_at_known_axes():
    a = look_at([0, 0, 5], [0, 0, 0], [0, 3, 0], width=8, height=4, fov=90, irradiance=2.0).arrays()
    assert np.allclose(a["right"], [1, 0, 0])
    assert np.allclose(a["up"], [0, 1, 0]) and np.allclose(a["forward"], [0, 0, -1])
    assert np.allclose(a["tan_x"], 1) and np.allclose(a["light_intensity"], 18) and np.allclose(a["frame"], 0)


@pytest.mark.parametrize("origin", [[0, 5, 0], [0, -5, 0], [5, 0, 0], [0, 0, 5], [0, 0, -5]])
@pytest.mark.parametrize("up", [[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 0, -2]])
def test_look_at_has_axes_wherever_up_points(origin, up):
    a = look_at(origin, [0, 0, 0], origin, width=8, height=8, up=up, irradiance=np.pi).arrays()
    assert_orthonormal(a)
    if abs(np.dot(origin, up)) < 1e-6:
        assert np.allclose(a["up"][0], unit(np.float64([up])))


def test_look_at_refuses_a_camera_at_its_target():
    with pytest.raises(UserError, match="camera and target are the same point"):
        look_at([[1, 2, 3], [0, 0, 0]], [0, 0, 0], [0, 1, 0], width=8, height=8, irradiance=np.pi)


def test_arrays_and_back():
    views = goniometer(5, np.random.default_rng(3), width=10, height=6, irradiance=np.pi)
    views.frame = mi.Float([0, 1, 2, 3, 4])
    a = views.arrays()
    again = Views.from_arrays(a, 10, 6)
    assert all(np.array_equal(again.arrays()[k], v) for k, v in a.items())
    assert a["origin"].shape == (5, 3) and a["tan_x"].shape == (5,) and len(again) == 5
    taken = views.take(np.array([4, 1])).arrays()
    assert all(np.array_equal(taken[k], v[[4, 1]]) for k, v in a.items())
    joined = Views.concatenate([views.take(np.array([0, 1])), views.take(np.array([2, 3, 4]))])
    assert all(np.array_equal(joined.arrays()[k], v) for k, v in a.items())
    small = views.resized(5, 3)
    assert (small.width, small.height, joined.width, joined.height) == (5, 3, 10, 6)
    assert np.array_equal(small.arrays()["tan_x"], a["tan_x"])


# --- rays ------------------------------------------------------------------------------------------------------------


def project(views, points):
    """Film positions and depth of points seen by every view, shape (B, N, 3)."""
    cameras, n = Cameras.of(views), len(points)
    lane = dr.arange(mi.UInt32, len(views) * n)
    p = np.tile(np.asarray(points, np.float32), (len(views), 1))
    film = cameras.project(lane // n, mi.Point3f(np.ascontiguousarray(p.T)))
    return film.numpy().T.reshape(len(views), n, 3)


@pytest.mark.parametrize(("width", "height"), [(48, 48), (64, 20), (20, 64)])
def test_rays_are_those_of_mitsubas_sensor(width, height):
    views = goniometer(3, np.random.default_rng(4), width=width, height=height, fov=70, irradiance=np.pi)
    cameras, rng = Cameras.of(views), np.random.default_rng(5)
    for k in range(3):
        sensor = mi.load_dict(view_sensor(views.arrays(), k, width, height))
        u = rng.random((2, 200)).astype(np.float32)
        theirs, _ = sensor.sample_ray(mi.Float(0), mi.Float(0), mi.Point2f(u), mi.Point2f(0))
        x, y = mi.Float(u[0] * width), mi.Float(u[1] * height)
        origin, direction = cameras.ray(dr.full(mi.UInt32, k, 200), x, y)
        assert np.abs(direction.numpy() - theirs.d.numpy()).max() < 2e-6
        assert np.allclose(np.linalg.norm(direction.numpy(), axis=0), 1, atol=1e-6)
        along = theirs.o.numpy() - origin.numpy()  # Mitsuba's start at the near plane
        assert np.abs(np.cross(along.T, theirs.d.numpy().T)).max() < 1e-6
        # The way back, from any distance.
        depth = mi.Float(rng.uniform(0.5, 9, 200).astype(np.float32))
        film = cameras.project(dr.full(mi.UInt32, k, 200), origin + direction * depth)
        assert np.abs(film.x.numpy() - x.numpy()).max() < 1e-4 * width
        assert np.abs(film.y.numpy() - y.numpy()).max() < 1e-4 * height
        forward = views.arrays()["forward"][k]
        assert np.allclose(film.z.numpy(), depth.numpy() * (forward @ direction.numpy()), rtol=1e-4)
        behind = cameras.project(dr.full(mi.UInt32, k, 200), origin - direction * depth)
        assert np.all(behind.z.numpy() < 0)


def test_projection_of_known_points():
    """x to the right, y down, in pixels; the film is twice as wide as high."""
    views = look_at([0, 0, 2], [0, 0, 0], [0, 0, 2], width=40, height=20, fov=90, irradiance=np.pi)
    film = project(views, [[0, 0, 0], [2, 0, 0], [0, 1, 0], [-1, -0.5, 0], [0, 0, 3]])[0]
    assert np.allclose(film[:4], [[20, 10, 2], [40, 10, 2], [20, 0, 2], [10, 15, 2]], atol=1e-4)
    assert film[4, 2] < 0


def test_cameras_are_differentiable():
    """A camera that moves right by dx moves a point left by dx·W / (2 z tan); moving back draws it to the middle."""
    views = look_at([0, 0, 2], [0, 0, 0], [0, 0, 2], width=40, height=20, fov=90, irradiance=np.pi)
    dr.enable_grad(views.origin)
    film = Cameras.of(views).project(mi.UInt32(0), mi.Point3f(0.3, 0.2, 0))
    dr.backward(film.x)
    assert np.allclose(dr.grad(views.origin).numpy().ravel(), [-10, 0, -0.3 * 10 / 2], atol=1e-4)


def test_film_samples_lie_evenly_in_their_pixels():
    cameras = Cameras.of(goniometer(2, np.random.default_rng(6), width=6, height=4, irradiance=np.pi))
    pixel, view, x, y = film_samples(cameras, 16, dr.opaque(mi.UInt32, 3))
    pixel, view, x, y = (np.array(c) for c in (pixel, view, x, y))
    assert np.array_equal(pixel, np.repeat(pixel[::16], 16)) and np.array_equal(np.sort(pixel[::16]), np.arange(48))
    assert np.array_equal(view, pixel // 24)
    assert np.array_equal((view * 4 + np.floor(y)) * 6 + np.floor(x), pixel)
    jx, jy = (np.sort((c % 1).reshape(48, 16), axis=1) for c in (x, y))
    assert np.ptp(jx, axis=1).max() < 1 and np.all(np.abs(np.diff(jx) - 1 / 16) < 1e-5)  # a comb, shifted at random
    assert np.diff(jy, axis=1).max() < 3 / 16 and np.std(jx[:, 0]) > 0.01
    same = film_samples(cameras, 16, dr.opaque(mi.UInt32, 3))
    other = film_samples(cameras, 16, dr.opaque(mi.UInt32, 4))
    assert np.array_equal(np.array(same[2]), x) and not np.allclose(np.array(other[2]), x)
    one = film_samples(cameras, 1, dr.opaque(mi.UInt32, 3))
    assert np.array_equal(np.floor(np.array(one[2])), np.array(one[0]) % 6)


def test_sixteen_film_samples_side_by_side_are_one_tile():
    cameras = Cameras.of(goniometer(2, np.random.default_rng(6), width=12, height=8, irradiance=np.pi))
    _, view, x, y = (np.array(c).reshape(-1, 16) for c in film_samples(cameras, 1, dr.opaque(mi.UInt32, 3)))
    for c in (np.floor(x), np.floor(y) + 8 * view):
        assert np.all(np.ptp(c, axis=1) == 3) and np.all(c.min(axis=1) % 4 == 0)


def test_some_film_samples_are_those_of_all():
    cameras = Cameras.of(goniometer(2, np.random.default_rng(6), width=12, height=8, irradiance=np.pi))
    for spp in (1, 3):
        index = mi.UInt32(5, 17, 90, 191)
        every, some = (film_samples(cameras, spp, dr.opaque(mi.UInt32, 3), i) for i in (None, index))
        assert np.array_equal(index, [5, 17, 90, 191])
        assert all(np.array_equal(np.array(a)[np.array(index)], np.array(b)) for a, b in zip(every, some, strict=True))


def test_films_of_any_height_are_covered():
    cameras = Cameras.of(goniometer(2, np.random.default_rng(6), width=5, height=7, irradiance=np.pi))
    assert np.array_equal(np.sort(np.array(film_samples(cameras, 1, dr.opaque(mi.UInt32, 3))[0])), np.arange(70))


def test_film_samples_of_neighbouring_pixels_are_independent():
    cameras = Cameras.of(goniometer(1, np.random.default_rng(6), width=256, height=256, irradiance=np.pi))
    pixel, _, x, y = film_samples(cameras, 1, dr.opaque(mi.UInt32, 3))
    order = np.argsort(np.array(pixel))
    for jitter in (np.array(x)[order] % 1, np.array(y)[order] % 1):
        assert stats.kstest(jitter, stats.uniform.cdf).pvalue > 1e-3
        grid = jitter.reshape(256, 256)
        for a, b in ((grid[:, 1:], grid[:, :-1]), (grid[1:], grid[:-1])):
            assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.02
