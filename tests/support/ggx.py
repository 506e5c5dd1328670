"""What the tests of ggx_gamma share: a slow reference, written from the specification, and ways to evaluate."""

import drjit as dr
import mitsuba as mi
import numpy as np

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
    f0 = (1 - gamma) * base_color  # a metal's γ belongs into the base colour
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
