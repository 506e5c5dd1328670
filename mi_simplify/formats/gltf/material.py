"""
glTF materials: metallic-roughness with ``KHR_materials_specular``, ``KHR_texture_transform`` and vertex colours.
"""

from __future__ import annotations

import numpy as np

from ...errors import AssetError
from ...model.asset import Material
from ..images import constant, join_channels, opacity, rgb, to_float, unit_normals
from ..mapping import Mapping
from .file import GltfFile

#: What is left out of a material, by extension.
_LEFT_OUT = {
    "KHR_materials_clearcoat": "clear coat", "KHR_materials_sheen": "sheen",
    "KHR_materials_transmission": "transmission", "KHR_materials_volume": "volume",
    "KHR_materials_iridescence": "iridescence", "KHR_materials_anisotropy": "anisotropy",
    "KHR_materials_ior": "index of refraction", "KHR_materials_unlit": "'unlit' (it is lit)",
    "KHR_materials_dispersion": "dispersion", "KHR_materials_diffuse_transmission": "diffuse transmission",
    "KHR_materials_subsurface": "subsurface scattering",
}  # fmt: skip

_WRAPS = {10497: "repeat", 33648: "mirror", 33071: "clamp"}


def read_material(file: GltfFile, index: int | None) -> tuple[Material, Mapping | None]:
    """
    A material and where its textures are looked up; without an index the house's default, not glTF's metal.

    Parameters
    ----------
    index : int or None

    Returns
    -------
    material : Material
    mapping : Mapping or None
        None where the material has no texture.
    """
    if index is None:
        return Material(), None
    source = file.item("materials", index)
    reader = _MaterialReader(file, source, source.get("name") or f"material_{index}")
    return reader.read(), reader.mapping


class _MaterialReader:
    def __init__(self, file: GltfFile, source: dict, name: str):
        self.file, self.source, self.name = file, source, name
        self.mapping: Mapping | None = None

    def read(self) -> Material:
        source, extensions = self.source, self.source.get("extensions") or {}
        if "pbrMetallicRoughness" not in source and "KHR_materials_pbrSpecularGlossiness" in extensions:
            base, roughness_metallic = self._specular_glossiness(extensions["KHR_materials_pbrSpecularGlossiness"])
        else:
            base, roughness_metallic = self._metallic_roughness(source.get("pbrMetallicRoughness") or {})
        specular = join_channels(constant(0), roughness_metallic)
        if "KHR_materials_specular" in extensions:
            base, specular = _with_gamma(base, specular, self._specular_color(extensions["KHR_materials_specular"]))
        info = source.get("normalTexture")
        pixels = self._texture(info, "normal map")
        normal = None
        if info and pixels is not None:
            normal = unit_normals(to_float(rgb(pixels), srgb=False) * 2 - 1, float(self._numbers(info, "scale", 1)[0]))
        for extension, meaning in _LEFT_OUT.items():
            if extension in extensions:
                self._note(f"{meaning} of material '{self.name}' was left out")
        if source.get("occlusionTexture"):
            self._note(f"occlusion of material '{self.name}' was left out")
        if any(source.get("emissiveFactor") or ()):
            self._note(f"emission of material '{self.name}' was left out")
        return Material(
            name=self.name,
            base_color=np.clip(base, 0, 1),
            specular=np.clip(specular, 0, 1),
            normal=normal,
            alpha_mode=self._alpha_mode(),
            alpha_cutoff=float(self._numbers(source, "alphaCutoff", 0.5)[0]),
        )

    def _alpha_mode(self) -> str:
        mode = self.source.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise AssetError(f"{self.file.name}: material '{self.name}' has the unknown alphaMode '{mode}'")
        return mode

    def _metallic_roughness(self, pbr: dict) -> tuple[np.ndarray, np.ndarray]:
        """Base colour and opacity, and (roughness, metallic), each shape (H, W, C)."""
        base = self._color(pbr.get("baseColorTexture"), self._numbers(pbr, "baseColorFactor", [1] * 4), "base colour")
        factor = np.concatenate([self._numbers(pbr, "roughnessFactor", 1), self._numbers(pbr, "metallicFactor", 1)])
        pixels = self._texture(pbr.get("metallicRoughnessTexture"), "metallic-roughness texture")
        if pixels is None:
            return base, factor.reshape(1, 1, 2)
        return base, to_float(rgb(pixels)[..., 1:3], srgb=False) * factor

    def _specular_glossiness(self, pbr: dict) -> tuple[np.ndarray, np.ndarray]:
        """The retired workflow: its specular colour has no place here, its glossiness has."""
        self._note(f"specular colour of material '{self.name}' (KHR_materials_pbrSpecularGlossiness) was left out")
        base = self._color(pbr.get("diffuseTexture"), self._numbers(pbr, "diffuseFactor", [1] * 4), "diffuse texture")
        glossiness = constant(*self._numbers(pbr, "glossinessFactor", 1))
        pixels = self._texture(pbr.get("specularGlossinessTexture"), "specular-glossiness texture")
        alpha = None if pixels is None else opacity(pixels)
        if alpha is not None:
            glossiness = glossiness * to_float(alpha, srgb=False)
        return base, join_channels(1 - glossiness, constant(0))

    def _numbers(self, source: dict, key: str, default: object) -> np.ndarray:
        """Finite numbers of a material, shape (N,), within what textures and float32 can hold."""
        values = np.atleast_1d(np.asarray(source.get(key, default), np.float64))
        if not np.isfinite(values).all():
            raise AssetError(f"{self.file.name}: {key} of material '{self.name}' is not finite; export the file again")
        return np.clip(values, -65504, 65504).astype(np.float32)

    def _color(self, info: dict | None, factor: np.ndarray, what: str) -> np.ndarray:
        """Linear colour and opacity, shape (H, W, 4)."""
        factor = factor.reshape(1, 1, 4)
        pixels = self._texture(info, what)
        if pixels is None:
            return factor
        values = to_float(pixels, srgb=True)
        alpha = opacity(values)
        return join_channels(rgb(values), constant(1) if alpha is None else alpha) * factor

    def _specular_color(self, specular: dict) -> np.ndarray:
        """
        Mean of the specular colour's channels, shape (H, W, 1).

        ``specularFactor`` scales F90 as well, for which there is no parameter; it is folded in.
        """
        strength = constant(*self._numbers(specular, "specularFactor", 1))
        pixels = self._texture(specular.get("specularTexture"), "specular texture")
        alpha = None if pixels is None else opacity(pixels)
        if alpha is not None:
            strength = strength * to_float(alpha, srgb=False)
        color = self._numbers(specular, "specularColorFactor", [1] * 3).reshape(1, 1, 3)
        if color.max() > 1:
            self._note(f"specularColorFactor of material '{self.name}' is above 1 and was taken as 1")
        pixels = self._texture(specular.get("specularColorTexture"), "specular colour texture")
        if pixels is not None:
            color = color * to_float(rgb(pixels), srgb=True)
        return np.clip(join_channels(color.mean(axis=2, keepdims=True), strength).prod(axis=2, keepdims=True), 0, 1)

    def _texture(self, info: dict | None, what: str) -> np.ndarray | None:
        """
        The decoded image of a texture reference, or None; the first one of a material fixes its mapping.
        """
        if not info:
            return None
        texture = self.file.item("textures", info.get("index"))
        extensions = texture.get("extensions") or {}
        sources = [(extensions.get(f"EXT_texture_{kind}") or {}).get("source") for kind in ("webp", "avif")]
        sources += [texture.get("source"), (extensions.get("KHR_texture_basisu") or {}).get("source")]
        source = next((s for s in sources if s is not None), None)
        if source is None:
            kind = ", ".join(extensions) or "no source"
            raise AssetError(
                f"{self.file.name}: the {what} of material '{self.name}' has no image that can be read ({kind}); "
                "convert it to PNG or JPEG"
            )
        mapping = _mapping(info, self._wraps(texture))
        if self.mapping is None:
            self.mapping = mapping
        elif not mapping.same_place(self.mapping):
            self._note(f"{what} of material '{self.name}' was left out: its coordinates are not the first texture's")
            return None
        return self.file.image(source)

    def _wraps(self, texture: dict) -> tuple[str, str]:
        sampler = self.file.item("samplers", texture["sampler"]) if texture.get("sampler") is not None else {}
        return _WRAPS.get(sampler.get("wrapS", 10497), "repeat"), _WRAPS.get(sampler.get("wrapT", 10497), "repeat")

    def _note(self, line: str) -> None:
        self.file.resources.note(line)


def _mapping(info: dict, wraps: tuple[str, str]) -> Mapping:
    transform = (info.get("extensions") or {}).get("KHR_texture_transform")
    if transform is None:
        return Mapping(info.get("texCoord", 0), None, wraps)
    (u, v), (su, sv) = transform.get("offset", (0, 0)), transform.get("scale", (1, 1))
    angle = float(transform.get("rotation", 0))
    c, s = np.cos(angle), np.sin(angle)
    # KHR_texture_transform: translation · rotation · scale, with v pointing down.
    matrix = np.array([[c * su, s * sv, u], [-s * su, c * sv, v]], np.float64)
    return Mapping(transform.get("texCoord", info.get("texCoord", 0)), matrix, wraps)


def _with_gamma(base: np.ndarray, specular: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Base colour and (γ, roughness, metallic) that reflect as glTF's base colour, metalness and specular colour do.

    In glTF the specular colour s tints the dielectric share alone, while γ weakens the whole lobe. Diffuse reflectance
    and both F0 agree with ``γ = 1 - s/k``, ``m k²/s`` for the metalness m and ``kd/k`` for the base colour kd, where
    ``m/s k² + (1-m) k = 1``.
    """
    joined = join_channels(base, specular, color)
    base, specular, metallic, s = joined[..., :4].copy(), joined[..., 4:7].copy(), joined[..., 6], joined[..., 7]
    s = np.where(metallic < 1 - 0.5 / 255, np.maximum(s, 1e-6), 1)  # a metal has no dielectric share
    b = 1 - metallic
    k = 2 / (b + np.sqrt(b**2 + 4 * metallic / s))
    base[..., :3] /= k[..., None]
    specular[..., 0], specular[..., 2] = 1 - s / k, metallic * k**2 / s
    return base, specular
