"""
USD materials: UsdPreviewSurface with its texture, primvar and transform nodes.
"""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdShade

from ...model.asset import Material
from ..images import constant, join_channels, opacity, rgb, to_float, unit_normals
from ..mapping import Mapping, Mappings
from ..resources import Resources
from .materialx import is_known, read_materialx
from .shaders import image_of, plain, source_of

_DEFAULTS = {
    "diffuseColor": (0.18, 0.18, 0.18), "roughness": 0.5, "metallic": 0.0, "opacity": 1.0,
    "emissiveColor": (0.0, 0.0, 0.0), "occlusion": 1.0,
}  # fmt: skip
#: Which texture of a material an input becomes, or joins.
_TEXTURES = {
    "diffuseColor": "base_color", "opacity": "base_color", "roughness": "specular", "metallic": "specular",
    "normal": "normal", "emissiveColor": "emission", "occlusion": "occlusion",
}  # fmt: skip
_CHANNELS = {"r": [0], "g": [1], "b": [2], "a": [3], "rgb": [0, 1, 2], "rgba": [0, 1, 2]}


def bound_material(prim: Usd.Prim) -> UsdShade.Material | None:
    """
    What a prim looks like in a preview, else in a full render; None where nothing is bound.
    """
    for purpose in ("preview", "full"):
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(purpose)[0]
        if material:
            return material
    return None


def material_path(material: UsdShade.Material | None) -> str:
    """
    A name that all instances of a material share; empty for None.
    """
    if material is None:
        return ""
    prim = material.GetPrim()
    return str((prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath())


def read_usd_material(
    material: UsdShade.Material, resources: Resources
) -> tuple[Material, tuple[Mapping, ...], str | None]:
    """
    A UsdPreviewSurface as a material.

    Returns
    -------
    material : Material
        The default where the prim has no UsdPreviewSurface, with a note.
    places : tuple of Mapping
        The coordinates that the material's lookups number, USD's own (origin bottom left); empty without textures.
    color_primvar : str or None
        The primvar that the diffuse colour is read from; the base colour is white then.
    """
    name = material.GetPrim().GetName()
    shader = material.ComputeSurfaceSource()[0]
    foreign = material.ComputeSurfaceSource("mtlx")[0]
    if (not shader or shader.GetShaderId() != "UsdPreviewSurface") and is_known(foreign or shader):
        return read_materialx(foreign or shader, name, resources)
    if not shader or shader.GetShaderId() != "UsdPreviewSurface":
        kind = f"'{shader.GetShaderId()}'" if shader else "none that this build of USD can read"
        resources.note(f"material '{name}' has no UsdPreviewSurface (its surface is {kind}); the default grey is used")
        return Material(), (), None
    reader = _Reader(shader, name, resources)
    return reader.read(), reader.mappings.places, reader.color_primvar


class _Reader:
    def __init__(self, shader: UsdShade.Shader, name: str, resources: Resources):
        self.shader, self.name, self.resources = shader, name, resources
        self.mappings = Mappings()
        self.color_primvar: str | None = None

    def read(self) -> Material:
        color = self._value("diffuseColor", color=True)
        alpha = self._value("opacity")
        roughness, metallic = self._value("roughness"), self._value("metallic")
        if plain(self.shader, "useSpecularWorkflow", 0):
            self._note("specular workflow", "its specular colour was left out")
            metallic = constant(0)
        threshold = float(plain(self.shader, "opacityThreshold", 0.0))
        mode = "MASK" if threshold > 0 else "BLEND" if alpha.size > 1 or alpha.max() < 1 else "OPAQUE"
        emission = np.maximum(self._value("emissiveColor", color=True), 0)
        occlusion = np.clip(self._value("occlusion"), 0, 1)
        for key, neutral in (("displacement", 0),):
            source = source_of(self.shader, key)
            value = plain(self.shader, key, neutral)
            if source is not None or (value is not None and np.any(np.asarray(value, float) != neutral)):
                self._note(key, "was left out")
        return Material(
            name=self.name,
            base_color=np.clip(join_channels(color, alpha), 0, 1),
            specular=np.clip(join_channels(constant(0), roughness, metallic), 0, 1),
            normal=self._normal(),
            alpha_mode=mode,
            alpha_cutoff=threshold if threshold > 0 else 0.5,
            emission=emission if emission.any() else None,
            occlusion=occlusion if (occlusion < 1).any() else None,
            lobes=self._lobes(),
            lookups=self.mappings.lookups,
        )

    def _lobes(self) -> dict:
        """Clear coat and index of refraction by the names of glTF."""
        out: dict = {}
        coat = {"clearcoatFactor": "clearcoat", "clearcoatRoughnessFactor": "clearcoatRoughness"}
        if any(source_of(self.shader, key) for key in coat.values()):
            self._note("clearcoat", "comes from a texture, which was left out")
        elif (strength := float(plain(self.shader, "clearcoat", 0.0))) > 0:
            roughness = float(plain(self.shader, "clearcoatRoughness", 0.01))
            out["KHR_materials_clearcoat"] = dict(zip(coat, (strength, roughness), strict=True))
            self._note("clearcoat", "is carried over, but not shown here")
        if (ior := float(plain(self.shader, "ior", 1.5))) != 1.5:
            out["KHR_materials_ior"] = {"ior": ior}
        return out

    def _value(self, key: str, color: bool = False) -> np.ndarray:
        """An input as a linear image, shape (H, W, 3) for colours, else (H, W, 1)."""
        source = source_of(self.shader, key)
        if source is None:
            return constant(*np.atleast_1d(np.asarray(plain(self.shader, key, _DEFAULTS[key]), np.float32)))
        shader, output = source
        kind = shader.GetShaderId()
        if kind == "UsdUVTexture":
            found = self._texture(shader, key, is_color=color)
            if found is None:
                return constant(*np.atleast_1d(np.array(_DEFAULTS[key], np.float32)))
            channels = found[..., _CHANNELS.get(output, [0])]
            return rgb(channels) if color else channels[..., :1]
        if kind in ("UsdPrimvarReader_float3", "UsdPrimvarReader_float4", "UsdPrimvarReader_vector") and color:
            self.color_primvar = str(plain(shader, "varname", "displayColor"))
            return constant(1, 1, 1)
        self._note(key, f"comes from '{kind}', which is not supported; its default is used")
        return constant(*np.atleast_1d(np.array(_DEFAULTS[key], np.float32)))

    def _normal(self) -> np.ndarray | None:
        source = source_of(self.shader, "normal")
        if source is None:
            return None
        shader, _ = source
        if shader.GetShaderId() != "UsdUVTexture":
            self._note("normal", f"comes from '{shader.GetShaderId()}', which is not supported; it was left out")
            return None
        unscaled = plain(shader, "scale", None) is None and plain(shader, "bias", None) is None
        vectors = self._texture(shader, "normal", is_color=False)
        if vectors is None:
            return None
        vectors = vectors[..., :3]
        if unscaled and vectors.min() >= 0:
            self._note("normal", "has neither scale nor bias; 2 and -1 were taken")
            vectors = vectors * 2 - 1
        return unit_normals(vectors)

    def _texture(self, shader: UsdShade.Shader, key: str, is_color: bool) -> np.ndarray | None:
        """
        A texture with scale and bias, linear, shape (H, W, 4); None where its coordinates are not those of the texture
        that it has to join.
        """
        if not self.mappings.take(_TEXTURES[key], self._mapping(shader)):
            self._note(key, "was left out: its coordinates are not those of the texture that it is joined with")
            return None
        pixels = image_of(shader, key, self.name, self.resources)
        space = str(plain(shader, "sourceColorSpace", "auto"))
        # 'auto' means sRGB for 8 bits and three channels; files that leave it on a data texture never mean that.
        srgb = space == "sRGB" or (space == "auto" and is_color and pixels.dtype == np.uint8 and pixels.shape[2] >= 3)
        values = to_float(pixels, srgb=srgb)
        alpha = opacity(values)
        values = join_channels(rgb(values), constant(1) if alpha is None else alpha)
        scale, bias = plain(shader, "scale", (1, 1, 1, 1)), plain(shader, "bias", (0, 0, 0, 0))
        if tuple(scale) != (1, 1, 1, 1) or tuple(bias) != (0, 0, 0, 0):
            values = values * np.array(tuple(scale), np.float32) + np.array(tuple(bias), np.float32)
        return values

    def _mapping(self, shader: UsdShade.Shader) -> Mapping:
        transform = None
        source = source_of(shader, "st")
        while source is not None and source[0].GetShaderId() == "UsdTransform2d":
            node = source[0]
            angle = np.radians(float(plain(node, "rotation", 0.0)))
            (su, sv), (tu, tv) = plain(node, "scale", (1, 1)), plain(node, "translation", (0, 0))
            c, s = np.cos(angle), np.sin(angle)
            step = np.array([[c * su, -s * sv, tu], [s * su, c * sv, tv], [0, 0, 1]])
            # The node nearest to the texture acts last.
            transform = step if transform is None else transform @ step
            source = source_of(node, "in")
        varname = "st"
        if source is not None and source[0].GetShaderId() == "UsdPrimvarReader_float2":
            varname = str(plain(source[0], "varname", "st"))
        wraps = _wrap(shader, "wrapS"), _wrap(shader, "wrapT")
        return Mapping(varname, None if transform is None else transform[:2], wraps)

    def _note(self, what: str, line: str) -> None:
        self.resources.note(f"'{what}' of material '{self.name}' {line}")


def _wrap(shader: UsdShade.Shader, key: str) -> str:
    found = str(plain(shader, key, "repeat"))
    return {"black": "clamp"}.get(found, found) if found in ("mirror", "clamp", "black") else "repeat"


def display_material(color: np.ndarray | None, alpha: np.ndarray | None) -> Material:
    """
    The material of a mesh without one, from its constant ``displayColor`` and ``displayOpacity`` (linear), if any.
    """
    if color is None and alpha is None:
        return Material()
    base = Material().base_color.copy()
    if color is not None:
        base[..., :3] = np.clip(color, 0, 1)
    if alpha is not None:
        base[..., 3] = np.clip(alpha, 0, 1)
    return Material("displayColor", base_color=base, alpha_mode="BLEND" if base[..., 3].min() < 1 else "OPAQUE")
