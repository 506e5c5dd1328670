"""The ggx_gamma BSDF in scenes: the side seen, normal maps, transparency, derivatives, Mitsuba's own integrators."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.ggx import (
    FORMS,
    PARAMETERS,
    REFERENCE,
    bsdf,
    directions,
    evaluate,
    local,
    numpy,
    ref_gltf,
    texel_bsdf,
    texel_uv,
    texture,
    unit,
    vec,
)
from support.tiny_meshes import charted_sphere

from mi_simplify.bsdfs import microfacet
from mi_simplify.integrators.gbuffer import fragment, trace
from mi_simplify.integrators.shading import mapped_normal
from mi_simplify.latent.surface import MeshTopology
from mi_simplify.machine.meshes import MovingMesh, make_mesh
from mi_simplify.model.model import Model
from mi_simplify.scenes.shapes import asset_shapes

# --- the side that is seen -------------------------------------------------------------------------------------------


def test_two_sided_by_the_geometric_normal():
    rng, n = np.random.default_rng(5), 500
    b = bsdf(base_color=[0.8, 0.4, 0.2], roughness=0.4, metallic=0.3)
    wi, wo = directions(rng, n, 0.06), directions(rng, n, 0.0)
    front = evaluate(b, local(wi), wo)
    mirror = [1, 1, -1]
    back = evaluate(b, local(wi * mirror), wo * mirror)
    assert np.allclose(front, back, rtol=1e-4, atol=1e-7) and front.min() > 0
    # The viewer sees the front, whatever the interpolated normal: nothing is turned over, only towards the viewer.
    tilted, wi = unit([0.9, 0, 0.45]), unit([-0.9, 0, 0.25])
    assert tilted @ wi < 0
    si = local(wi, n_shading=tilted)
    n = numpy(si.to_world(b.shading_frame(si).n))[0]
    assert np.allclose(n, unit(tilted + wi * (0.05 - tilted @ wi)), atol=1e-5)
    # And from behind, with the same interpolated normal, its back.
    si = local(-wi, n_shading=tilted)
    assert np.allclose(numpy(si.to_world(b.shading_frame(si).n))[0], -n, atol=1e-5)


@pytest.mark.parametrize("kink", [microfacet.MIN_COSINE, 0.0, -0.5])
def test_clamp_of_the_shading_normal_is_continuous(kink):
    cos = kink + np.linspace(-1e-3, 1e-3, 201)
    wi = np.stack([np.sqrt(1 - cos**2), 0 * cos, cos], -1)
    n = numpy(microfacet.face_viewer(mi.Vector3f(0, 0, 1), vec(wi)))
    step = np.linalg.norm(np.diff(n, axis=0), axis=1)
    assert step.max() < 10 * 1e-5 and np.allclose(np.linalg.norm(n, axis=1), 1, atol=1e-5)
    facing = np.einsum("ki,ki->k", n, wi)
    assert facing.min() > 0.049 and np.abs(np.diff(facing)).max() < 1e-4
    # The value too, along a path of the viewer under a fixed light (wi is local, its side is given by si.n).
    si = local(wi, n_geometric=unit([0.9, 0, 0.6]))
    value = evaluate(bsdf(roughness=0.5, metallic=0.5), si, unit([0.5, 0.3, 0.6]))[:, 0]
    assert value.min() > 0 and np.abs(np.diff(value)).max() < 2e-4 * value.max()


def test_clamp_leaves_normals_that_face_the_viewer():
    n = numpy(microfacet.face_viewer(mi.Vector3f(0, 0, 1), vec(unit([0.9, 0, 0.06]))))[0]
    assert np.allclose(n, [0, 0, 1])
    assert np.allclose(numpy(microfacet.face_viewer(mi.Vector3f(0, 0, 1), mi.Vector3f(0, 0, -1)))[0], [0, 0, -1])


# --- normal maps -----------------------------------------------------------------------------------------------------

UPRIGHT = [[0, 1], [1, 1], [1, 0], [0, 0]]
MIRRORED = [[1, 1], [0, 1], [0, 0], [1, 0]]


def quad(uvs, b, tangents=None):
    """Unit square in the xy plane, facing +z, at the origin."""
    vertices = np.float64([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    normals = np.tile([0.0, 0, 1], (4, 1))
    return make_mesh("quad", vertices, np.array([[0, 1, 2], [0, 2, 3]]), normals, np.float32(uvs), b, tangents)


def seen(shape, towards=(0, 0, 1), at=(0.3, 0.4, 0)):
    """The interaction where a ray to ``at`` meets the shape, from direction ``towards``."""
    scene = mi.load_dict({"type": "scene", "shape": shape})
    d = unit(towards)
    return scene.ray_intersect(mi.Ray3f(vec(np.asarray(at) + 2 * d, mi.Point3f), vec(-d)))


@pytest.mark.parametrize("mesh_tangents", [False, True])
@pytest.mark.parametrize(
    ("uvs", "t", "b"),
    [
        (UPRIGHT, [1, 0, 0], [0, 1, 0]),
        (MIRRORED, [-1, 0, 0], [0, 1, 0]),
        ([[0, 0], [1, 0], [1, 1], [0, 1]], [1, 0, 0], [0, -1, 0]),  # upside down
        ([[0, 0], [0, 1], [1, 1], [1, 0]], [0, 1, 0], [-1, 0, 0]),  # a quarter turn
    ],
)
def test_normal_map_points_along_u_and_up_the_image(uvs, t, b, mesh_tangents):
    m = unit([0.5, 0.3, 0.8])
    image = np.tile(np.float32(m * 0.5 + 0.5), (2, 2, 1))
    material = bsdf(normal_map=texture(image), mesh_tangents=mesh_tangents)
    shape = quad(uvs, material, np.tile(np.float32(t), (4, 1)) if mesh_tangents else None)
    expected = m[0] * np.float64(t) + m[1] * np.float64(b) + m[2] * np.float64([0, 0, 1])
    si = seen(shape)
    assert np.allclose(numpy(si.to_world(material.shading_frame(si).n))[0], expected, atol=1e-5)
    si = seen(shape, towards=(0.1, 0.2, -1))
    assert np.allclose(numpy(si.to_world(material.shading_frame(si).n))[0], -expected, atol=1e-5)


def test_mesh_tangents_are_interpolated_from_the_attribute():
    """A tangent that differs from ∂p/∂u, so that it can only have come from the attribute."""
    m = unit([0.6, 0, 0.8])
    material = bsdf(normal_map=texture(np.tile(np.float32(m * 0.5 + 0.5), (2, 2, 1))), mesh_tangents=True)
    corner = np.float32([[1, 0, 0], [0, 1, 0], [0, 1, 0], [1, 0, 0]])  # turns from x to y as x grows
    shape = quad(UPRIGHT, material, corner)  # held here: an interaction only points to it
    si = seen(shape, at=(0.5, 0.2, 0))
    tangent = unit([1, 1, 0])
    expected = m[0] * tangent + m[2] * np.float64([0, 0, 1])
    assert np.allclose(numpy(si.to_world(material.shading_frame(si).n))[0], expected, atol=1e-4)


@pytest.mark.parametrize("creased", [False, True])
def test_both_sides_of_the_fit_shade_the_same_normal(creased):
    """The BSDF on a Mitsuba mesh against the latent renderer's own lookup, on charts that lie in every way."""
    mesh, m = charted_sphere(4, noise=0.03), unit([0.3, 0.4, 0.8])
    mesh = replace(mesh, normal_index=np.arange(len(mesh.uvs))) if creased else mesh
    textures = np.full((1, 1, 4), 0.5, np.float32), np.full((1, 1, 3), 0.5, np.float32), np.float32(m)[None, None]
    model = Model(mesh, *(np.tile(x, (2, 2, 1)) for x in textures))

    rng = np.random.default_rng(6)
    o = 3 * unit(rng.normal(size=(3000, 3)))
    d = unit(rng.uniform(-0.6, 0.6, o.shape) - o)
    o[1::2], d[1::2] = rng.uniform(-0.3, 0.3, (1500, 3)), unit(rng.normal(size=(1500, 3)))  # half of them from inside
    shapes = asset_shapes(model.as_asset())
    scene = mi.load_dict({"type": "scene"} | shapes)
    si = scene.ray_intersect(mi.Ray3f(vec(o, mi.Point3f), vec(d)))
    hit = numpy(si.is_valid())
    ours = numpy(si.to_world(shapes["part_0"].bsdf().shading_frame(si).n))

    topology, p = MeshTopology(mesh), mesh.positions
    face, _ = trace(MovingMesh(p, mesh.position_faces).scene, vec(o, mi.Point3f), vec(d))
    surface = topology.surface(mi.Float(p.astype(np.float32).ravel()))
    f = fragment(surface, face, vec(o, mi.Point3f), vec(d))
    theirs = numpy(mapped_normal(f, mi.Vector3f(*m.tolist()), -vec(d)))
    assert hit.sum() > 2500
    assert np.abs(ours - theirs)[hit].max() < 1e-3
    assert np.linalg.norm(ours - numpy(si.sh_frame.n), axis=1)[hit].mean() > 0.3  # the map did something


# --- transparency ----------------------------------------------------------------------------------------------------


def plane(z, b, to=1.0):
    """Square of half side ``to`` facing +z at height z."""
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, z]).scale(to), "bsdf": b}


def image(shapes, integrator=None, spp=64, size=16, fov=40, position=(0.3, 0.2, 3.0)):
    """Looking down -z from 4 onto the origin, a point light beside the camera; linear RGB, shape (size, size, 3)."""
    scene = {
        "type": "scene",
        "integrator": integrator or {"type": "volpath", "max_depth": 6},
        "light": {"type": "point", "position": list(position), "intensity": {"type": "rgb", "value": [20.0] * 3}},
        "sensor": {
            "type": "perspective", "fov": fov,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
            "film": {
                "type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}
            },
            "sampler": {"type": "independent"},
        },
    }  # fmt: skip
    return mi.render(mi.load_dict(scene | shapes), spp=spp, seed=7).numpy()


def test_opacity_is_a_linear_mix_on_camera_and_shadow_rays():
    wall = plane(-1.0, bsdf(base_color=[0.2, 0.6, 0.9]), to=4)
    clear = image({"wall": wall})
    screen = lambda **kw: {"wall": wall, "screen": plane(0.0, bsdf(base_color=[0.7, 0.3, 0.1], **kw), to=4)}  # noqa: E731
    solid = image(screen(), integrator={"type": "volpath", "max_depth": 2})
    half = image(screen(opacity=0.5), integrator={"type": "volpath", "max_depth": 2}, spp=2048)
    # The wall is seen through the screen once and lit through it once.
    assert np.allclose(half, 0.5 * solid + 0.25 * clear, rtol=0.05)
    assert np.abs(half.mean((0, 1)) / (0.5 * solid + 0.25 * clear).mean((0, 1)) - 1).max() < 0.01
    assert np.allclose(image(screen(opacity=0.0)), clear, rtol=0.02)


def test_mask_cuts_off_at_its_threshold():
    wall = plane(-1.0, bsdf(base_color=[0.2, 0.6, 0.9]), to=4)
    red = {"base_color": [0.7, 0.3, 0.1]}
    rough = red | {"opacity_cutoff": 0.5}
    clear, solid = image({"wall": wall}), image({"wall": wall, "screen": plane(0.0, bsdf(**red), 4)})
    for opacity, expected in ((0.49, clear), (0.5, solid), (0.9, solid)):
        got = image({"wall": wall, "screen": plane(0.0, bsdf(**rough, opacity=opacity), to=4)})
        assert np.allclose(got, expected, rtol=0.03), opacity
    # A hole cut by the texture against one cut into the geometry: the same picture, shadow included.
    holes = np.zeros((1, 2, 1), np.float32)
    holes[0, 0] = 1
    cut = plane(0.0, bsdf(**rough, opacity=texture(holes)), to=1)
    half = plane(0.0, bsdf(**red), to=1)
    half["to_world"] = mi.ScalarTransform4f().translate([-0.5, 0, 0]).scale([0.5, 1, 1])
    a, b = (image({"wall": wall, "screen": s}, spp=256, size=24) for s in (cut, half))
    assert np.abs(a - b).mean() < 0.01 * b.mean() and np.abs(a - clear.mean()).max() > 0.1


# --- derivatives -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", [*PARAMETERS, "opacity", "normal_map"])
def test_every_textured_parameter_is_traversed_and_differentiable(name, form):
    rng, n = np.random.default_rng(8), 64
    values = dict(
        base_color=rng.uniform(0.2, 0.8, (n, 3)), gamma=rng.uniform(0.2, 0.8, (n, 1)),
        roughness=rng.uniform(0.4, 0.8, (n, 1)), metallic=rng.uniform(0.2, 0.8, (n, 1)),
        opacity=rng.uniform(0.3, 0.7, (n, 1)), normal_map=rng.uniform(0.4, 0.6, (n, 3)) + [0, 0, 0.3],
    )  # fmt: skip
    b = texel_bsdf(values, form)
    params = mi.traverse(b)
    assert {f"{k}.data" for k in values} <= set(params.keys())
    si = local(directions(rng, n, 0.3))
    si.dp_du, si.dp_dv, si.uv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, -1, 0), texel_uv(n)
    wo, weight = vec(directions(rng, n, 0.3)), vec(rng.uniform(0.5, 1.5, (n, 3)), mi.Color3f)
    key, start = f"{name}.data", mi.TensorXf(params[f"{name}.data"])
    toward = mi.TensorXf(rng.uniform(-1, 1, start.shape).astype(np.float32))

    def values_at(t):
        params[key] = start + t * toward
        params.update()
        return dr.sum(b.eval(mi.BSDFContext(), si, wo) * weight)

    t = mi.Float(0)
    dr.enable_grad(t)
    value = values_at(t)
    dr.forward(t)
    got, eps = dr.grad(value).numpy(), 4e-3
    with dr.suspend_grad():
        near, far = (values_at(mi.Float(h)).numpy() - values_at(mi.Float(-h)).numpy() for h in (eps, 2 * eps))
    expected = (8 * near - far) / (12 * eps)  # central differences of fourth order
    assert np.abs(expected).mean() > 1e-2
    assert np.allclose(got, expected, rtol=0.01, atol=0.01 * np.abs(expected).mean())


def test_null_lobe_carries_the_derivative_of_the_opacity():
    b = bsdf(opacity=0.4)
    params = mi.traverse(b)
    opacity = mi.Float(0.4)
    dr.enable_grad(opacity)
    params["opacity.value"] = opacity
    params.update()
    si = local([0, 0, 1])
    bs, weight = b.sample(mi.BSDFContext(), si, mi.Float(0.9), mi.Point2f(0.3, 0.6))  # 0.9 > opacity: goes through
    assert int(bs.sampled_type[0]) == int(mi.BSDFFlags.Null) and weight.x[0] == 1
    # weight · pdf = 1 - opacity, and the density is held fixed: d(weight) = -1 / (1 - opacity)
    dr.backward(weight.x)
    assert dr.grad(opacity)[0] == pytest.approx(-1 / 0.6, rel=1e-4)
    dr.set_grad(opacity, 0)
    dr.backward(b.eval_null_transmission(si).x)
    assert dr.grad(opacity)[0] == pytest.approx(-1, rel=1e-5)


# --- under Mitsuba's own integrators ---------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_point_light_under_path(form):
    kd, position = np.array([0.8, 0.4, 0.2]), np.array([1.0, 0.5, 2.0])
    material = dict(gamma=0.2, roughness=0.4, metallic=0.3)
    plate = plane(0.0, bsdf(base_color=kd, form=form, **material), to=4)
    got = image({"plate": plate}, {"type": "path", "max_depth": 2}, spp=4096, size=9, position=position)
    # The mean over each pixel of a 9 x 9 film: x to the right, y down.
    s = (np.arange(72) + 0.5) / 72 * 2 - 1
    half = 4 * np.tan(np.radians(20))
    p = np.stack(np.broadcast_arrays(s[None] * half, -s[:, None] * half, 0.0), -1)
    wi, to_light = unit([0, 0, 4] - p), position - p
    wo = unit(to_light)
    gamma, roughness, metallic = (material[k] for k in ("gamma", "roughness", "metallic"))
    up = np.array([0.0, 0, 1])
    value = REFERENCE[form](kd, gamma, roughness, metallic, up, wi[..., None, :], wo[..., None, :])
    expected = value * 20 * wo[..., 2:] / np.sum(to_light**2, -1, keepdims=True)
    expected = expected.reshape(9, 8, 9, 8, 3).mean((1, 3))
    assert np.allclose(got, expected, rtol=0.02)
    assert np.abs(got / expected - 1).mean() < 0.003


def test_white_metal_in_a_white_sky_under_path():
    """A furnace: a pixel shows the directional albedo, here by quadrature of the formula (the azimuth is free)."""
    material = bsdf(base_color=1.0, metallic=1.0, roughness=0.7)
    cos = (np.arange(4000) + 0.5) / 4000
    wo, up = np.stack([np.sqrt(1 - cos**2), 0 * cos, cos], -1), np.float64([0, 0, 1])
    expected = 2 * np.pi * np.mean(ref_gltf(1.0, 0.0, 0.7, 1.0, up, up, wo) * cos)
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0] * 3}}
    plate = {"plate": plane(0.0, material, to=4), "light": sky}
    got = image(plate, {"type": "path", "max_depth": 3}, spp=4096, size=1, fov=1)
    assert expected == pytest.approx(0.698, abs=0.001)
    assert np.allclose(got, expected, rtol=0.03)
