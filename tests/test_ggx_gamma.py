"""The ggx_gamma BSDF: its formula, its sampling, its laws, its normals, its transparency, its derivatives."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba.chi2 import ChiSquareTest
from tiny_meshes import charted_sphere

from mi_simplify.bsdfs import microfacet
from mi_simplify.errors import UserError
from mi_simplify.integrators.gbuffer import fragment, trace
from mi_simplify.integrators.shading import mapped_normal
from mi_simplify.latent.model import Model
from mi_simplify.latent.surface import MeshTopology
from mi_simplify.scenes.shapes import MovingMesh, asset_shapes, make_mesh

FORMS = ("gltf", "paper")
PARAMETERS = ("base_color", "gamma", "roughness", "metallic")


# --- a slow reference, written from the specification, not from the code ---------------------------------------------


def ref_lobe(roughness, n, wi, wo):
    """
    D·G / (4 cos_i cos_o) of GGX with height-correlated Smith masking; Walter et al. 2007, Heitz 2014, in float64.
    """
    alpha = np.maximum(roughness, 0.03) ** 2
    cos_i, cos_o = np.sum(n * wi, -1), np.sum(n * wo, -1)
    h = wi + wo
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    cos_h = np.sum(n * h, -1)
    tan2 = 1 / cos_h**2 - 1
    d = 1 / (np.pi * alpha**2 * cos_h**4 * (1 + tan2 / alpha**2) ** 2)
    lam_i, lam_o = ((-1 + np.sqrt(1 + alpha**2 * (1 / c**2 - 1))) / 2 for c in (cos_i, cos_o))
    return d / (1 + lam_i + lam_o) / (4 * cos_i * cos_o), np.sum(wi * h, -1)


def ref_gltf(base_color, gamma, roughness, metallic, n, wi, wo):
    """
    glTF 2.0, Appendix B.2, with KHR_materials_specular: specularFactor 1, specularColor 1 - γ; per channel, no cosine.
    """
    lobe, cos_d = ref_lobe(roughness, n, wi, wo)
    f0 = np.minimum(((1 - 1.5) / (1 + 1.5)) ** 2 * (1 - gamma), 1)
    dielectric_fresnel = f0 + (1 - f0) * (1 - cos_d) ** 5
    dielectric = (1 - dielectric_fresnel) * base_color / np.pi + dielectric_fresnel * lobe
    f0 = (1 - gamma) * base_color  # DESIGN: a metal's γ belongs into the base colour
    metal = lobe * (f0 + (1 - f0) * (1 - cos_d) ** 5)
    return (1 - metallic) * dielectric + metallic * metal


def ref_paper(base_color, gamma, roughness, metallic, n, wi, wo):
    """
    Hasselgren et al. 2021, Sect. 5.2: Lambert plus Cook-Torrance, ks as in the text.
    """
    lobe, cos_d = ref_lobe(roughness, n, wi, wo)
    ks = (0.04 * (1 - metallic) + base_color * metallic) * (1 - gamma)
    return base_color * (1 - metallic) / np.pi + lobe * (ks + (1 - ks) * (1 - cos_d) ** 5)


REFERENCE = {"gltf": ref_gltf, "paper": ref_paper}


# --- helpers ---------------------------------------------------------------------------------------------------------


def unit(x):
    x = np.asarray(x, np.float64)
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def directions(rng, n, min_cos):
    """Directions of the upper hemisphere with z >= min_cos, shape (n, 3)."""
    z, phi = rng.uniform(min_cos, 1, n), rng.uniform(0, 2 * np.pi, n)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def vec(x, kind=None):
    return (kind or mi.Vector3f)(np.ascontiguousarray(np.asarray(x, np.float32).reshape(-1, 3).T))


def local(wi, n_geometric=(0, 0, 1), n_shading=(0, 0, 1)):
    """Interactions without a shape; ``wi`` [world], shape (N, 3) or (3,)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(np.atleast_2d(wi)))
    si.n = vec(unit(n_geometric), mi.Normal3f)
    si.sh_frame = mi.Frame3f(vec(unit(n_shading), mi.Normal3f))
    si.wi = si.to_local(vec(wi))
    return si


def bsdf(**kwargs):
    color = kwargs.pop("base_color", 0.5)
    color = {"type": "rgb", "value": np.broadcast_to(color, 3).tolist()} if np.ndim(color) < 2 else color
    return mi.load_dict({"type": "ggx_gamma", "base_color": color} | kwargs)


def texel_bsdf(values, form="gltf", **more):
    """One material per texel of a 1 x N texture, looked up exactly by :func:`texel_uv`; values have shape (N, 1|3)."""
    return mi.load_dict({"type": "ggx_gamma", "form": form} | {k: texture(v[None]) for k, v in values.items()} | more)


def texture(image):
    image = np.repeat(image, 2, axis=0) if len(image) == 1 else image  # Mitsuba wants 2 x 2 texels at least
    data = mi.TensorXf(np.ascontiguousarray(image, np.float32))
    return {"type": "bitmap", "data": data, "raw": True, "filter_type": "nearest"}


def texel_uv(n):
    return mi.Point2f((dr.arange(mi.Float, n) + 0.5) / n, mi.Float(0.5))


def numpy(x):
    return np.array(x).T


def evaluate(b, si, wo):
    """BRDF times cosine, shape (N, 3)."""
    return numpy(b.eval(mi.BSDFContext(), si, vec(wo)))


# --- the formula -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_value_is_the_formula_of_the_specification(form):
    rng, n = np.random.default_rng(1), 4000
    p = dict(
        base_color=rng.random((n, 3)), gamma=rng.random((n, 1)), roughness=rng.uniform(0, 1, (n, 1)),
        metallic=rng.random((n, 1)),
    )  # fmt: skip
    p["metallic"][: n // 2] = rng.integers(0, 2, (n // 2, 1))
    wi, wo = directions(rng, n, 0.06), directions(rng, n, 0.02)
    wo[::2] = unit(wi[::2] * [-1, -1, 1] + 0.1 * rng.normal(size=(n // 2, 3)))  # half of them in the highlight
    wo[:, 2] = np.maximum(np.abs(wo[:, 2]), 0.02)
    wo = unit(wo)
    si = local(wi)
    si.uv = texel_uv(n)
    got = evaluate(texel_bsdf(p, form), si, wo)
    expected = REFERENCE[form](**p, n=np.float64([0, 0, 1]), wi=wi[:, None], wo=wo[:, None]) * wo[:, 2:]
    assert np.all(np.abs(got - expected) <= 2e-3 * np.abs(expected) + 1e-5)
    assert expected.max() > 10 and np.median(expected) > 0.02  # both lobes were there


@pytest.mark.parametrize("form", FORMS)
def test_gamma_one_leaves_only_f90(form):
    wi, wo = unit([0.5, 0.1, 0.8]), unit([-0.7, 0.3, 0.4])
    n = np.float64([0, 0, 1])
    lobe, cos_d = ref_lobe(0.4, n, wi, wo)
    for metallic in (0.0, 1.0):
        b = bsdf(base_color=[0.9, 0.5, 0.0], gamma=1.0, roughness=0.4, metallic=metallic, form=form)
        diffuse = np.array([0.9, 0.5, 0.0]) / np.pi * (1 - metallic)
        f90 = (1 - cos_d) ** 5
        expected = (diffuse * (1 - f90 if form == "gltf" else 1) + f90 * lobe) * wo[2]
        assert np.allclose(evaluate(b, local(wi), wo)[0], expected, rtol=1e-3)
        # Nothing is left where light comes back to the viewer.
        glossy = evaluate(b, local(wi), wi)[0] - diffuse * wi[2]
        assert np.abs(glossy).max() < 1e-6


def test_forms_differ_and_unknown_ones_are_named():
    wi, wo = unit([0.9, 0, 0.3]), unit([-0.9, 0, 0.3])
    a, b = (bsdf(form=form, roughness=1.0).eval(mi.BSDFContext(), local(wi), vec(wo)).x[0] for form in FORMS)
    assert abs(a / b - 1) > 0.05
    with pytest.raises(Exception, match="unknown shading form 'phong': expected one of gltf, paper"):
        bsdf(form="phong")
    with pytest.raises(UserError, match="phong"):
        microfacet.check_form("phong")
    with pytest.raises(Exception, match="ruffness"):
        bsdf(ruffness=0.3)


def test_reciprocity_where_the_clamp_does_not_act():
    rng, n = np.random.default_rng(2), 2000
    wi, wo = directions(rng, n, 0.06), directions(rng, n, 0.06)
    for form in FORMS:
        b = bsdf(base_color=[0.8, 0.4, 0.1], gamma=0.3, roughness=0.35, metallic=0.4, form=form)
        there = evaluate(b, local(wi), wo) / wo[:, 2:]
        back = evaluate(b, local(wo), wi) / wi[:, 2:]
        assert np.allclose(there, back, rtol=1e-3, atol=1e-6)


def test_no_light_from_behind():
    wi = unit([0.3, 0.2, 0.8])
    value, pdf = bsdf().eval_pdf(mi.BSDFContext(), local(wi), mi.Vector3f(0.6, 0, -0.8))
    assert value.x[0] == 0 and pdf[0] == 0


# --- sampling --------------------------------------------------------------------------------------------------------


class LobeDomain:
    """
    Directions by azimuth and logarithmic angle around ``axis``, so that a highlight of any width fills the grid.

    ``θ = width (exp(k y) - 1)`` for y in [0, 1]; densities over directions are carried over by :meth:`jacobian`.
    """

    def __init__(self, axis, width):
        self.frame, self.width, self.k = mi.Frame3f(vec(axis)), width, float(np.log1p(np.pi / width))

    def bounds(self):
        return mi.ScalarBoundingBox2f([-dr.pi, 0], [dr.pi, 1])

    def aspect(self):
        return 2

    def map_forward(self, p):
        theta = self.width * (dr.exp(self.k * p.y) - 1)
        (sin_phi, cos_phi), (sin_theta, cos_theta) = dr.sincos(p.x), dr.sincos(theta)
        return self.frame.to_world(mi.Vector3f(cos_phi * sin_theta, sin_phi * sin_theta, cos_theta))

    def _theta(self, d):
        v = self.frame.to_local(d)
        return v, dr.atan2(dr.sqrt(v.x * v.x + v.y * v.y), v.z)

    def map_backward(self, d):
        v, theta = self._theta(d)
        return mi.Vector2f(dr.atan2(v.y, v.x), dr.log(1 + theta / self.width) / self.k)

    def jacobian(self, d):
        _, theta = self._theta(d)
        return dr.sin(theta) * (theta + self.width) * self.k


#: Roughness, metallic, viewer, shading normal, opacity. The last ones are clamped (n·wi < ε), see the back, a tilted
#: shading normal, or a surface that lets a part through, which the density leaves out.
CHI_SQUARE = [
    (roughness, metallic, wi, (0, 0, 1), None)
    for roughness in (0.03, 0.1, 0.3, 0.6, 1.0)
    for metallic in (0.0, 1.0)
    for wi in ((0, 0, 1), (0.6, 0.2, 0.77), (-0.95, 0.2, 0.2))
] + [
    (0.3, 0.5, (0.999, 0, 0.02), (0, 0, 1), None),
    (0.3, 0.5, (0.5, -0.2, -0.8), (0, 0, 1), None),
    (0.5, 0.5, (0.8, 0, 0.3), (-0.8, 0.1, 0.6), None),
    (0.4, 0.5, (0.6, 0.2, 0.77), (0, 0, 1), 0.6),
]


def lobe_axis(wi, n):
    """Mirror direction of the viewer at the clamped normal."""
    wi, n = unit(wi), unit(n)
    n = n if wi[2] >= 0 else -n
    n = unit(n + wi * max(0, 0.05 - n @ wi))
    return unit(2 * n * (n @ wi) - wi)


@pytest.mark.parametrize(("roughness", "metallic", "wi", "n", "opacity"), CHI_SQUARE)
def test_sampling_follows_its_density(roughness, metallic, wi, n, opacity):
    wi, more = unit(wi), {} if opacity is None else {"opacity": opacity}
    b = bsdf(base_color=[0.8, 0.4, 0.2], gamma=0.3, roughness=roughness, metallic=metallic, **more)
    domain = LobeDomain(lobe_axis(wi, n), roughness**2)

    def sample(u):
        si = local(np.broadcast_to(wi, (dr.width(u), 3)), n_shading=n)
        bs, weight = b.sample(mi.BSDFContext(), si, u.x, mi.Point2f(u.y, u.z))
        reflected = dr.any(weight > 0) & (bs.sampled_type != mi.UInt32(+mi.BSDFFlags.Null))
        return si.to_world(bs.wo), dr.select(reflected, mi.Float(1), 0)

    def density(wo):
        si = local(np.broadcast_to(wi, (dr.width(wo), 3)), n_shading=n)
        return b.pdf(mi.BSDFContext(), si, si.to_local(wo)) * domain.jacobian(wo)

    test = ChiSquareTest(domain, sample, density, sample_dim=3, sample_count=400_000, res=161, ires=8)
    assert test.run(significance_level=0.01, test_count=len(CHI_SQUARE), quiet=True), test.messages
    assert test.pdf_sum[0] > 0.45, test.messages


@pytest.mark.parametrize("form", FORMS)
def test_eval_pdf_and_sample_agree(form):
    rng, n = np.random.default_rng(3), 20_000
    opacity = texture(rng.uniform(0.2, 1, (1, n, 1)))
    p = dict(base_color=rng.random((n, 3)), gamma=rng.random((n, 1)), metallic=rng.random((n, 1)))
    b = texel_bsdf(p | dict(roughness=rng.uniform(0.1, 1, (n, 1))), form, opacity=opacity)
    wi = directions(rng, n, 0.0)
    wi[::2, 2] *= -1
    si = local(wi)
    si.uv = texel_uv(n)
    u = rng.random((3, n)).astype(np.float32)
    bs, weight = b.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]))
    value, pdf = b.eval_pdf(mi.BSDFContext(), si, bs.wo)
    assert dr.all(value == b.eval(mi.BSDFContext(), si, bs.wo), axis=None) and dr.all(
        pdf == b.pdf(mi.BSDFContext(), si, bs.wo)
    )
    null = numpy(bs.sampled_type) == int(mi.BSDFFlags.Null)
    lobe = ~null & (numpy(bs.pdf) > 0)
    assert dr.all(bs.eta == 1)
    assert 0.2 < null.mean() < 0.6 and lobe.mean() > 0.3
    value, pdf, weight = numpy(value), numpy(pdf), numpy(weight)
    assert np.allclose(numpy(bs.pdf)[lobe], pdf[lobe], rtol=1e-5)
    assert np.allclose(weight[lobe], (value / np.maximum(pdf, 1e-30)[:, None])[lobe], rtol=1e-4)
    assert np.all(weight[~null & ~lobe] == 0) and np.all(value[~null & ~lobe] == 0)
    # The null lobe goes straight on, with the probability and the weight of what is not covered.
    assert np.allclose(numpy(bs.wo)[null], -numpy(si.wi)[null]) and np.allclose(weight[null], 1)
    uncovered = 1 - numpy(b.opacity.eval_1(si))
    assert np.allclose(numpy(bs.pdf)[null], uncovered[null], rtol=1e-5)
    assert np.allclose(numpy(b.eval_null_transmission(si))[:, 0], uncovered)
    inactive = b.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]), mi.Bool(False))[1]
    assert dr.all(inactive == 0, axis=None)


# --- energy ----------------------------------------------------------------------------------------------------------


def albedo(b, wi, n=40_000):
    """Directional albedo, the mean weight of samples, and its standard error; shape (3,) each."""
    rng = np.random.default_rng(4)
    u = rng.random((3, n)).astype(np.float32)
    weight = numpy(b.sample(mi.BSDFContext(), local(np.broadcast_to(wi, (n, 3))), mi.Float(u[0]), mi.Point2f(u[1:]))[1])
    return weight.mean(0), weight.std(0) / n**0.5


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("cos_i", [1.0, 0.6, 0.2, 0.05, 0.01])
def test_specular_lobe_reflects_at_most_what_arrives(form, cos_i):
    wi = [np.sqrt(1 - cos_i**2), 0, cos_i]
    for roughness in (0.05, 0.3, 0.6, 1.0):
        mean, error = albedo(bsdf(base_color=1.0, metallic=1.0, roughness=roughness, form=form), wi)
        assert np.all(mean <= 1 + 4 * error + 1e-4)
        if roughness < 0.1 and cos_i > 0.1:
            assert np.all(mean > 0.97)  # F = 1 and hardly any masking: a mirror


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("cos_i", [1.0, 0.6, 0.3, 0.15])
def test_base_colours_up_to_one_half_conserve_energy(form, cos_i):
    """Up to 81°: beyond that Fresnel alone returns more than half, and both formulas add Lambert to it."""
    wi = [np.sqrt(1 - cos_i**2), 0, cos_i]
    for roughness in (0.1, 0.4, 1.0):
        for metallic in (0.0, 0.5, 1.0):
            mean, error = albedo(bsdf(metallic=metallic, roughness=roughness, form=form), wi)
            assert np.all(mean <= 1 + 4 * error + 1e-4), (roughness, metallic)


@pytest.mark.parametrize("form", FORMS)
def test_grazing_views_gain_what_the_formula_gains_and_no_more(form):
    """At n·wi <= ε the clamp holds the albedo where it is at ε; in the mean over all views energy is lost."""
    b, cos = bsdf(roughness=0.1, form=form), (np.arange(10) + 0.5) / 10
    at = lambda c: albedo(b, [np.sqrt(1 - c**2), 0, c])[0][0]  # noqa: E731
    assert np.allclose([at(0.03), at(0.001)], at(0.05), atol=0.01)
    assert 0.5 < 2 * np.mean([at(c) * c for c in cos]) < 0.65


def test_paper_form_of_a_white_surface_gains_energy():
    """The limit stated for base colours is no accident: the paper adds its lobes without trading one for the other."""
    mean, error = albedo(bsdf(base_color=1.0, roughness=0.3, form="paper"), [0.98, 0, 0.2])
    assert np.all(mean > 1.05)
    mean, error = albedo(bsdf(base_color=0.7, roughness=0.3, form="gltf"), [0.6, 0, 0.8])
    assert np.all(np.abs(mean - 0.7) < 0.05)  # Lambert dims as the dielectric reflects


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
