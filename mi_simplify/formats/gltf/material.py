"""
glTF materials: metallic-roughness with ``KHR_materials_specular``, ``KHR_texture_transform`` and vertex colours.
"""

from __future__ import annotations

import numpy as np

from ...errors import AssetError
from ...model.asset import Material
from ..images import constant, join_channels, opacity, rgb, to_float, unit_normals
from ..mapping import Mapping, Mappings
from .file import GltfFile

#: Of these the factors are carried over unchanged, by extension; no renderer here shows them.
_LOBES = {
    "KHR_materials_clearcoat": "clear coat", "KHR_materials_sheen": "sheen",
    "KHR_materials_transmission": "transmission", "KHR_materials_volume": "volume",
    "KHR_materials_iridescence": "iridescence", "KHR_materials_anisotropy": "anisotropy",
    "KHR_materials_ior": "index of refraction", "KHR_materials_unlit": "'unlit'",
    "KHR_materials_dispersion": "dispersion", "KHR_materials_diffuse_transmission": "diffuse transmission",
    "KHR_materials_volume_scatter": "subsurface scattering",
}  # fmt: skip

#: Why textures that share one of ours cannot be joined.
_APART = "its texture coordinates are not those of the texture that it is joined with"

_WRAPS = {10497: "repeat", 33648: "mirror", 33071: "clamp"}


def read_material(file: GltfFile, index: int | None) -> tuple[Material, tuple[Mapping, ...]]:
    """
    A material and where its textures are looked up; without an index the house's default, not glTF's metal.

    Parameters
    ----------
    index : int or None

    Returns
    -------
    material : Material
    places : tuple of Mapping
        The coordinates that the material's lookups number; empty where it has no texture.
    """
    if index is None:
        return Material(), ()
    source = file.item("materials", index)
    reader = _MaterialReader(file, source, source.get("name") or f"material_{index}")
    return reader.read(), reader.mappings.places


class _MaterialReader:
    def __init__(self, file: GltfFile, source: dict, name: str):
        self.file, self.source, self.name = file, source, name
        self.mappings = Mappings()

    def read(self) -> Material:
        source, extensions = self.source, self.source.get("extensions") or {}
        if "pbrMetallicRoughness" not in source and "KHR_materials_pbrSpecularGlossiness" in extensions:
            base, roughness_metallic = self._specular_glossiness(extensions["KHR_materials_pbrSpecularGlossiness"])
        else:
            base, roughness_metallic = self._metallic_roughness(source.get("pbrMetallicRoughness") or {})
        specular = join_channels(constant(0), roughness_metallic)
        if "KHR_materials_specular" in extensions:
            color = self._specular_color(extensions["KHR_materials_specular"])
            if self.mappings.same("base_color", "specular"):
                base, specular = _with_gamma(base, specular, color)
            elif specular[..., 2].max() == 0:  # the base colour of a dielectric stays as it is
                specular = _with_gamma(constant(0, 0, 0, 0), specular, color)[1]
            else:
                self._note(f"specular colour of material '{self.name}' was left out: {_APART}")
        info = source.get("normalTexture")
        pixels = self._texture(info, "normal map", "normal")
        normal = None
        if info and pixels is not None:
            normal = unit_normals(to_float(rgb(pixels), srgb=False) * 2 - 1, float(self._numbers(info, "scale", 1)[0]))
        occlusion, emission = self._occlusion(), self._emission(extensions)
        return Material(
            name=self.name,
            base_color=np.clip(base, 0, 1),
            specular=np.clip(specular, 0, 1),
            normal=normal,
            alpha_mode=self._alpha_mode(),
            alpha_cutoff=float(self._numbers(source, "alphaCutoff", 0.5)[0]),
            emission=emission,
            occlusion=occlusion,
            double_sided=bool(source.get("doubleSided", False)),
            lobes=self._lobes(extensions),
            lookups=self.mappings.lookups,
        )

    def _lobes(self, extensions: dict) -> dict:
        """The factors of further lobes, by extension."""
        out: dict = {}
        for extension, meaning in _LOBES.items():
            if not isinstance(found := extensions.get(extension), dict):
                continue
            textures = sorted(key for key in found if key.endswith("Texture"))
            out[extension] = {key: found[key] for key in found if key not in textures and key != "extensions"}
            seen = (
                "carried over, but not shown here" if extension != "KHR_materials_unlit" else "carried over; it is lit"
            )
            self._note(f"{meaning} of material '{self.name}' is {seen}")
            if textures:
                self._note(
                    f"{', '.join(textures)} of material '{self.name}' was left out; the factors are carried over"
                )
        return out

    def _occlusion(self) -> np.ndarray | None:
        """Red of its texture, weakened to its strength, shape (H, W, 1)."""
        info = self.source.get("occlusionTexture")
        pixels = self._texture(info, "occlusion", "occlusion")
        if info is None or pixels is None:
            return None
        strength = np.clip(self._numbers(info, "strength", 1), 0, 1)
        return np.clip(1 + strength * (to_float(pixels[..., :1], srgb=False) - 1), 0, 1)

    def _emission(self, extensions: dict) -> np.ndarray | None:
        """Linear radiance, shape (H, W, 3); None for none."""
        factor = np.maximum(self._numbers(self.source, "emissiveFactor", [0] * 3), 0)
        strength = extensions.get("KHR_materials_emissive_strength") or {}
        factor = factor * np.maximum(self._numbers(strength, "emissiveStrength", 1), 0)
        if not factor.any():
            return None
        pixels = self._texture(self.source.get("emissiveTexture"), "emission", "emission")
        return factor.reshape(1, 1, 3) * (1 if pixels is None else to_float(rgb(pixels), srgb=True))

    def _alpha_mode(self) -> str:
        mode = self.source.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise AssetError(f"{self.file.name}: material '{self.name}' has the unknown alphaMode '{mode}'")
        return mode

    def _metallic_roughness(self, pbr: dict) -> tuple[np.ndarray, np.ndarray]:
        """Base colour and opacity, and (roughness, metallic), each shape (H, W, C)."""
        base = self._color(pbr.get("baseColorTexture"), self._numbers(pbr, "baseColorFactor", [1] * 4), "base colour")
        factor = np.concatenate([self._numbers(pbr, "roughnessFactor", 1), self._numbers(pbr, "metallicFactor", 1)])
        pixels = self._texture(pbr.get("metallicRoughnessTexture"), "metallic-roughness texture", "specular")
        if pixels is None:
            return base, factor.reshape(1, 1, 2)
        return base, to_float(rgb(pixels)[..., 1:3], srgb=False) * factor

    def _specular_glossiness(self, pbr: dict) -> tuple[np.ndarray, np.ndarray]:
        """The retired workflow: its specular colour has no place here, its glossiness has."""
        self._note(f"specular colour of material '{self.name}' (KHR_materials_pbrSpecularGlossiness) was left out")
        base = self._color(pbr.get("diffuseTexture"), self._numbers(pbr, "diffuseFactor", [1] * 4), "diffuse texture")
        glossiness = constant(*self._numbers(pbr, "glossinessFactor", 1))
        pixels = self._texture(pbr.get("specularGlossinessTexture"), "specular-glossiness texture", "specular")
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
        pixels = self._texture(info, what, "base_color")
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
        pixels = self._texture(specular.get("specularTexture"), "specular texture", "specular")
        alpha = None if pixels is None else opacity(pixels)
        if alpha is not None:
            strength = strength * to_float(alpha, srgb=False)
        color = self._numbers(specular, "specularColorFactor", [1] * 3).reshape(1, 1, 3)
        if color.max() > 1:
            self._note(f"specularColorFactor of material '{self.name}' is above 1 and was taken as 1")
        pixels = self._texture(specular.get("specularColorTexture"), "specular colour texture", "specular")
        if pixels is not None:
            color = color * to_float(rgb(pixels), srgb=True)
        return np.clip(join_channels(color.mean(axis=2, keepdims=True), strength).prod(axis=2, keepdims=True), 0, 1)

    def _texture(self, info: dict | None, what: str, texture_of: str) -> np.ndarray | None:
        """
        The decoded image of a texture reference, for a texture of the material by its name; None without one.
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
        if not self.mappings.take(texture_of, _mapping(info, self._wraps(texture))):
            self._note(f"{what} of material '{self.name}' was left out: {_APART}")
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
