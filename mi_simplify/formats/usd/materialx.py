"""
MaterialX surfaces in USD: the inputs of standard_surface, open_pbr_surface and gltf_pbr that have an equal here.
"""

from __future__ import annotations

import numpy as np
from pxr import UsdShade

from ...model.asset import Material
from ..images import constant, join_channels, opacity, rgb, to_float, unit_normals
from ..mapping import Mapping, Mappings
from ..resources import Resources
from .shaders import image_of, plain, source_of

#: Of each surface, by what it becomes: names of inputs, and their values where nothing is said.
_SURFACES: dict[str, dict[str, tuple[str, float | tuple[float, ...]]]] = {
    "ND_standard_surface_surfaceshader": {
        "color": ("base_color", (0.8, 0.8, 0.8)), "weight": ("base", 1.0), "roughness": ("specular_roughness", 0.2),
        "metallic": ("metalness", 0.0), "opacity": ("opacity", 1.0), "glow": ("emission", 0.0),
        "glow_color": ("emission_color", (1.0, 1.0, 1.0)), "normal": ("normal", 0.0), "coat": ("coat", 0.0),
        "coat_roughness": ("coat_roughness", 0.1),
    },
    "ND_open_pbr_surface_surfaceshader": {
        "color": ("base_color", (0.8, 0.8, 0.8)), "weight": ("base_weight", 1.0),
        "roughness": ("specular_roughness", 0.3), "metallic": ("base_metalness", 0.0),
        "opacity": ("geometry_opacity", 1.0), "glow": ("emission_luminance", 0.0),
        "glow_color": ("emission_color", (1.0, 1.0, 1.0)), "normal": ("geometry_normal", 0.0),
        "coat": ("coat_weight", 0.0), "coat_roughness": ("coat_roughness", 0.0),
    },
    "ND_gltf_pbr_surfaceshader": {
        "color": ("base_color", (1.0, 1.0, 1.0)), "roughness": ("roughness", 1.0), "metallic": ("metallic", 1.0),
        "opacity": ("alpha", 1.0), "glow": ("emissive_strength", 1.0), "glow_color": ("emissive", (0.0, 0.0, 0.0)),
        "normal": ("normal", 0.0), "coat": ("clearcoat", 0.0), "coat_roughness": ("clearcoat_roughness", 0.0),
    },
}  # fmt: skip

#: Candelas per square metre of radiance 1: open_pbr_surface measures luminance.
_NITS = 1000.0

_IMAGES = ("ND_image_", "ND_tiledimage_", "ND_gltf_image_", "ND_gltf_colorimage")


def is_known(shader: UsdShade.Shader | None) -> bool:
    """Whether a surface is one of MaterialX that can be read."""
    return shader is not None and bool(shader) and str(shader.GetShaderId()) in _SURFACES


def read_materialx(
    shader: UsdShade.Shader, name: str, resources: Resources
) -> tuple[Material, tuple[Mapping, ...], str | None]:
    """
    A surface as :func:`.material.read_usd_material` reads one.
    """
    reader = _Reader(shader, name, resources)
    material = reader.read()
    resources.note(f"material '{name}' is of MaterialX ({shader.GetShaderId()}); what has no equal here was left out")
    return material, reader.mappings.places, None


class _Reader:
    def __init__(self, shader: UsdShade.Shader, name: str, resources: Resources):
        self.shader, self.name, self.resources = shader, name, resources
        self.inputs = _SURFACES[str(shader.GetShaderId())]
        self.mappings = Mappings()

    def read(self) -> Material:
        color = self._value("color", "base_color", 3)
        if "weight" in self.inputs:
            color = join_channels(color, self._value("weight", "base_color", 1))
            color = color[..., :3] * color[..., 3:]
        alpha = self._value("opacity", "base_color", 1)
        glow = join_channels(self._value("glow_color", "emission", 3), self._value("glow", "emission", 1))
        nits = _NITS if "emission_luminance" in self.inputs["glow"] else 1.0
        emission = np.maximum(glow[..., :3] * glow[..., 3:] / nits, 0)
        return Material(
            name=self.name,
            base_color=np.clip(join_channels(color, alpha), 0, 1),
            specular=np.clip(
                join_channels(
                    constant(0), self._value("roughness", "specular", 1), self._value("metallic", "specular", 1)
                ),
                0, 1,
            ),
            normal=self._normal(),
            alpha_mode="BLEND" if alpha.min() < 1 else "OPAQUE",
            emission=emission if emission.any() else None,
            lobes=self._lobes(),
            lookups=self.mappings.lookups,
        )  # fmt: skip

    def _lobes(self) -> dict:
        coat, roughness = (float(self._value(k, "specular", 1).mean()) for k in ("coat", "coat_roughness"))
        if coat <= 0:
            return {}
        return {"KHR_materials_clearcoat": {"clearcoatFactor": coat, "clearcoatRoughnessFactor": roughness}}

    def _value(self, what: str, texture: str, n: int) -> np.ndarray:
        """An input as a linear image of ``n`` channels."""
        key, default = self.inputs[what]
        found = self._image(key, texture, srgb=n == 3)
        if found is None:
            value = np.atleast_1d(np.asarray(plain(self.shader, key, default), np.float32))
            return constant(*(np.resize(value, n) if len(value) == 1 else value[:n]))
        return rgb(found) if n == 3 else found[..., :1]

    def _normal(self) -> np.ndarray | None:
        key, _ = self.inputs["normal"]
        node = source_of(self.shader, key)
        if node is None:
            return None
        if str(node[0].GetShaderId()).startswith("ND_normalmap"):
            found = self._image("in", "normal", srgb=False, shader=node[0])
        else:
            found = self._image(key, "normal", srgb=False)
        return None if found is None else unit_normals(rgb(found) * 2 - 1)

    def _image(self, key: str, texture: str, *, srgb: bool, shader: UsdShade.Shader | None = None) -> np.ndarray | None:
        """The image behind an input, linear; None where there is none that can be read."""
        node = source_of(self.shader if shader is None else shader, key)
        if node is None:
            return None
        image, kind = node[0], str(node[0].GetShaderId())
        if not kind.startswith(_IMAGES):
            self.resources.note(f"'{key}' of material '{self.name}' comes from '{kind}', which is not supported")
            return None
        wraps = tuple(
            {"clamp": "clamp", "constant": "clamp", "mirror": "mirror"}.get(str(plain(image, k, "periodic")), "repeat")
            for k in ("uaddressmode", "vaddressmode")
        )
        if not self.mappings.take(texture, Mapping(self._coordinates(image), None, (wraps[0], wraps[1]))):
            self.resources.note(
                f"'{key}' of material '{self.name}' was left out: its coordinates are not those of the texture that it "
                "is joined with"
            )
            return None
        pixels = image_of(image, key, self.name, self.resources)
        alpha = opacity(pixels)
        values = to_float(pixels, srgb=srgb and pixels.dtype == np.uint8)
        return values if alpha is None or srgb else values[..., : max(values.shape[2] - 1, 1)]

    def _coordinates(self, image: UsdShade.Shader) -> str:
        """The primvar that an image is looked up by."""
        node = source_of(image, "texcoord")
        if node is None:
            return "st"
        return str(plain(node[0], "geomprop", plain(node[0], "varname", "st")))
