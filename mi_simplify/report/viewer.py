"""
Models in a report: what turns in 3D, and the sheets of its textures.

``web/viewer.js`` draws what :func:`viewer_data` gives it with WebGL 2. The textures of the last model are pictures of
the page, so they are embedded once and serve both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from PIL import Image

from ..formats.textures import VISIBLE_GAMMA, encode_normal, to_8bit
from ..model.asset import Asset, Material, Part
from ..model.color import linear_to_srgb
from ..model.mesh import Mesh
from ..model.tangents import split_mirrored, vertex_tangents
from ..scenes.shapes import part_normals
from .clip import clip_data, pulls, reach
from .embed import data_uri, packed_array

MOST_TRIANGLES = 250_000
"""Models with more are not put into the page; at 36 bytes a vertex they would make it tens of megabytes."""

TEXTURE_SIZE = 1024
"""Textures are embedded at most this large [pixels]; several of one model share as many texels as four of these."""

CHANNELS = {
    "base_color": "base colour", "opacity": "opacity", "gamma": "gamma", "roughness": "roughness",
    "metallic": "metallic", "normal": "normal",
}  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """
    One texture as it is embedded.

    Parameters
    ----------
    image : ndarray, shape (h, w) or (h, w, 3), uint8
        Base colour sRGB, everything else linear.
    size : tuple of int
        Width and height of the texture itself.
    """

    image: np.ndarray
    size: tuple[int, int]


def sheets(material: Material, size: int = TEXTURE_SIZE) -> dict[str, Sheet]:
    """
    The textures of a material by the names of :data:`CHANNELS`; without opacity, gamma and normals that do nothing.
    """
    gamma, roughness, metallic = np.moveaxis(material.specular, 2, 0)
    images = {"base_color": to_8bit(linear_to_srgb(material.base_color[..., :3]))}
    if material.alpha_mode != "OPAQUE":
        images["opacity"] = to_8bit(material.base_color[..., 3])
    if gamma.max() > VISIBLE_GAMMA:
        images["gamma"] = to_8bit(gamma)
    images |= {"roughness": to_8bit(roughness), "metallic": to_8bit(metallic)}
    if material.normal is not None:
        images["normal"] = encode_normal(material.normal)
    out = {}
    for name, image in images.items():
        height, width = image.shape[:2]
        picture = Image.fromarray(np.ascontiguousarray(image))
        picture.thumbnail((size, size), Image.Resampling.BOX)
        out[name] = Sheet(np.asarray(picture), (width, height))
    return out


@dataclass(frozen=True)
class Figure:
    """
    One texture as ``web/model.html`` shows it.

    Parameters
    ----------
    label, kind : str
        What it is called, and its channel; "map" for what is no channel of a material.
    size : tuple of int
        Width and height of the texture itself.
    uri : str
        The picture.
    id : str
        By which :func:`viewer_data` finds it; empty where it does not.
    part : int, optional
        Of the last model, whose texture coordinates look it up.
    """

    label: str
    kind: str
    size: tuple[int, int]
    uri: str
    id: str = ""
    part: int | None = None


def texture_sheets(asset: Asset, maps: Mapping[str, np.ndarray]) -> list[Figure]:
    """
    The textures of a model's materials, each channel a figure, and ``maps`` (8-bit) under their names.
    """
    materials = _materials(asset)
    figures = []
    for k, material in enumerate(materials):
        for name, sheet in sheets(material, _texture_size(materials)).items():
            label = CHANNELS[name] if len(materials) == 1 else f"{material.name}: {CHANNELS[name]}"
            figures.append(Figure(label, CHANNELS[name], sheet.size, data_uri(sheet.image), _id(k, name), k))
    for label, image in maps.items():
        height, width = image.shape[:2]
        picture = Image.fromarray(image)
        picture.thumbnail((TEXTURE_SIZE, TEXTURE_SIZE), Image.Resampling.BOX)
        figures.append(Figure(label, "map", (width, height), data_uri(np.asarray(picture))))
    return figures


def viewer_data(models: Mapping[str, Asset]) -> dict:
    """
    Everything that is drawn in 3D, as JSON values.

    Parameters
    ----------
    models : mapping of str to Asset
        All in one place and frame; the textures of the last are those of :func:`texture_sheets`.

    Returns
    -------
    dict
        ``models``, each with ``name``, ``triangles`` and ``parts``, in the frame in which the last one's box, and that
        of its clip, has centre 0 and a diagonal of 2; and ``clip``, see :func:`.clip.clip_data`.
    """
    last = list(models)[-1]
    low, high = reach(models[last])
    scale = 2 / np.linalg.norm(high - low)
    to_frame = np.diag([scale, scale, scale, 1.0])
    to_frame[:3, 3] = -scale * (low + high) / 2
    placed = {name: asset.transformed(to_frame) for name, asset in models.items()}
    return {
        "models": [
            {"name": name, "triangles": asset.n_triangles, "parts": _parts(asset, embedded=name != last)}
            for name, asset in placed.items()
        ],
        "clip": clip_data(placed),
    }


def _parts(asset: Asset, embedded: bool) -> list[dict]:
    """One entry a material: geometry, and textures as data URIs or as ids of pictures of the page."""
    materials, placed = _materials(asset), list(zip(asset.placed(), asset.instances, strict=True))
    out = []
    for k, material in enumerate(materials):
        if embedded:
            small = sheets(material, _texture_size(materials))
            textures = {name: data_uri(sheet.image, lossless=False) for name, sheet in small.items()}
        else:
            textures = {name: f"#{_id(k, name)}" for name in sheets(material, 1)}
        cutoff = material.alpha_cutoff if material.alpha_mode == "MASK" else 0.0
        geometry = [
            _geometry(part, pulls(part, instance.joint) if asset.rig is not None else {})
            for part, instance in placed
            if part.material is material
        ]
        start = np.cumsum([0, *(len(g["positions"]) for g in geometry)])
        joined = {name: np.concatenate([g[name] for g in geometry]) for name in geometry[0] if name != "indices"}
        indices = np.concatenate([g["indices"] + n for g, n in zip(geometry, start, strict=False)])
        joined["indices"] = indices.astype(np.uint16 if start[-1] <= 65535 else np.uint32)
        if (joined["colors"] == 255).all():
            del joined["colors"]
        if "weights2" in joined and not joined["weights2"].any():
            del joined["joints2"], joined["weights2"]
        arrays = {name: packed_array(array) for name, array in joined.items()}
        out.append(
            {
                "vertices": int(start[-1]), "textures": textures, "cutoff": float(cutoff),
                "blend": material.alpha_mode == "BLEND", **arrays,
            }
        )  # fmt: skip
    return out


def _geometry(part: Part, pulls: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """
    Vertices as the device takes them: float32 positions and UVs, normals and tangents (w: handedness) as 16-bit
    fractions, sRGB colours as bytes, and which joints pull at them.
    """
    n = len(part.vertices)
    uvs = np.zeros((n, 2), np.float32) if part.uvs is None else part.uvs
    mesh = split_mirrored(Mesh(part.vertices, np.arange(n), uvs, part.faces))
    normals = part_normals(part)
    tangents, w = vertex_tangents(mesh, normals)
    index = mesh.position_index
    colors = np.full((n, 4), 255, np.uint8)
    if part.colors is not None:
        colors[:, :3] = to_8bit(linear_to_srgb(part.colors[:, :3]))
    return {
        "positions": mesh.vertices.astype(np.float32),
        "normals": _fractions(np.concatenate([normals[index], np.zeros((len(index), 1))], axis=1)),
        "tangents": _fractions(np.concatenate([tangents, w[:, None]], axis=1)),
        "uvs": mesh.uvs.astype(np.float32),
        "colors": colors[index],
        "indices": mesh.faces.ravel(),
        **{name: array[index] for name, array in pulls.items()},
    }


def _fractions(x: np.ndarray) -> np.ndarray:
    """Values in [-1, 1] as signed 16-bit fractions."""
    return np.rint(np.clip(x, -1, 1) * 32767).astype(np.int16)


def _materials(asset: Asset) -> list[Material]:
    """The materials that are in use, each once."""
    used = [asset.parts[instance.part].material for instance in asset.instances]
    return list({id(material): material for material in used}.values())


def _texture_size(materials: list[Material]) -> int:
    """Largest side of an embedded texture, smaller where a model has many."""
    textured = sum(max(m.base_color.size, m.specular.size) > 64 for m in materials)
    return TEXTURE_SIZE if textured <= 4 else max(64, int(TEXTURE_SIZE * (4 / textured) ** 0.5))


def _id(material: int, channel: str) -> str:
    return f"texture-{material}-{channel}"
