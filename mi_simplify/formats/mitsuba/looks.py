"""
What Mitsuba's BSDFs look like, one function a plugin, as far as a metallic-roughness material can say it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .field import Field, vectors
from .file import Node
from .look import DEFAULT, WHITE, Look, texture_transform
from .material import Materials


def _diffuse(node: Node, materials: Materials) -> Look:
    return materials.base(node, "reflectance", roughness=DEFAULT.roughness)


def _roughness(node: Node, materials: Materials) -> Field:
    """Perceptual roughness from α, that of both axes where there are two."""
    if "alpha_u" in node.values or node.child("alpha_u"):
        materials.note(node, "is anisotropic; it starts isotropic")
        alphas = [materials.scalar(node, "alpha_u", 0.1), materials.scalar(node, "alpha_v", 0.1)]
        return Field.of(lambda a, b: np.sqrt(np.sqrt(np.maximum(a * b, 0))), *alphas)
    return Field.of(lambda a: np.sqrt(np.maximum(a, 0)), materials.scalar(node, "alpha", 0.1))


def _plastic(node: Node, materials: Materials) -> Look:
    roughness = Field.constant(0.0) if node.plugin == "plastic" else _roughness(node, materials)
    materials.note(node, "starts as Lambert and GGX of reflectance 0.04")
    return materials.base(node, "diffuse_reflectance", roughness=roughness)


def _conductor(node: Node, materials: Materials) -> Look:
    def at_normal_incidence(eta: np.ndarray, k: np.ndarray, scale: np.ndarray) -> np.ndarray:
        return scale * ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)

    inputs = [materials.color(node, n, d) for n, d in (("eta", 0.0), ("k", 1.0), ("specular_reflectance", 1.0))]
    roughness = Field.constant(0.0) if node.plugin == "conductor" else _roughness(node, materials)
    return Look(color=Field.of(at_normal_incidence, *inputs), roughness=roughness, metallic=Field.constant(1.0))


def _dielectric(node: Node, materials: Materials) -> Look:
    materials.note(node, "lets light through by refraction; it starts opaque and grey")
    rough = node.plugin == "roughdielectric"
    return Look(roughness=_roughness(node, materials) if rough else Field.constant(0.0))


#: Lobes of `principled` that have no counterpart here.
_LOBES = ("anisotropic", "clearcoat", "sheen", "spec_tint", "spec_trans", "flatness", "diff_trans")


def _principled(node: Node, materials: Materials) -> Look:
    left_out = [name for name in _LOBES if name in node.values or node.child(name)]
    if left_out:
        materials.note(node, f"starts without its {', '.join(left_out)}")
    specular = node.values.get("specular", 0.5)
    if "eta" in node.values:
        eta = node.values["eta"]
        specular = ((eta - 1) / (eta + 1)) ** 2 / 0.08
    return materials.base(
        node,
        "base_color",
        gamma=Field.constant(float(np.clip(1 - 2 * specular, 0, 1))),  # F0 = 0.08 specular = 0.04 (1 - γ)
        roughness=materials.scalar(node, "roughness", 0.5),
        metallic=materials.scalar(node, "metallic", 0.0),
    )


def _ggx_gamma(node: Node, materials: Materials) -> Look:
    if node.values.get("form", "gltf") != "gltf":
        materials.note(
            node, f"mixes its lobes in the form '{node.values['form']}'; see `latent.shading` for the result's"
        )
    normal = node.child("normal_map")
    return materials.base(
        node,
        "base_color",
        gamma=materials.scalar(node, "gamma", 0.0),
        roughness=materials.scalar(node, "roughness", 0.5),
        metallic=materials.scalar(node, "metallic", 0.0),
        opacity=materials.scalar(node, "opacity", 1.0),
        normal=None if normal is None else _normals(normal, materials),
        normal_follows_charts=True,
        cutoff=float(node.values.get("opacity_cutoff", 0.0)),
    )


def _normals(texture: Node, materials: Materials) -> Field:
    field = vectors(materials.file.make(texture), texture_transform(texture))
    return Field.of(lambda rgb: 2 * rgb - 1, field)


def _twosided(node: Node, materials: Materials) -> Look:
    if len(node.of_kind("BSDF")) > 1:
        materials.note(node, "has a BSDF for each side; both start as its front")
    return materials.nested(node)


def _mask(node: Node, materials: Materials) -> Look:
    return replace(materials.nested(node), opacity=materials.scalar(node, "opacity", 0.5))


def _normalmap(node: Node, materials: Materials) -> Look:
    texture = node.child("normalmap")
    assert texture is not None, "Mitsuba has made this BSDF, so it has its map"
    return replace(materials.nested(node), normal=_normals(texture, materials))


def _bumpmap(node: Node, materials: Materials) -> Look:
    materials.note(node, "starts without its bump map")
    return materials.nested(node)


def _blend(node: Node, materials: Materials) -> Look:
    first, second = (materials.look(bsdf) for bsdf in node.of_kind("BSDF")[:2])
    weight = materials.scalar(node, "weight", 0.5)
    materials.note(node, "is a blend of two BSDFs; it starts with the blend of their parameters")

    def mixed(a: Field, b: Field) -> Field:
        return Field.of(lambda x, y, w: x + (y - x) * w, a, b, weight)

    one = Field.constant(1.0)
    see_through = first.opacity is not None or second.opacity is not None
    return Look(
        color=mixed(first.color, second.color),
        gamma=mixed(first.gamma, second.gamma),
        roughness=mixed(first.roughness, second.roughness),
        metallic=mixed(first.metallic, second.metallic),
        opacity=mixed(first.opacity or one, second.opacity or one) if see_through else None,
        normal=first.normal,
        normal_follows_charts=first.normal_follows_charts,
        at_vertices=first.at_vertices and second.at_vertices,
    )


def _null(node: Node, materials: Materials) -> Look:
    return Look(has_surface=False)


def unknown(node: Node, materials: Materials) -> Look:
    """
    The look of a plugin that is not in :data:`LOOKS`.
    """
    materials.note(node, "has no counterpart; it starts with its diffuse reflectance at the vertices")
    return Look(color=WHITE, at_vertices=True)


#: By plugin.
LOOKS: dict[str, Callable[[Node, Materials], Look]] = {
    "diffuse": _diffuse,
    "plastic": _plastic,
    "roughplastic": _plastic,
    "pplastic": _plastic,
    "conductor": _conductor,
    "roughconductor": _conductor,
    "dielectric": _dielectric,
    "roughdielectric": _dielectric,
    "thindielectric": _dielectric,
    "principled": _principled,
    "principledthin": _principled,
    "ggx_gamma": _ggx_gamma,
    "twosided": _twosided,
    "mask": _mask,
    "normalmap": _normalmap,
    "bumpmap": _bumpmap,
    "blendbsdf": _blend,
    "null": _null,
}


def look_of(node: Node, materials: Materials) -> Look:
    """
    What a BSDF looks like, by its plugin; that of a grey surface, with a note, where the plugin is not known.
    """
    return LOOKS.get(node.plugin, unknown)(node, materials)
