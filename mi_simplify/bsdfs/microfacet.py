"""
The shading model as plain functions on Dr.Jit arrays: one Lambert lobe and one isotropic GGX lobe.

Directions point away from the surface and are unit vectors; ``cos_i = n·wi`` towards the viewer,
``cos_o = n·wo`` towards the light. Everything here is differentiable in every argument.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..errors import UserError

#: Reflectance of a dielectric at normal incidence (ior 1.5).
DIELECTRIC_F0 = 0.04

#: Roughness below this makes highlights that no point light and no float32 gradient can resolve.
MIN_ROUGHNESS = 0.03

#: Smallest cosine between the shading normal and the viewer, see :func:`face_viewer`.
MIN_COSINE = 0.05

#: A unit tangent whose projection on the shading plane is shorter than this is no longer normalised.
MIN_TANGENT = 0.1

#: How the lobes are mixed: as in the paper (Sect. 5.2), or as in glTF 2.0 (Appendix B).
FORMS = ("gltf", "paper")


def check_form(form: str) -> str:
    """
    Return ``form``; raise :class:`UserError` where it is none of :data:`FORMS`.
    """
    if form not in FORMS:
        raise UserError(f"unknown shading form '{form}': expected one of {', '.join(FORMS)}")
    return form


def face_viewer(n, wi):
    """
    Turn a shading normal continuously until the viewer sees its front.

    ``n' = normalize(n + wi max(0, ε - n·wi))``. Interpolated and mapped normals of a low-poly mesh often face away from
    the viewer on visible faces; cutting the BSDF off there would put a jump inside the surface
    that no edge sample sees.

    Parameters
    ----------
    n, wi : mi.Vector3f
        Shading normal and direction to the viewer, same frame.
    """
    n = n + wi * dr.maximum(0.0, MIN_COSINE - dr.dot(n, wi))
    return n * dr.rsqrt(dr.maximum(dr.squared_norm(n), 1e-12))


def ggx_d(alpha2, n, h):
    """
    GGX distribution of normals (Walter et al. 2007, Eq. 33), 0 below the horizon; ``n`` and ``h`` are unit vectors.
    """
    # sin² from the chord: 1 - cos² has no digits left where the lobe is narrow, a third of D was noise at α² = 1e-6.
    chord2 = dr.squared_norm(n - h)
    cos_h = dr.fma(chord2, -0.5, 1)
    t = dr.fma(dr.square(cos_h), alpha2, chord2 * dr.fma(chord2, -0.25, 1))
    return dr.select(cos_h > 0, alpha2 / (dr.pi * dr.square(t)), 0)


def smith_v(alpha2, cos_i, cos_o):
    """
    Height-correlated Smith visibility ``G2 / (4 cos_i cos_o)`` (Heitz 2014, Eq. 99).
    """
    a = cos_o * dr.sqrt(dr.fma(dr.square(cos_i), 1 - alpha2, alpha2))
    b = cos_i * dr.sqrt(dr.fma(dr.square(cos_o), 1 - alpha2, alpha2))
    return 0.5 / dr.maximum(a + b, 1e-7)


def smith_g1(alpha2, cos_v):
    """
    Smith masking of one direction.
    """
    return 2 * cos_v / dr.maximum(cos_v + dr.sqrt(dr.fma(dr.square(cos_v), 1 - alpha2, alpha2)), 1e-7)


def schlick(f0, cos_d):
    """
    Schlick's Fresnel term with F90 = 1; ``cos_d`` is the cosine between view and half vector.
    """
    m = dr.maximum(1 - cos_d, 0)
    m2 = dr.square(m)
    return f0 + (1 - f0) * (dr.square(m2) * m)


def evaluate(
    base_color, gamma, roughness, metallic, n, wi, wo, form: str = "gltf", lobes: tuple[bool, bool] = (True, True)
):
    """
    BRDF times cosine, ``f(wi, wo) max(n·wo, 0)``.

    form 'paper' (Hasselgren et al. 2021, Sect. 5.2): ``kd (1-m)/π + D V F(ks)`` with
    ``ks = (1-γ)(0.04 (1-m) + kd m)``. form 'gltf' (glTF 2.0 Appendix B and KHR_materials_specular
    with specularColor = 1-γ): ``mix((1-F_d) kd/π + F_d D V, F_m D V, m)`` with F0 = 0.04 (1-γ) for the
    dielectric and ``(1-γ) kd`` for the metal. In both α = roughness² and F90 = 1.

    Parameters
    ----------
    base_color : mi.Color3f or mi.Spectrum
        Linear reflectance kd.
    gamma, roughness, metallic : mi.Float
        In [0, 1]; γ scales the specular reflectance away, roughness is kept above
        :data:`MIN_ROUGHNESS`.
    n, wi, wo : mi.Vector3f
        Shading normal (already turned by :func:`face_viewer`), viewer and light directions.
    lobes : (bool, bool)
        Whether the diffuse and the glossy one are wanted; both together are their sum.
    """
    diffuse, glossy = lobes
    cos_i, cos_o = dr.dot(n, wi), dr.dot(n, wo)
    h = wi + wo
    h *= dr.rsqrt(dr.maximum(dr.squared_norm(h), 1e-12))
    cos_d = dr.dot(wi, h)
    alpha2 = dr.square(dr.square(dr.maximum(roughness, MIN_ROUGHNESS)))
    lit = cos_o > 0
    lobe = ggx_d(alpha2, n, h) * smith_v(alpha2, dr.maximum(cos_i, 1e-4), dr.maximum(cos_o, 1e-4)) if glossy else 0.0
    albedo = base_color if diffuse else type(base_color)(0)
    if form == "paper":
        ks = (1 - gamma) * dr.lerp(type(base_color)(DIELECTRIC_F0), base_color, metallic)
        value = albedo * (1 - metallic) * dr.inv_pi + schlick(ks, cos_d) * lobe
    else:
        f_dielectric = schlick(DIELECTRIC_F0 * (1 - gamma), cos_d)
        f_metal = schlick(base_color * (1 - gamma), cos_d)
        dielectric = dr.fma(albedo, (1 - f_dielectric) * dr.inv_pi, f_dielectric * lobe)
        value = dr.lerp(dielectric, f_metal * lobe, metallic)
    return dr.select(lit, value * cos_o, 0)


def specular_share(base_color, gamma, metallic, cos_i):
    """
    Probability of sampling the specular lobe: its share of the reflectance at ``cos_i``, in [.1, 1].
    """
    luminance = mi.luminance(base_color) if mi.is_rgb else dr.mean(base_color, axis=0)
    f0 = (1 - gamma) * dr.lerp(mi.Float(DIELECTRIC_F0), luminance, metallic)
    specular = schlick(f0, dr.maximum(cos_i, 0))
    diffuse = luminance * (1 - metallic)
    return dr.clip(specular / dr.maximum(specular + diffuse, 1e-6), 0.1, 1)


def visible_normal_pdf(alpha2, n, wi, h):
    """
    Solid-angle density of ``wo`` when the half vector is drawn from the visible normals.
    """
    cos_i = dr.dot(n, wi)
    return ggx_d(alpha2, n, h) * smith_g1(alpha2, cos_i) / dr.maximum(4 * cos_i, 1e-7)


def sample_visible_normal(alpha, wi, sample):
    """
    Draw a half vector from the GGX normals visible from ``wi`` (Heitz 2018), local frame.

    Parameters
    ----------
    alpha : mi.Float
    wi : mi.Vector3f
        Local direction with ``wi.z > 0``.
    sample : mi.Point2f
        Uniform in the unit square.
    """
    v = dr.normalize(mi.Vector3f(alpha * wi.x, alpha * wi.y, wi.z))
    s, t = mi.coordinate_system(v)
    p = mi.warp.square_to_uniform_disk_concentric(sample)
    half = 0.5 * (1 + v.z)
    y = dr.lerp(dr.safe_sqrt(1 - dr.square(p.x)), p.y, half)
    # The projected disk is measured in the frame whose t axis leans towards the pole.
    t1 = dr.select(v.z < 0.9999, dr.normalize(dr.cross(mi.Vector3f(0, 0, 1), v)), s)
    t2 = dr.select(v.z < 0.9999, dr.cross(v, t1), t)
    h = t1 * p.x + t2 * y + v * dr.safe_sqrt(1 - dr.square(p.x) - dr.square(y))
    return dr.normalize(mi.Vector3f(alpha * h.x, alpha * h.y, dr.maximum(h.z, 1e-6)))
