"""Images with cameras: reading them, the camera's convention there and back, hulls, and whole runs."""

import json
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import AssetError, ConfigError, UserError
from mi_simplify.formats.captured.read import read_captured
from mi_simplify.formats.captured.write import write_captured
from mi_simplify.initial.sphere import sphere
from mi_simplify.initial.visual_hull import visual_hull
from mi_simplify.judging.metrics import psnr
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.model.light.harmonics import constant_environment, environment_image
from mi_simplify.scenes.references.images import ImageReference, squared
from mi_simplify.scenes.references.mitsuba import MitsubaReference
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.views import Views, goniometer
from mi_simplify.subjects import open_subject

GREY = np.full(3, 0.5)


def lopsided() -> Asset:
    """An ellipsoid off the origin with three colours: no flip or swap of axes leaves it as it is."""
    positions, faces = sphere(2000)
    colors = np.concatenate([np.float32(positions > 0.2) * 0.7 + 0.1, np.ones((len(positions), 1))], axis=1)
    part = Part(
        positions * [0.9, 0.5, 0.3] + [0.2, 0.1, -0.1], faces, positions.astype(np.float32), None,
        colors.astype(np.float32), Material(base_color=np.ones((1, 1, 4), np.float32)),
    )  # fmt: skip
    return Asset((part,), (Instance(0),))


def captured_folder(folder: Path, n: int = 12, size: int = 48, format: str = "exr", light: str = "point") -> Path:
    views = goniometer(n, np.random.default_rng(7), width=size, height=size, distance=3.5, irradiance=np.pi)
    images = make_reference(lopsided(), transport="direct", spp=16).render(views)
    return write_captured(folder, views.arrays(), images, format=format, light=light)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return captured_folder(tmp_path_factory.mktemp("captured"))


# --- cameras and images -------------------------------------------------------------------------------------------


def test_cameras_and_lights_come_back_as_they_went(folder):
    """Views, written as a NeRF's matrices and read again, show the asset as the images do."""
    captured = read_captured(folder)
    scale, center = 2.0, np.array([0.3, -0.2, 0.1])
    reference = ImageReference(captured, scale, center, range(10), range(10, 12))
    (views,) = reference.draw(10, np.random.default_rng(0), 48)
    images = reference.render(views)
    arrays = views.arrays()
    undone = {name: arrays[name] / scale + center for name in ("origin", "light_position")}
    undone["light_intensity"] = arrays["light_intensity"] / scale**2
    again = make_reference(lopsided(), transport="direct", spp=16).render(Views.from_arrays(arrays | undone, 48, 48))
    assert np.abs(images - again).mean() < 4e-3
    mirrored = images[:, :, ::-1]
    assert np.abs(mirrored - again).mean() > 0.03


def test_up_z_is_turned_to_up_y(folder, tmp_path):
    """Blender's world, +Z up: x stays, z becomes y."""
    document = json.loads(folder.read_text())
    matrix = np.array(document["frames"][0]["transform_matrix"])
    turned = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]) @ matrix  # y up to z up
    frame = document["frames"][0] | {"transform_matrix": turned.tolist(), "light": None}
    frame["file_path"] = str(folder.parent / "images/0000")
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [frame]}))
    captured = read_captured(tmp_path / "transforms.json")
    np.testing.assert_allclose(captured.to_world[0], matrix, atol=1e-6)
    assert captured.light == "environment"


def test_png_and_exr_hold_the_same_radiance(folder, tmp_path):
    png = read_captured(captured_folder(tmp_path, format="png"))
    exr = read_captured(folder)
    difference = np.abs(np.float32(png.images) - np.clip(np.float32(exr.images), 0, 1))
    assert difference.mean() < 2e-3


def test_a_mask_stands_in_for_alpha(folder, tmp_path):
    captured = read_captured(captured_folder(tmp_path, n=3, format="png"))
    path = tmp_path / "transforms.json"
    document = json.loads(path.read_text())
    for k, frame in enumerate(document["frames"]):
        image = np.asarray(Image.open(tmp_path / f"images/{k:04d}.png"))
        Image.fromarray(image[..., :3]).save(tmp_path / f"images/{k:04d}.png")
        Image.fromarray(image[..., 3]).save(tmp_path / f"images/mask{k}.png")
        frame["mask_path"] = f"images/mask{k}.png"
    path.write_text(json.dumps(document))
    np.testing.assert_array_equal(np.float32(read_captured(path).images), np.float32(captured.images))


def test_a_film_of_the_images_own_pixels_keeps_them():
    image = np.random.default_rng(0).random((6, 8, 4)).astype(np.float32)
    focal, center = np.array([10.0, 10.0]), np.array([4.0, 3.0])
    out = squared(image, focal, center, 0.4, 8)
    np.testing.assert_allclose(out[1:7], image, atol=1e-6)
    assert np.isnan(out[[0, 7]]).all()
    half = squared(image, focal, center, 0.4, 4)
    np.testing.assert_allclose(half[1, 1], image[1:3, 2:4].mean((0, 1)), atol=1e-6)


def test_a_principal_point_off_the_centre_is_kept_on_the_axis():
    """The point that the optical axis meets lies in the middle of the film, wherever it was on the image."""
    image = np.zeros((40, 60, 1), np.float32)
    image[9:11, 41:43] = 1
    out = squared(image, np.array([50.0, 50.0]), np.array([42.0, 10.0]), 0.84, 42)
    assert np.nanargmax(out[..., 0]) // 42 in (20, 21) and np.nanargmax(out[..., 0]) % 42 in (20, 21)


def test_images_show_their_own_views_only(folder):
    reference = ImageReference(read_captured(folder), 1.0, np.zeros(3), range(12), range(1))
    views = goniometer(1, np.random.default_rng(0), width=16, height=16, irradiance=np.pi)
    with pytest.raises(UserError, match="their own views only"):
        reference.render(views)


# --- what is wrong with them --------------------------------------------------------------------------------------


def changed(folder: Path, tmp_path: Path, change) -> Path:
    """The document, its images named absolutely, with something changed in it."""
    document = json.loads(folder.read_text())
    for frame in document["frames"]:
        frame["file_path"] = str(folder.parent / frame["file_path"])
    change(document, tmp_path)
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(document))
    return path


def picture(tmp_path: Path, pixels: np.ndarray) -> str:
    Image.fromarray(pixels).save(tmp_path / "new.png")
    return str(tmp_path / "new.png")


BROKEN = {
    "has no 'frames'": lambda d, t: d.update(frames=[]),
    "'none.png' does not exist": lambda d, t: d["frames"][1].update(file_path="none.png"),
    "a frame has no 'file_path'": lambda d, t: d["frames"][1].pop("file_path"),
    "has 48 × 48 pixels, but 'w' is 64": lambda d, t: d.update(w=64),
    "should be 4 × 4 numbers": lambda d, t: d["frames"][0].update(transform_matrix=[[1, 2], [3, 4]]),
    "mirrored or skewed": lambda d, t: d["frames"][0].update(transform_matrix=np.diag([-1.0, 1, 1, 1]).tolist()),
    "needs 'camera_angle_x'": lambda d, t: d["frames"][0].pop("fl_x"),
    "is distorted \\(k1\\)": lambda d, t: d.update(k1=0.1),
    "'color_space' should be linear or srgb": lambda d, t: d.update(color_space="aces"),
    "has no 'light', others have": lambda d, t: d["frames"][2].pop("light"),
    "'light' of '0000.exr' should be": lambda d, t: d["frames"][0].update(light={"position": [1, 2]}),
    "nothing tells the object": lambda d, t: d["frames"][0].update(
        file_path=picture(t, np.zeros((48, 48, 3), np.uint8))
    ),
    "the mask of '0000.exr' has 8 × 9 but 48 × 48": lambda d, t: d["frames"][0].update(
        mask_path=picture(t, np.zeros((9, 8), np.uint8))
    ),
    "all images are transparent": lambda d, t: [
        f.update(mask_path=picture(t, np.zeros((48, 48), np.uint8))) for f in d["frames"]
    ],
    "all images are black": lambda d, t: [
        f.update(file_path=picture(t, np.full((48, 48, 4), [0, 0, 0, 255], np.uint8))) for f in d["frames"]
    ],
}  # fmt: skip


@pytest.mark.parametrize("message", BROKEN)
def test_what_does_not_fit_together_is_one_clear_line(folder, tmp_path, message):
    with pytest.raises(AssetError, match=message) as caught:
        read_captured(changed(folder, tmp_path, BROKEN[message]))
    assert "\n" not in str(caught.value)


def test_no_json_is_one_clear_line(tmp_path):
    (tmp_path / "transforms.json").write_text("{frames")
    with pytest.raises(AssetError, match="no JSON file"):
        read_captured(tmp_path / "transforms.json")


def test_cameras_that_do_not_fit_the_images_are_told(folder, tmp_path):
    """Matrices of the inverse convention, and a camera inside the object."""

    def invert(document, _):
        for frame in document["frames"]:
            frame["transform_matrix"] = np.linalg.inv(frame["transform_matrix"]).tolist()

    with pytest.raises(AssetError, match="nothing is covered in all images; their cameras do not fit"):
        visual_hull(read_captured(changed(folder, tmp_path, invert)), 16, GREY)

    def inside(document, _):
        extra = json.loads(json.dumps(document["frames"][0]))
        matrix = np.array(extra["transform_matrix"])
        matrix[:3, 3] = [0.2, 0.1, -0.1]
        white = np.full((48, 48, 4), 255, np.uint8)
        document["frames"].append(extra | {"file_path": picture(tmp_path, white), "transform_matrix": matrix.tolist()})

    with pytest.raises(AssetError, match="the camera of 'new.png' is inside the object"):
        visual_hull(read_captured(changed(folder, tmp_path, inside)), 32, GREY)


def test_too_few_images_and_lights_that_are_not_there_are_told(folder, tmp_path):
    few = changed(folder, tmp_path, lambda d, t: d.update(frames=d["frames"][:2]))
    with pytest.raises(AssetError, match="2 images are too few"):
        open_subject(load_config(overrides=[f"asset={few}"]))
    dark = changed(folder, tmp_path, lambda d, t: [f.pop("light") for f in d["frames"]])
    with pytest.raises(ConfigError, match="no frame of .* has a 'light'"):
        open_subject(load_config(overrides=[f"asset={dark}", "images.light=point"]))
    with pytest.raises(ConfigError, match="images are not path traced"):
        open_subject(load_config(overrides=[f"asset={folder}", "reference.transport=matched"]))


# --- hulls and fits -----------------------------------------------------------------------------------------------


def test_a_hull_holds_the_object_and_not_much_more(folder):
    hull = visual_hull(read_captured(folder), 64, GREY)
    true = lopsided().bounds
    assert (hull.bounds[0] < true[0] + 0.04).all() and (hull.bounds[1] > true[1] - 0.04).all()
    assert (hull.bounds[1] - hull.bounds[0] < (true[1] - true[0]) * 1.25 + 0.05).all()
    p = hull.parts[0].vertices[hull.parts[0].faces]
    volume = np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6
    assert 0.5 < volume / (4 / 3 * np.pi * 0.9 * 0.5 * 0.3) < 1.6  # outwards, and not hollow


SHORT = [
    "optimizer.steps=60", "optimizer.batch=4", "optimizer.resolution=48", "initial.atlas_size=128", "images.every=6",
    "initial.triangles=400", "evaluation.views=2", "evaluation.resolution=48", "evaluation.spp=16",
    "export.formats=glb", "reference.pool=16", "images.resolution=32",
]  # fmt: skip


@pytest.mark.parametrize("light", ["point", "unlit", "environment"])
def test_images_alone_are_fitted_from_the_command_line(light, tmp_path, capsys):
    """For every kind of light; what is judged are images that no step has seen."""
    path = captured_folder(tmp_path / "set", n=24, light="point")
    arguments = [x for setting in [*SHORT, f"images.light={light}"] for x in ("--set", setting)]
    done = cli.main(["simplify", str(path), "-o", str(tmp_path / "out"), "-q", *arguments])
    assert done == 0, capsys.readouterr().err
    figures = json.loads((tmp_path / "out/metrics.json").read_text())
    before, after = (figures["candidates"][name]["psnr"] for name in ("first guess", "result"))
    assert after > before + (3 if light == "point" else 0.5)
    assert figures["settings"]["light"] == light and figures["settings"]["held_out"] == 4
    assert (tmp_path / "out/environment.exr").exists() == (light == "environment")
    capsys.readouterr()
    out = ["--views", "2", "--resolution", "48", "--spp", "16", "-o", str(tmp_path / "judged"), "-q"]
    assert cli.main(["evaluate", str(tmp_path / "out/config.yaml"), str(tmp_path / "out/model.glb"), *out]) == 0
    again = next(iter(json.loads((tmp_path / "judged/metrics.json").read_text())["candidates"].values()))
    assert again["psnr"] == pytest.approx(after, abs=0.7)


def test_an_environment_is_an_image_as_mitsuba_holds_it():
    """Radiance in some directions, looked up by Mitsuba's own envmap."""
    from mi_simplify.model.light.harmonics import harmonics

    coefficients = constant_environment((1, 1, 1)) + np.random.default_rng(0).normal(size=(16, 3)) * 0.1
    image = environment_image(coefficients, 128)
    envmap = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(image)})
    d = np.random.default_rng(1).normal(size=(50, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*(-d.T.astype(np.float32)))
    expected = np.stack(harmonics(3, *d.T), 1) @ coefficients
    np.testing.assert_allclose(envmap.eval(si).numpy().T, expected, atol=0.02)
    same = environment_image(constant_environment((0.2, 0.4, 0.6)))
    np.testing.assert_allclose(same[3, 5], [0.2, 0.4, 0.6], rtol=1e-5)


def test_a_diffuse_ball_in_an_environment_is_lit_as_by_mitsuba():
    """The latent renderer's harmonics against path tracing under the image of them; rough, convex, no shadows."""
    from dataclasses import replace

    from support.models import rendered, textured_sphere

    from mi_simplify.machine.upload import upload

    model = textured_sphere()
    specular = np.broadcast_to(np.float32([0, 0.7, 0]), model.specular.shape).copy()
    flat = np.broadcast_to(np.float32([0, 0, 1]), model.normal.shape).copy()
    model = replace(model, specular=specular, normal=flat)
    coefficients = constant_environment((0.8, 0.9, 1)) + np.random.default_rng(0).normal(size=(16, 3)) * 0.15
    views = goniometer(2, np.random.default_rng(1), width=32, height=32, irradiance=np.pi).lit_by(0.0)
    lit = rendered(model, views.under(upload(mi.Float, coefficients.ravel()))).images()
    reference = make_reference(model.as_asset(), transport="baked", spp=256, max_depth=2)
    assert isinstance(reference, MitsubaReference)
    reference.shapes["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(environment_image(coefficients))}
    traced = reference.render(views)
    covered = (lit[..., 3] == 1) & (traced[..., 3] == 1)
    assert np.abs(lit - traced)[covered].mean() < 0.02
    assert psnr(lit, traced).mean() > 30
