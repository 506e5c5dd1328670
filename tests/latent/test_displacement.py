"""Displaced base meshes: subdivision, one surface in NumPy and Dr.Jit, its derivatives, the first guess, files."""

import json
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdShade
from support.models import displaced_sphere as model
from support.tiny_meshes import charted_sphere
from support.toy import bumpy_sphere

from mi_simplify import cli
from mi_simplify.fitting.tessellations import tessellating
from mi_simplify.formats.load import load_asset
from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.judging.screen import Screen
from mi_simplify.latent.displacement import Displaced
from mi_simplify.latent.latent import Latent
from mi_simplify.machine.upload import upload
from mi_simplify.model.model import Displacement, tessellated
from mi_simplify.model.tessellation import Tessellation
from mi_simplify.scenes.views import goniometer, look_at


def test_every_face_becomes_four_and_no_crack_opens():
    start = model().mesh
    for n in (1, 2, 3):
        fine = Tessellation.of(start, n).mesh
        assert len(fine.faces) == len(start.faces) * 4**n
        ends = np.sort(np.stack([fine.position_faces, np.roll(fine.position_faces, -1, 1)], 2).reshape(-1, 2), 1)
        assert set(np.unique(ends, axis=0, return_counts=True)[1]) == {2}  # closed as the base is
        edges = len(ends) // 2
        assert len(fine.positions) - edges + len(fine.faces) == 2  # Euler: a sphere
        # Nothing moves: the fine mesh lies on the faces of the base, and their texture stays.
        area = lambda p, f: np.linalg.norm(np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]]), axis=1).sum()  # noqa: E731
        assert area(fine.positions, fine.position_faces) == pytest.approx(area(start.positions, start.position_faces))
        flat = lambda m: np.pad(m.uvs.astype(float), ((0, 0), (0, 1)))  # noqa: E731
        assert area(flat(fine), fine.faces) == pytest.approx(area(flat(start), start.faces), rel=1e-4)


def test_a_constant_map_grows_a_sphere():
    ball = replace(model(8, subdivisions=2), mesh=charted_sphere(8))
    ball = replace(ball, displacement=Displacement(np.full((32, 32), 0.25, np.float32), 2))
    radius = np.linalg.norm(tessellated(ball).mesh.positions, axis=1)
    assert radius.max() == pytest.approx(1.25, abs=0.01) and radius.min() > 1.2


def test_the_device_makes_the_same_surface():
    start = model()
    operation = Displaced(start)
    base = upload(mi.Float, operation.base.positions.ravel())
    height = upload(mi.Float, operation.parameters["displacement"])
    got = operation.positions(base, {"displacement": height}, None).numpy().reshape(-1, 3)
    assert np.allclose(got, tessellated(start).mesh.positions, atol=2e-6)
    assert np.allclose(got, operation.mesh.positions, atol=2e-6)
    again = operation.written(start, {"displacement": height.numpy()})
    assert np.array_equal(again.displacement.height, start.displacement.height)


def test_derivatives_by_base_and_map_against_differences():
    start = model()
    operation, rng = Displaced(start), np.random.default_rng(1)
    base, height = operation.base.positions.ravel(), operation.parameters["displacement"]
    weight = rng.normal(size=3 * len(operation.mesh.positions))
    b, h = upload(mi.Float, base), upload(mi.Float, height)
    dr.enable_grad(b, h)
    dr.backward(dr.sum(operation.positions(b, {"displacement": h}, None) * upload(mi.Float, weight)))
    tessellation = Tessellation.of(start.mesh, 2)

    def value(x, y):
        return np.sum(tessellation.positions(x.reshape(-1, 3), y.reshape(32, 32)).ravel() * weight)

    for grad, direction, along in (
        (dr.grad(b).numpy(), rng.normal(size=base.size), lambda d: (base + d, height)),
        (dr.grad(h).numpy(), rng.normal(size=height.size), lambda d: (base, height + d)),
    ):
        difference = (value(*along(1e-4 * direction)) - value(*along(-1e-4 * direction))) / 2e-4
        assert np.sum(grad * direction) == pytest.approx(difference, rel=2e-3)


@pytest.mark.parametrize("fitted", [(), (0, 1)])
def test_derivatives_of_an_image_against_differences(fitted):
    """
    Of an image, so that shading and outline of the displaced surface move, too; by base vertices and by the map.

    Fitted for a coarser one as well, it is shaded with that one's normals.
    """
    start = model(4, subdivisions=1, amplitude=0.03)
    assert start.displacement is not None
    latent = Latent(replace(start, displacement=replace(start.displacement, fitted=fitted)))
    operation, renderer = latent.operation, DeferredRenderer(latent.topology)
    views = look_at([[0.4, 0.8, -3.1]], [0.02, 0, 0.01], [[2, 1.5, -2.5]], width=48, height=48, irradiance=2.0)
    weight = np.repeat(1.5 + np.sin(np.arange(48 * 48) / 500)[:, None], 4, axis=1)
    smooth = np.float32(np.sin(np.indices((32, 32))[0] / 32 * 2 * np.pi) + 1.2).ravel()
    leaves = {"base": operation.base.positions.ravel(), "displacement": operation.parameters["displacement"]}

    def image(spp, seed, moved=None, step=0.0):
        values = {k: upload(mi.Float, v + step * directions[k] * (k == moved)) for k, v in leaves.items()}
        positions = operation.positions(values["base"], {"displacement": values["displacement"]}, views)
        renderer.move(positions)
        with dr.suspend_grad():
            surface = latent.evaluate(positions, values["base"], {"displacement": values["displacement"]}, views)
            frame = renderer.render(surface, latent.textures, views, spp=spp, seed=mi.UInt32(seed))
        return np.sum(frame.image.numpy().T * weight)

    def gradient(seed):
        values = {k: upload(mi.Float, v) for k, v in leaves.items()}
        dr.enable_grad(*values.values())
        made = operation.positions(values["base"], {"displacement": values["displacement"]}, views)
        leaf = mi.Float(dr.detach(made))
        dr.enable_grad(leaf)
        renderer.move(dr.detach(leaf))
        surface = latent.evaluate(leaf, values["base"], {"displacement": values["displacement"]}, views)
        frame = renderer.render(surface, latent.textures, views, spp=32, seed=mi.UInt32(seed))
        grad = upload(mi.Vector4f, weight)
        renderer.backward(frame, grad, surface, latent.textures, leaf, mi.UInt32(seed + 1000))
        dr.set_grad(made, dr.grad(leaf))
        dr.enqueue(dr.ADMode.Backward, made)
        dr.traverse(dr.ADMode.Backward)
        return {k: np.sum(dr.grad(v).numpy() * directions[k]) for k, v in values.items()}

    directions = {"base": leaves["base"], "displacement": smooth}
    ours = [gradient(k) for k in range(12)]
    for name, eps in (("base", 4e-3), ("displacement", 4e-3)):
        both = [(image(256, k, name, eps) - image(256, k, name, -eps)) / (2 * eps) for k in range(12)]
        mean = np.mean([g[name] for g in ours])
        noise = np.hypot(np.std([g[name] for g in ours]) / 12**0.5, np.std(both) / 12**0.5)
        assert noise < 0.01 * abs(np.mean(both))
        assert abs(mean - np.mean(both)) < max(0.01 * abs(np.mean(both)), 3 * noise), name


def test_a_coarser_tessellation_on_the_finest_topology_is_the_same_surface():
    """Of one model in several tessellations: images of each are those of the mesh that is split only so often."""
    start = model(2, subdivisions=3)
    assert start.displacement is not None
    start = replace(start, displacement=replace(start.displacement, fitted=(1, 2, 3)))
    latent = Latent(start)
    renderer = DeferredRenderer(latent.topology)
    views = look_at([[0.4, 0.8, -3.1]], [0.02, 0, 0.01], [[2, 1.5, -2.5]], width=48, height=48, irradiance=2.0)
    base = upload(mi.Float, latent.operation.base.positions.ravel())
    height = {"displacement": upload(mi.Float, latent.operation.parameters["displacement"])}
    images = []
    for level in (1, 2, 3):
        shown = replace(views, subdivisions=mi.Float(level))
        positions = latent.operation.positions(base, height, shown)
        renderer.move(positions)
        surface = latent.evaluate(positions, base, height, shown)
        frame = renderer.render(surface, latent.textures, views, spp=4, seed=dr.opaque(mi.UInt32, 1))
        alone = Screen(tessellated(start, level), mips="none").images(views, spp=4)
        images.append(frame.images())
        assert np.mean(np.abs(images[-1] - alone) > 1e-3) < 0.005
    assert np.abs(images[0] - images[2]).mean() > 1e-3


def test_all_tessellations_of_one_model_share_the_normals_of_the_coarsest():
    start = model(4, subdivisions=3)
    assert start.displacement is not None
    several = replace(start, displacement=replace(start.displacement, fitted=(1, 2, 3)))
    coarse, middle, fine = (tessellated(several, level).mesh for level in (1, 2, 3))
    np.testing.assert_allclose(coarse.normals(), tessellated(start, 1).mesh.normals())
    np.testing.assert_allclose(fine.normals()[: len(middle.positions)], middle.normals(), atol=1e-12)
    np.testing.assert_allclose(fine.normals()[: len(coarse.positions)], coarse.normals(), atol=1e-12)
    _, once, ends = Tessellation.of(start.mesh, 3).position_edges
    linear = np.concatenate([coarse.normals(), coarse.normals()[once].mean(1)])
    between = linear[ends].mean(1)
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    np.testing.assert_allclose(fine.normals()[len(middle.positions) :], between, atol=1e-12)  # of length 1 in the end
    own = tessellated(start, 3).mesh.normals()
    assert np.degrees(np.arccos(np.sum(own * fine.normals(), axis=1).clip(-1, 1))).max() > 1


def test_views_that_name_no_tessellation_show_the_finest():
    start = model(2, subdivisions=2)
    assert start.displacement is not None
    several = replace(start, displacement=replace(start.displacement, fitted=(0, 2)))
    views = look_at([[0.4, 0.8, -3.1]], [0.02, 0, 0.01], [[2, 1.5, -2.5]], width=32, height=32, irradiance=np.pi)
    finest, coarsest, shown = (
        Screen(m, mips="none").images(views, spp=4) for m in (tessellated(several), tessellated(several, 0), several)
    )
    np.testing.assert_allclose(shown, finest, atol=5e-5)  # normals interpolated in single and in double precision
    assert np.abs(shown - coarsest).mean() > 1e-3


def test_a_fit_for_several_tessellations_draws_views_of_each():
    displacement = Displacement(np.zeros((4, 4), np.float32), 3, (1, 3))
    draw = tessellating(
        lambda n, rng, size: [goniometer(n, rng, width=size, height=size, irradiance=np.pi)], displacement, 2
    )
    parts = draw(8, np.random.default_rng(0), 16)
    assert sorted((int(v.subdivisions.numpy()[0]), len(v)) for v in parts) == [(1, 4), (3, 4)]
    assert all(np.ptp(v.subdivisions.numpy()) == 0 for v in parts)


def test_a_displaced_model_from_the_command_line(tmp_path):
    """A base of 60 triangles, displaced, is nearer to the asset than the base; its files hold the same surface."""
    asset = bumpy_sphere(tmp_path, 24)
    settings = [
        "initial.subdivisions=2", "initial.tessellations=[1,2]", "initial.atlas_size=128", "optimizer.steps=4",
        "optimizer.batch=2",
        "optimizer.resolution=48", "evaluation.views=2", "evaluation.resolution=48", "evaluation.spp=8",
        "reference.spp=2", "reference.pool=4", "export.formats=glb",
    ]  # fmt: skip
    out = tmp_path / "out"
    command = ["simplify", str(asset), "-n", "60", "-o", str(out), "--quiet"]
    assert cli.main([*command, *(x for s in settings for x in ("--set", s))]) == 0
    fine, base = load_asset(out / "model.glb"), load_asset(out / "displacement" / "base.glb")
    assert fine.n_triangles == 16 * base.n_triangles and base.n_triangles <= 60
    points = fine.parts[0].vertices
    radius = np.linalg.norm(points, axis=1)
    wanted = 1 + 0.05 * np.sin(6 * points / radius[:, None]).sum(1)
    middle = base.parts[0].vertices[base.parts[0].faces].mean(1)
    assert np.abs(radius - wanted).mean() < 0.02 < np.abs(np.linalg.norm(middle, axis=1) - 1).mean()
    facts = json.loads((out / "displacement" / "displacement.json").read_text())
    levels = np.asarray(Image.open(out / "displacement" / "height.png")).astype(float)
    exact = np.array(mi.Bitmap(str(out / "displacement" / "height.exr"))).reshape(levels.shape)
    assert levels.max() == 65535 and facts["subdivisions"] == 2
    label = f"displacement, {facts['low']:.3g} (black) to {facts['high']:.3g} (white)"
    assert f"<figcaption>{label}, {len(levels)} × {len(levels)}</figcaption>" in (out / "report.html").read_text()
    assert np.allclose(facts["low"] + levels / 65535 * (facts["high"] - facts["low"]), exact, atol=1e-4)
    stage = Usd.Stage.Open(str(out / "displacement" / "base.usdc"))
    surface = UsdShade.Shader(next(p for p in stage.Traverse() if p.GetName() == "surface"))
    (source,), _ = surface.GetInput("displacement").GetConnectedSources()
    texture = UsdShade.Shader(source.source.GetPrim())
    assert texture.GetInput("bias").Get()[0] == pytest.approx(facts["low"])
    assert texture.GetInput("scale").Get()[0] == pytest.approx(facts["high"] - facts["low"])
