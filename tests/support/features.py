"""A generator of glTF files, one for each feature of the format, or for several at once; and what becomes of each."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .tiny_models import QUAD, Glb, corner_pixels


@dataclass
class Draft:
    """A quad with a material, before it becomes a file."""

    glb: Glb = field(default_factory=Glb)
    material: dict[str, Any] = field(default_factory=lambda: {"name": "m", "doubleSided": True})
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    primitive: dict[str, Any] = field(default_factory=dict)
    node: dict[str, Any] = field(default_factory=lambda: {"name": "n", "mesh": 0})

    def texture(self) -> dict:
        return {"index": self.glb.texture(corner_pixels())}

    def extend(self, name: str, **content) -> None:
        self.material.setdefault("extensions", {})[name] = content
        self.use(name)

    def use(self, name: str) -> None:
        used = self.glb.json.setdefault("extensionsUsed", [])
        used += [name] * (name not in used)

    def pbr(self) -> dict:
        return self.material.setdefault("pbrMetallicRoughness", {})

    def finished(self) -> Glb:
        glb = self.glb
        primitive = {**glb.quad(glb.material(**self.material), **self.attributes), **self.primitive}
        glb.mesh(primitive)
        glb.json["nodes"] = [self.node, *glb.json["nodes"][1:]]
        return glb


def _uv1(d: Draft) -> None:
    d.attributes["TEXCOORD_1"] = np.float32([[1, 1], [0, 1], [0, 0], [1, 0]])
    d.pbr()["baseColorTexture"] = {**d.texture(), "texCoord": 1}


def _transform(d: Draft) -> None:
    d.use("KHR_texture_transform")
    move = {"offset": [0.25, 0], "scale": [0.5, 0.5], "rotation": 0.5}
    d.pbr()["baseColorTexture"] = {**d.texture(), "extensions": {"KHR_texture_transform": move}}


def _sampler(d: Draft) -> None:
    info = d.texture()
    d.glb.json["samplers"] = [{"wrapS": 33648, "wrapT": 33071}]
    d.glb.json["textures"][info["index"]]["sampler"] = 0
    d.pbr()["baseColorTexture"] = info


def _mask(d: Draft) -> None:
    holes = np.full((8, 8, 4), 255, np.uint8)
    holes[:4, :4, 3] = 0
    d.material |= {"alphaMode": "MASK", "alphaCutoff": 0.25}
    d.pbr()["baseColorTexture"] = {"index": d.glb.texture(holes)}


def _emission(d: Draft) -> None:
    d.material |= {"emissiveFactor": [1, 0.5, 0.25], "emissiveTexture": d.texture()}
    d.extend("KHR_materials_emissive_strength", emissiveStrength=3)


def _colors(d: Draft) -> None:
    d.attributes["COLOR_0"] = np.float32([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 1, 1]])


def _morph(d: Draft) -> None:
    d.primitive["targets"] = [{"POSITION": d.glb.accessor(np.float32(QUAD * [0, 0, 0] + [0, 0, 1]))}]


def _animation(d: Draft) -> None:
    time, value = d.glb.accessor(np.float32([0, 1])), d.glb.accessor(np.float32([[0, 0, 0], [1, 0, 0]]))
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    d.glb.json["animations"] = [{"samplers": [{"input": time, "output": value}], "channels": [channel]}]


def _variants(d: Draft) -> None:
    d.use("KHR_materials_variants")
    d.glb.json.setdefault("extensions", {})["KHR_materials_variants"] = {"variants": [{"name": "red"}]}


def _lights(d: Draft) -> None:
    d.use("KHR_lights_punctual")
    d.glb.json.setdefault("extensions", {})["KHR_lights_punctual"] = {"lights": [{"type": "point"}]}


def _camera(d: Draft) -> None:
    d.glb.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]


def _instances(d: Draft) -> None:
    d.use("EXT_mesh_gpu_instancing")
    moved = d.glb.accessor(np.float32([[0, 0, 0], [2, 0, 0]]))
    d.node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": moved}}}


def _lobe(name: str, **factors) -> Callable[[Draft], None]:
    return lambda d: d.extend(name, **factors)


def _volume(d: Draft) -> None:
    d.material["doubleSided"] = False  # what has no inside, or lets no light in, holds no volume
    d.extend("KHR_materials_transmission", transmissionFactor=0.5)
    d.extend("KHR_materials_volume", thicknessFactor=0.5, attenuationColor=[1, 0.5, 0.5])


def _set(**content) -> Callable[[Draft], None]:
    return lambda d: d.material.update(content)


#: Of each feature, as docs/formats.md calls it: what makes a file with it, and what becomes of it: ``baked`` into the
#: textures, ``carried`` over as it is, ``read`` into the geometry, or ``left out`` with a line.
FEATURES: dict[str, tuple[Callable[[Draft], None], str]] = {
    "base colour": (lambda d: d.pbr().update(baseColorTexture=d.texture()), "baked"),
    "roughness, metalness": (lambda d: d.pbr().update(metallicRoughnessTexture=d.texture()), "baked"),
    "normal map": (lambda d: d.material.update(normalTexture=d.texture()), "baked"),
    "occlusion": (lambda d: d.material.update(occlusionTexture=d.texture()), "baked"),
    "emission": (_emission, "baked"),
    "specular colour": (_lobe("KHR_materials_specular", specularColorFactor=[0.5, 0.5, 0.5]), "baked"),
    "vertex colours": (_colors, "baked"),
    "further UV sets": (_uv1, "baked"),
    "texture transforms": (_transform, "baked"),
    "clamp and mirror": (_sampler, "baked"),
    "mask": (_mask, "carried"),
    "blending": (_set(alphaMode="BLEND", pbrMetallicRoughness={"baseColorFactor": [1, 1, 1, 0.5]}), "carried"),
    "one-sided faces": (_set(doubleSided=False), "carried"),
    "clear coat": (_lobe("KHR_materials_clearcoat", clearcoatFactor=0.5, clearcoatRoughnessFactor=0.1), "carried"),
    "sheen": (_lobe("KHR_materials_sheen", sheenColorFactor=[0.5, 0, 0]), "carried"),
    "transmission": (_lobe("KHR_materials_transmission", transmissionFactor=0.5), "carried"),
    "volume": (_volume, "carried"),
    "index of refraction": (_lobe("KHR_materials_ior", ior=1.33), "carried"),
    "iridescence": (_lobe("KHR_materials_iridescence", iridescenceFactor=0.5), "carried"),
    "anisotropy": (_lobe("KHR_materials_anisotropy", anisotropyStrength=0.5), "carried"),
    "dispersion": (_lobe("KHR_materials_dispersion", dispersion=0.5), "carried"),
    "unlit": (_lobe("KHR_materials_unlit"), "carried"),
    "copyright, extras": (lambda d: d.glb.json["asset"].update(copyright="me", extras={"a": 1}), "carried"),
    "instances": (_instances, "read"),
    "morph targets": (_morph, "carried"),
    "animated nodes": (_animation, "carried"),
    "material variants": (_variants, "left out"),
    "lights": (_lights, "left out"),
    "cameras": (_camera, "left out"),
    "further scenes": (lambda d: d.glb.json["scenes"].append({"nodes": []}), "left out"),
}


def made(*names: str) -> Glb:
    """A file with some features."""
    draft = Draft()
    for name in names:
        FEATURES[name][0](draft)
    return draft.finished()
