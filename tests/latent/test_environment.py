"""An environment map: its filters, what surfaces show of it beside Mitsuba's path tracer, derivatives, files, a fit."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.models import rendered
from support.tiny_meshes import charted_sphere

import mi_simplify as ms
from mi_simplify.errors import ConfigError
from mi_simplify.export.environment import write_environment
from mi_simplify.formats.gltf.write import write_glb
from mi_simplify.latent.ambient import in_packets, light_of
from mi_simplify.latent.environment import MapFilter, looked_up
from mi_simplify.latent.textures import Texels
from mi_simplify.machine.upload import upload
from mi_simplify.model.light.environment_map import (
    as_harmonics,
    as_map,
    environment_map,
    filters,
    n_filtered,
    resized,
    rows_of,
    rows_of_filtered,
)  # fmt: skip
from mi_simplify.model.light.harmonics import constant_environment, environment_coefficients, environment_image
from mi_simplify.model.model import Model
from mi_simplify.scenes.shapes import asset_shapes
from mi_simplify.scenes.views import look_at

ROWS = 16


def sky(seed: int = 0, rows: int = ROWS) -> np.ndarray:
    """A smooth map with a bright spot, shape (2·rows², 3)."""
    rng = np.random.default_rng(seed)
    image = environment_image(np.float32(rng.normal(size=(16, 3)) * 0.3 + constant_environment((1, 0.8, 0.6))), rows)
    image[rows // 4, rows // 2] = 4
    return image.reshape(-1, 3)


def ball(roughness: float, metallic: float) -> Model:
    mesh = charted_sphere(12)
    away = mesh.positions / np.linalg.norm(mesh.positions, axis=1, keepdims=True)
    mesh = replace(mesh, normal_index=mesh.position_index, own_normals=away)
    color, specular, normal = (np.zeros((2, 2, n), np.float32) for n in (4, 3, 3))
    color[:], specular[:], normal[:] = (0.9, 0.7, 0.4, 1), (0, roughness, metallic), (0, 0, 1)
    return Model(mesh, color, specular, normal)


def unit_axes(n: int) -> np.ndarray:
    return np.concatenate([np.eye(3), -np.eye(3)])[:n] + 0.1


def test_filters_keep_a_constant_and_know_the_harmonics():
    matrix = filters(ROWS)
    assert matrix.shape == (n_filtered(ROWS), 2 * ROWS**2) and rows_of_filtered(n_filtered(ROWS)) == ROWS
    np.testing.assert_allclose(matrix[:-16] @ np.ones(2 * ROWS**2), 1, atol=1e-5)
    image = sky()
    np.testing.assert_array_equal((matrix @ image)[: len(image)], image)
    by_projection = environment_coefficients(image.reshape(ROWS, -1, 3))
    np.testing.assert_allclose((matrix @ image)[-16:], by_projection, atol=1e-5)
    on_device = looked_up(image).numpy().reshape(-1, 3)
    np.testing.assert_allclose(on_device, matrix @ image, atol=1e-5)
    g = np.random.default_rng(1).normal(size=on_device.shape).astype(np.float32)
    back = MapFilter(ROWS).gradient(upload(mi.Float, g.ravel())).numpy().reshape(-1, 3)
    np.testing.assert_allclose(back, matrix.T @ g, atol=1e-4)


def test_maps_and_harmonics_are_told_apart_and_turned_into_each_other():
    assert [rows_of(n) for n in (1, 4, 9, 16, 128, 2048, 32768)] == [0, 0, 0, 0, 8, 32, 128]
    smooth = constant_environment((0.5, 0.4, 0.3))
    np.testing.assert_allclose(as_harmonics(as_map(smooth, 32)), smooth, atol=2e-3)
    np.testing.assert_array_equal(as_map(as_map(smooth, 16), 16), as_map(smooth, 16))
    image = environment_map(sky())
    weight = lambda n: -np.diff(np.cos(np.pi * np.arange(n + 1) / n))[:, None]  # noqa: E731
    small = resized(image, 8)
    np.testing.assert_allclose((small.mean(1) * weight(8)).sum(0), (image.mean(1) * weight(16)).sum(0), rtol=1e-5)


@pytest.mark.parametrize(("roughness", "metallic"), [(0.1, 1.0), (0.3, 1.0), (0.6, 1.0), (0.3, 0.0)])
def test_a_ball_looks_as_mitsubas_path_tracer_shows_it(roughness, metallic):
    """Mitsuba's rows begin and end at the poles, so that it gets a finer image."""
    map_, model, side = sky(), ball(roughness, metallic), 24
    views = look_at([0.5, 1, 4], [0, 0, 0], [0, 0, 9], width=side, height=side, fov=30, irradiance=0)
    mine = rendered(model, views.under(looked_up(map_))).images()[0]
    k, fine = np.arange(16 * ROWS), environment_map(map_)
    y, x = k / (len(k) - 1) * ROWS - 0.5, (np.arange(32 * ROWS) + 0.5) / 16 - 0.5
    row, column = np.floor(y).astype(int), np.floor(x).astype(int)
    fy, fx = (y - row)[:, None, None], (x - column)[None, :, None]
    between = fine[np.clip(row, 0, ROWS - 1)] * (1 - fy) + fine[np.clip(row + 1, 0, ROWS - 1)] * fy
    between = between[:, column % (2 * ROWS)] * (1 - fx) + between[:, (column + 1) % (2 * ROWS)] * fx
    eye = views.arrays()
    camera = mi.ScalarTransform4f().look_at(eye["origin"][0].tolist(), [0, 0, 0], [0, 1, 0])
    scene = {
        "type": "scene", **dict(asset_shapes(model.as_asset())),
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(between.astype(np.float32))},
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "sensor": {
            "type": "perspective", "fov": 30, "to_world": camera,
            "film": {
                "type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}, "pixel_format": "rgba"
            },
        },
    }  # fmt: skip
    reference = np.array(mi.render(mi.load_dict(scene), spp=256))
    inside = (reference[..., 3] > 0.999) & (mine[..., 3] > 0.999)
    assert inside.sum() > 200
    difference, mean = (mine - reference)[inside][:, :3], reference[inside][:, :3].mean()
    assert abs(difference.mean()) < 0.015 * mean
    assert np.sqrt(np.square(difference).mean()) < 0.06 * mean


@pytest.mark.parametrize("what", ["map", "roughness", "normal"])
def test_derivatives_are_those_of_finite_differences(what):
    rng, n = np.random.default_rng(2), 5000  # between texels the lookup has kinks, which many of them average out
    unit = lambda x: x / np.linalg.norm(x, axis=1, keepdims=True)  # noqa: E731
    normals = unit(rng.normal(size=(n, 3)))
    to_viewer = unit(normals + 0.7 * unit(rng.normal(size=(n, 3))))
    values = {"map": sky(3), "roughness": rng.uniform(0.2, 0.7, n), "normal": normals}
    along = {"map": rng.random((2 * ROWS**2, 3)), "roughness": np.ones(n), "normal": np.tile([0.3, -1.0, 0.5], (n, 1))}

    # The filters are linear: what is looked up in a sum of maps is the sum of what is looked up in them.
    flat = {
        "map": looked_up,
        "roughness": lambda x: upload(mi.Float, x),
        "normal": lambda x: upload(mi.Float, x.T.ravel()),
    }
    start, ramp = ({k: flat[k](np.float32(v)) for k, v in given.items()} for given in (values, along))

    def total(step: mi.Float) -> mi.Float:
        moved = start | {what: start[what] + ramp[what] * step}
        lane = dr.arange(mi.UInt32, n)
        normal = dr.normalize(mi.Vector3f(*(dr.gather(mi.Float, moved["normal"], lane + k * n) for k in range(3))))
        texels = Texels(
            base_color=mi.Color3f(0.8, 0.5, 0.3), opacity=mi.Float(1), gamma=mi.Float(0),
            roughness=moved["roughness"], metallic=mi.Float(0.6), normal=mi.Vector3f(0, 0, 1),
        )  # fmt: skip
        packets, k = in_packets(moved["map"])
        radiance = light_of(packets, 0, k).radiance(texels, normal, upload(mi.Vector3f, np.float32(to_viewer)))
        return dr.sum(dr.dot(mi.Color3f(0.3, -0.5, 0.8), radiance))

    step, eps = mi.Float(0), 1e-3
    dr.enable_grad(step)
    dr.backward(total(step))
    expected = (float(total(mi.Float(eps))[0]) - float(total(mi.Float(-eps))[0])) / (2 * eps)
    assert float(dr.grad(step)[0]) == pytest.approx(expected, rel=0.02)


def test_files_hold_the_map(tmp_path):
    for name, tolerance in (("sky.exr", 2e-3), ("sky.hdr", 1e-2)):
        path = write_environment(sky(), tmp_path / name)
        np.testing.assert_allclose(
            np.array(mi.Bitmap(str(path)))[..., :3], environment_map(sky()), rtol=tolerance, atol=0.02
        )
    with pytest.raises(ConfigError, match="an EXR or HDR image"):
        write_environment(sky(), tmp_path / "sky.png")


def test_map_and_roughness_are_found_together(tmp_path):
    """A ball of metal, from a grey map and twice the roughness."""
    file = write_glb(ball(0.4, 1), tmp_path / "ball.glb")
    true, light = ball(0.2, 1), looked_up(sky(5))
    views = look_at(unit_axes(6) * 4, [0, 0, 0], [0, 0, 9], width=24, height=24, fov=32, irradiance=0)
    opt = ms.Optimization(
        file, targets=lambda views: rendered(true, views.under(light)).images(), views=views, steps=60, resolution=24,
        batch=6, texture_size=2, overrides=[
            "latent.ambient.rows=16", "latent.ambient.color=[.5,.5,.5]", "evaluation.views=2", "loss.coverage=0",
            "loss.image=l2",
        ],
    )  # fmt: skip
    opt.requires_grad(environment=0.05, roughness=0.01)
    before = opt.run.fit.judge()[0]
    for _ in range(60):
        opt.step()
    model = opt.model()
    assert model.ambient.shape == (2 * ROWS**2, 3) and (model.ambient >= 0).all()
    assert opt.run.fit.judge()[0] < 0.2 * before
    assert abs(model.specular[..., 1].mean() - 0.2) < 0.1
    opt.save(tmp_path / "found.glb")
    np.testing.assert_allclose(
        ms.load_asset(tmp_path / "found.glb").ambient, as_harmonics(model.ambient), rtol=1e-4, atol=1e-4
    )
    written = np.array(mi.Bitmap(str(opt.save_environment(tmp_path / "sky.exr"))))
    np.testing.assert_allclose(written[..., :3], environment_map(model.ambient), rtol=2e-3, atol=1e-3)
    state, texels = opt.run.fit.state(), opt.run.fit.ambient.written()
    opt.run.fit.step(0)
    assert np.abs(opt.run.fit.ambient.written() - texels).max() > 1e-3
    opt.run.fit.restore(state)
    np.testing.assert_array_equal(opt.run.fit.ambient.written(), texels)
