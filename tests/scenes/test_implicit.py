"""Implicit surfaces: what is found out about a function, sphere tracing, isosurfaces, and whole runs."""

import json
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify import cli
from mi_simplify.config import load_config
from mi_simplify.errors import AssetError, ConfigError
from mi_simplify.initial.isosurface import isosurface
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.scenes.implicit import sdf
from mi_simplify.scenes.implicit.surface import Implicit, Surfel, implicit_named
from mi_simplify.scenes.references.path_traced import make_reference
from mi_simplify.scenes.references.reference import FramedReference
from mi_simplify.scenes.references.sphere_tracing import SphereTraced
from mi_simplify.scenes.samples.creature import creature
from mi_simplify.scenes.views import goniometer, held_out_views, look_at
from mi_simplify.subjects import open_subject


def ball(p):
    return sdf.sphere(p, 0.8)


def red(p):
    return Surfel(mi.Color3f(0.8, 0.1, 0.1), 0.4)


def knot(p):
    """A smooth body with a flat face and a thin rod."""
    body = sdf.smooth_union(sdf.sphere(p, 0.5, (0.2, 0, 0)), sdf.box(p, (0.4, 0.2, 0.6)), 0.1)
    return sdf.union(body, sdf.cone(p, (0, 0, 0), (0, 0.9, 0.2), 0.06, 0.03))


# --- what is found out about a function ---------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [0.01, 1.0, 300.0])
def test_bounds_are_found_at_any_size_and_place(scale):
    box = Implicit(lambda p: sdf.box(p, np.array([1, 0.2, 0.1]) * scale, np.array([0.3, 0, 0]) * scale)).box
    assert (box[0] <= np.array([-0.7, -0.2, -0.1]) * scale).all()
    assert (box[1] >= np.array([1.3, 0.2, 0.1]) * scale).all()
    assert (box[1] - box[0]).max() < 2.4 * scale


def test_how_much_a_function_overestimates_is_measured():
    assert Implicit(ball).excess < 1.1
    assert 1.9 < Implicit(lambda p: 2 * ball(p), bounds=[[-1, -1, -1], [1, 1, 1]]).excess < 2.4


@pytest.mark.parametrize(
    ("f", "message"),
    [
        (lambda p: sdf.half_space(p, (0, 1, 0), 0.0), "the surface has no end"),
        (lambda p: dr.norm(p) + 1, "nothing is inside"),
        (lambda p: dr.select(dr.norm(p) < 1, mi.Float(-1), 1), "does not grow|has no end"),
        (lambda p: dr.norm(p) * 0 - 1, "does not grow|has no end|inside"),
        (lambda p: dr.norm(p) * dr.nan, "NaN"),
        (lambda p: 20 * ball(p), "20.* times the distance"),
        (lambda p: p, "expected mi.Float"),
        (lambda p: np.zeros(3), "expected mi.Float"),
        (lambda p: 1 / 0, "failed: ZeroDivisionError"),
        (lambda p, q: p.x, "failed: TypeError"),
    ],
)
def test_what_is_no_distance_is_one_clear_line(f, message):
    with pytest.raises(AssetError, match=message) as caught:
        _ = Implicit(f, name="thing").excess
    assert "\n" not in str(caught.value) and str(caught.value).startswith("thing: ")


def test_given_bounds_are_checked():
    with pytest.raises(AssetError, match="two corners"):
        _ = Implicit(ball, bounds=[[0, 0, 0], [1, 0, 1]]).box
    with pytest.raises(AssetError, match="nothing is inside"):
        _ = Implicit(ball, bounds=[[5, 5, 5], [6, 6, 6]]).box


def test_a_material_that_is_none_is_told():
    with pytest.raises(AssetError, match="returned Color3f, expected a Surfel"):
        isosurface(Implicit(ball, lambda p: mi.Color3f(1), name="thing"), 16)


def test_names_of_code(tmp_path, monkeypatch):
    (tmp_path / "shapes.py").write_text(
        "from mi_simplify.scenes.implicit import sdf\nfrom mi_simplify.scenes.implicit.surface import Implicit\n"
        "def ball(p):\n    return sdf.sphere(p, 0.5)\n"
        "whole = Implicit(ball, ambient=(1, 0, 0), name='mine')\nnumber = 3\n"
    )
    (tmp_path / "broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    assert implicit_named(f"{tmp_path}/shapes.py:ball").name == "ball"
    assert implicit_named("shapes:whole", ambient=(0.0, 1.0, 0.0)).ambient == (0, 1, 0)
    assert implicit_named("shapes:whole", ambient=None).name == "mine"
    for name, message in {
        "shapes:none": "shapes has no 'none'", "nowhere.at.all:f": "there is no module 'nowhere.at.all'",
        "shapes:number": "no function and no Implicit, but int", "broken:f": "broken fails: ZeroDivisionError",
        "none.py:f": "file 'none.py' does not exist",
    }.items():  # fmt: skip
        with pytest.raises(AssetError, match=message):
            implicit_named(name)


# --- sphere tracing -----------------------------------------------------------------------------------------------


def test_a_traced_ball_is_the_ball():
    """Against Mitsuba's path of a tessellated one: same shading, coverage and place, seen off the axis."""
    from mi_simplify.initial.sphere import sphere

    positions, faces = sphere(20_000)
    material = Material(base_color=np.float32([[[0.8, 0.1, 0.1, 1]]]), specular=np.float32([[[0, 0.4, 0]]]))
    part = Part(0.8 * positions, faces, positions.astype(np.float32), material=material)
    views = goniometer(3, np.random.default_rng(5), width=48, height=36, distance=3.0, irradiance=np.pi)
    mesh = make_reference(Asset((part,), (Instance(0),)), transport="direct", spp=256).render(views)
    traced = SphereTraced(Implicit(ball, red), spp=256).render(views)
    assert np.abs(traced[..., 3] - mesh[..., 3]).mean() < 0.004
    assert abs(traced[..., 3].mean() - mesh[..., 3].mean()) < 1e-3
    whole = (traced[..., 3] == 1) & (mesh[..., 3] == 1)
    assert whole.mean() > 0.05
    np.testing.assert_allclose(traced[whole], mesh[whole], atol=0.04)
    assert np.abs(traced[whole] - mesh[whole]).mean() < 2e-3


def test_ambient_light_adds_its_colour_times_the_base_colour():
    views = look_at((0, 0, 3), (0, 0, 0), (0, 0, 3), width=16, height=16, fov=20.0, irradiance=np.pi)
    dark, lit = (SphereTraced(Implicit(ball, red, ambient=a)).render(views)[0] for a in ((0, 0, 0), (0.5, 0.5, 1)))
    np.testing.assert_allclose((lit - dark)[8, 8], [0.4, 0.05, 0.1, 0], atol=1e-4)


def test_a_shadow_falls_where_the_light_is_hidden():
    f = lambda p: sdf.union(sdf.box(p, (1, 0.1, 1), (0, -0.5, 0)), sdf.sphere(p, 0.3, (0, 0.3, 0)))  # noqa: E731
    views = look_at((0, 0.2, 5), (0, -0.4, 0.9), (0, 6, 0), width=64, height=64, fov=40.0, irradiance=np.pi)
    top = look_at((3, 4, 3), (0, -0.4, 0), (0, 6, 0), width=64, height=64, fov=40.0, irradiance=np.pi)
    free, dark = (SphereTraced(Implicit(f), spp=16, shadows=s).render(top)[0] for s in (False, True))
    assert np.array_equal(free[..., 3], dark[..., 3])
    shaded = (free[..., 0] > 0.3) & (dark[..., 0] < 0.02)
    assert 20 < shaded.sum() < 400
    lit = SphereTraced(Implicit(ball), spp=16, shadows=True).render(views)
    np.testing.assert_allclose(lit, SphereTraced(Implicit(ball), spp=16).render(views), atol=0.03)  # no acne


def test_overestimated_distances_are_traced_all_the_same():
    views = held_out_views(np.array([[-1, -1, -1], [1, 1, 1.0]]), 2, 48)
    a, b = (SphereTraced(Implicit(lambda p, s=s: s * knot(p)), spp=4).render(views) for s in (1.0, 3.0))
    assert np.abs(a - b).mean() < 2e-3


def test_a_camera_inside_is_told():
    views = look_at((0, 0, 0.1), (0, 0, 1), (0, 0, 3), width=16, height=16, irradiance=np.pi)
    with pytest.raises(AssetError, match=r"a camera at \(0, 0, 0.1\) is inside"):
        SphereTraced(Implicit(ball)).render(views)


def test_python_conditions_in_a_distance_are_told():
    def branching(p):
        if dr.all(p.x > 100):
            return p.x
        return ball(p)

    surface = Implicit(branching, name="thing")
    views = look_at((0, 0, 3), (0, 0, 0), (0, 0, 3), width=16, height=16, irradiance=np.pi)
    with pytest.raises(AssetError, match="thing: .*cannot be traced"):
        SphereTraced(surface).render(views)


def test_the_creature_is_a_distance_and_fits_its_bounds():
    surface = creature()
    assert surface.excess < 2
    found = isosurface(replace(surface, bounds=None), 64).bounds
    assert (found[0] > surface.bounds[0]).all() and (found[1] < surface.bounds[1]).all()


# --- isosurfaces --------------------------------------------------------------------------------------------------


def test_an_isosurface_lies_on_the_surface_and_faces_outwards():
    surface = Implicit(knot, red)
    asset = isosurface(surface, 64)
    part = asset.parts[0]
    assert np.abs(surface.at(part.vertices)).max() < 2e-3
    p = part.vertices[part.faces]
    area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    outwards = np.einsum("fi,fi->f", area, part.normals[part.faces].sum(1))
    assert (outwards > 0).mean() > 0.98
    np.testing.assert_allclose(part.colors[0], [0.8, 0.1, 0.1, 1], atol=1e-6)
    assert part.material.specular[0, 0, 1] == pytest.approx(0.4)


def test_what_is_smaller_than_a_cell_is_told():
    dot = Implicit(lambda p: sdf.sphere(p, 0.001), bounds=[[-1, -1, -1], [1, 1, 1]], name="dot")
    with pytest.raises(AssetError, match="dot: (nothing of it is as large|nowhere)"):
        isosurface(dot, 16)


# --- as a subject -------------------------------------------------------------------------------------------------


def test_an_implicit_surface_is_fitted_from_the_command_line(tmp_path, monkeypatch, capsys):
    """From the isosurface: all files, a known ambient light, and figures of direct light."""
    (tmp_path / "rings.py").write_text(
        "import mitsuba as mi\nfrom mi_simplify.scenes.implicit import sdf\n"
        "from mi_simplify.scenes.implicit.surface import Surfel\n"
        "def ring(p):\n    return sdf.torus(p, 30.0, 12.0, (100, 0, 0))\n"
        "def red(p):\n    return Surfel(mi.Color3f(.8, .1, .1))\n"
    )
    monkeypatch.chdir(tmp_path)
    short = ["optimizer.steps=12", "optimizer.batch=2", "optimizer.resolution=48", "initial.atlas_size=128"]
    short += ["reference.spp=2", "reference.pool=16", "evaluation.views=2", "evaluation.resolution=48"]
    short += ["evaluation.spp=16", "implicit.resolution=48", "export.formats=[glb,obj]"]
    own = ["implicit.material=rings:red", "implicit.ambient=[0.1, 0.2, 0.3]"]
    command = ["simplify", "rings:ring", "--triangles", "300", "--quiet"]
    assert cli.main([*command, *(x for s in (*short, *own) for x in ("--set", s))]) == 0, capsys.readouterr().err
    figures = json.loads((tmp_path / "out/ring/metrics.json").read_text())
    assert figures["candidates"]["result"]["psnr"] > 27
    config = load_config(tmp_path / "out/ring/config.yaml")
    assert config.latent.ambient.color == (0.1, 0.2, 0.3) and not config.latent.ambient.optimize
    assert "map_Ke" in (tmp_path / "out/ring/model.mtl").read_text()
    out = ["-o", str(tmp_path / "judged"), "--views", "2", "--resolution", "48", "--spp", "16"]
    assert cli.main(["evaluate", "out/ring/config.yaml", "out/ring/model.glb", *out, "-q"]) == 0
    again = json.loads((tmp_path / "judged/metrics.json").read_text())["candidates"]["out/ring/model.glb"]
    assert again["psnr"] == pytest.approx(figures["candidates"]["result"]["psnr"], abs=0.5)


def test_a_static_light_stays_where_it_is_and_shadows_are_of_the_reference():
    overrides = ["asset=sample:creature", "reference.transport=baked", "implicit.resolution=32", "reference.spp=1"]
    subject = open_subject(load_config(overrides=[*overrides, "views.light.position=[0, 4, 1]"]))
    reference = subject.reference()
    assert isinstance(reference, FramedReference) and isinstance(reference.reference, SphereTraced)
    assert reference.reference.shadows
    views = goniometer(
        3, np.random.default_rng(0), width=8, height=8, light_position=(0, 4, 1), irradiance=2.0
    )  # fmt: skip
    arrays = views.arrays()
    np.testing.assert_allclose(arrays["light_position"], [[0, 4, 1]] * 3)
    np.testing.assert_allclose(arrays["light_intensity"], 2.0 * 17, rtol=1e-6)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("reference.transport=matched", "not path traced; take 'direct', or 'baked'"),
        ("reference={transport: baked, environment: sky.exr}", "lit by the views' light and its ambient one alone"),
    ],
)
def test_settings_of_other_renderers_are_refused(override, message):
    with pytest.raises(ConfigError, match=message):
        open_subject(load_config(overrides=["asset=sample:creature", override]))
