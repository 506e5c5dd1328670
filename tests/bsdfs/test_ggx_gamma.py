"""The ggx_gamma BSDF: its formula, its sampling, its energy."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba.chi2 import ChiSquareTest
from support.ggx import (
    FORMS,
    REFERENCE,
    bsdf,
    directions,
    evaluate,
    local,
    numpy,
    ref_lobe,
    texel_bsdf,
    texel_uv,
    texture,
    unit,
    vec,
)

from mi_simplify.bsdfs import microfacet
from mi_simplify.errors import UserError

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


# --- lobes, each alone -----------------------------------------------------------------------------------------------

DIFFUSE, GLOSSY, NULL = mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.Null


def query(lobe, how):
    """A context that asks for one lobe, by its type or by its component."""
    ctx = mi.BSDFContext()
    if how == "type":
        ctx.type_mask = int(lobe)
    else:
        ctx.component = (DIFFUSE, GLOSSY, NULL).index(lobe)
    return ctx


@pytest.mark.parametrize("how", ["type", "component"])
@pytest.mark.parametrize("form", FORMS)
def test_lobes_add_up_and_each_is_its_formula(form, how):
    rng, n = np.random.default_rng(8), 2000
    b = bsdf(base_color=[0.8, 0.4, 0.1], gamma=0.3, roughness=0.5, metallic=0.4, opacity=0.7, form=form)
    si, wo = local(directions(rng, n, 0.1)), vec(directions(rng, n, 0.1))
    whole, diffuse, glossy = (
        numpy(b.eval(c, si, wo)) for c in (mi.BSDFContext(), query(DIFFUSE, how), query(GLOSSY, how))
    )
    assert np.allclose(diffuse + glossy, whole, rtol=1e-4, atol=1e-6)
    assert diffuse.min() > 0 and glossy.max() > 0.1
    if form == "paper":
        lambert = np.float64([0.8, 0.4, 0.1]) * 0.6 * 0.7 / np.pi * numpy(wo)[:, 2:]
        assert np.allclose(diffuse, lambert, rtol=1e-4)
    assert dr.all(b.eval(query(NULL, how), si, wo) == 0, axis=None)
    assert dr.all(b.pdf(query(NULL, how), si, wo) == 0)


@pytest.mark.parametrize("how", ["type", "component"])
@pytest.mark.parametrize(("lobe", "component"), [(DIFFUSE, 0), (GLOSSY, 1), (NULL, 2)])
def test_a_lobe_alone_is_sampled_alone(lobe, component, how):
    rng, n = np.random.default_rng(9), 200_000
    b = bsdf(base_color=[0.8, 0.4, 0.1], gamma=0.3, roughness=0.5, metallic=0.4, opacity=0.7)
    ctx, si = query(lobe, how), local(np.broadcast_to(unit([0.5, 0.2, 0.8]), (n, 3)))
    u = rng.random((3, n)).astype(np.float32)
    bs, weight = b.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
    valid = dr.any(weight > 0)
    assert dr.all(~valid | ((bs.sampled_component == component) & (bs.sampled_type == mi.UInt32(+lobe))))
    if lobe == NULL:
        assert dr.all(bs.pdf == 1) and np.allclose(numpy(weight), 0.3, atol=1e-6)
        assert np.allclose(numpy(bs.wo), -numpy(si.wi))
        return
    assert np.allclose(numpy(dr.select(valid, bs.pdf, 1)), numpy(dr.select(valid, b.pdf(ctx, si, bs.wo), 1)), rtol=1e-4)
    # The mean weight is the albedo of that lobe: the same by uniform directions.
    uniform = mi.warp.square_to_uniform_hemisphere(mi.Point2f(u[1:]))
    expected, got = numpy(b.eval(ctx, si, uniform)) * 2 * np.pi, numpy(weight)
    error = np.hypot(expected.std(0), got.std(0)) / n**0.5
    assert np.all(np.abs(got.mean(0) - expected.mean(0)) < 4 * error)


def test_without_the_null_lobe_all_samples_are_reflected():
    ctx, n = mi.BSDFContext(), 5000
    ctx.type_mask = int(DIFFUSE | GLOSSY)
    b, si = bsdf(opacity=0.4, roughness=0.6), local(np.broadcast_to(unit([0.3, 0.2, 0.9]), (n, 3)))
    u = np.random.default_rng(10).random((3, n)).astype(np.float32)
    bs, weight = b.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
    assert dr.all(bs.sampled_component < 2) and dr.mean(mi.Float(dr.any(weight > 0)))[0] > 0.9
    # The weight carries the opacity that the probability leaves out.
    opaque = bsdf(roughness=0.6).sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))[1]
    assert np.allclose(numpy(weight), 0.4 * numpy(opaque), rtol=1e-4, atol=1e-6)


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
