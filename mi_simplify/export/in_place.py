"""
A fitted model back into the glTF file that it was: new arrays and images, everything else as it was.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import AssetError
from ..formats.gltf.stage.edit import GltfEdit
from ..formats.textures import encode_normal, to_8bit
from ..latent.file_model import FileModel
from ..latent.morphing import MorphedModel
from ..machine.files import write_atomic
from ..model.asset import Material, Part
from ..model.color import linear_to_srgb
from ..model.light.environment_map import as_harmonics
from ..model.model import Model

_COLOR, _SPECULAR = ("base_color", "opacity"), ("roughness", "metallic")


def check_in_place(path: str | Path, parts: Collection[Part], fitted: Collection[str]) -> list[str]:
    """
    Raise where a file could not take what is to be fitted; notes on what will change besides.

    Parameters
    ----------
    path : str or Path
    parts : collection of Part
        As read from it.
    fitted : collection of str
        Quantities.

    Raises
    ------
    AssetError
        Meshes compressed by Draco are to move; colours are to change of a material with a specular colour or of the
        retired specular-glossiness workflow, or with textures of coordinates of their own.
    """
    edit, notes = GltfEdit(path), []
    for part in parts:
        mesh, index = part.place[:2]
        if "vertices" in fitted:
            edit.values(mesh, index, "POSITION")
        material = edit.json["materials"][part.place[2]] if part.place[2] >= 0 else {}
        extensions = material.get("extensions") or {}
        if {*_COLOR, *_SPECULAR} & set(fitted):
            if "pbrMetallicRoughness" not in material and "KHR_materials_pbrSpecularGlossiness" in extensions:
                raise AssetError(f"material '{part.material.name}' is specular-glossiness, not metal-roughness")
            if part.material.specular[..., 0].any():
                raise AssetError(
                    f"material '{part.material.name}' has a specular colour (KHR_materials_specular), so its base "
                    "colour and metalness cannot be fitted in place; leave these out, or export it without"
                )
        if "TANGENT" in edit.primitive(mesh, index)["attributes"] and {"vertices", "normal"} & set(fitted):
            notes.append(f"the tangents of '{part.name}' are left out of the result; viewers make them (MikkTSpace)")
    return notes


def write_in_place(
    source: str | Path, path: str | Path, origin: FileModel, fitted: Model, names: Collection[str]
) -> Path:
    """
    Write a GLB file that is ``source`` but for what was fitted.

    Parameters
    ----------
    source, path : str or Path
        The file that was read, and where the new one goes.
    origin : FileModel
        What was made of it.
    fitted : Model
        In the same frame.
    names : collection of str
        Quantities that were fitted; all others stay to the bit.

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        It cannot be written.
    """
    edit = GltfEdit(source)
    names = set(names)
    if "vertices" in names:
        at_rest = fitted
        if isinstance(fitted, MorphedModel) and origin.model.morphs is not None:
            at_rest = fitted.moved_to(np.asarray(origin.model.morphs.weights))
        _write_geometry(edit, origin, at_rest)
    if "weights" in names and fitted.morphs is not None:
        _write_weights(edit, origin, fitted.morphs.weights)
    for part, images in origin.images(fitted):
        if names & {*_COLOR, *_SPECULAR, "normal"}:
            _write_textures(edit, edit.material(*part.place[:2]), part.material, images, names)
    if names & {"vertices", "normal"}:
        for part in origin.parts:
            edit.primitive(*part.place[:2])["attributes"].pop("TANGENT", None)
    if fitted.ambient is not None and "ambient" in names:
        extras = edit.json.setdefault("asset", {}).setdefault("extras", {})
        extras["ambient"] = " ".join(f"{x:.6g}" for x in as_harmonics(fitted.ambient).ravel())
    return write_atomic(path, edit.glb())


def _write_geometry(edit: GltfEdit, origin: FileModel, fitted: Model) -> None:
    """Moved positions and their normals; vertices that no triangle uses stay."""
    for part, vertices, normals in origin.geometry(fitted):
        mesh, index = part.place[:2]
        used, stored = edit.used(mesh, index), edit.values(mesh, index, "POSITION")
        assert stored is not None and len(used) == len(part.vertices)
        moved = stored.astype(np.float64)
        moved[used] += vertices - part.vertices  # without the morph targets' share in the latter
        edit.set_values(mesh, index, "POSITION", moved)
        given = edit.values(mesh, index, "NORMAL")
        turned = np.tile([0.0, 0.0, 1.0], (len(moved), 1)) if given is None else given.astype(np.float64)
        turned[used] = normals
        edit.set_values(mesh, index, "NORMAL", turned)


def _write_weights(edit: GltfEdit, origin: FileModel, weights: tuple[float, ...]) -> None:
    """Default weights of the meshes; nodes that have their own get these."""
    for mesh in dict.fromkeys(mesh for mesh, _ in origin.targets):
        entry = edit.json["meshes"][mesh]
        targets = entry["primitives"][0]["targets"]
        moving = [k for k, target in enumerate(targets) if "POSITION" in target]
        nodes = [node for node in edit.json["nodes"] if node.get("mesh") == mesh]
        old = next((node["weights"] for node in nodes if "weights" in node), entry.get("weights", []))
        entry["weights"] = [*old, *[0.0] * (len(targets) - len(old))]
        for (owner, j), weight in zip(origin.targets, weights, strict=True):
            if owner == mesh:
                entry["weights"][moving[j]] = float(weight)
        for node in nodes:
            node.pop("weights", None)


def _write_textures(
    edit: GltfEdit, number: int, material: Material, images: dict[str, np.ndarray], names: set[str]
) -> None:
    """Those images of a material that hold a fitted quantity; of one texel they are factors."""
    color, specular, normal = (np.asarray(images[k], np.float64) for k in ("base_color", "specular", "normal"))
    is_constant = color.shape[:2] == (1, 1)
    factors: dict[str, Any] = {}
    if names & set(_COLOR):
        alpha = color[..., 3:] if material.alpha_mode != "OPAQUE" else material.base_color[:1, :1, 3:]
        factors["baseColorFactor"] = [1.0] * 4
        if is_constant:
            factors["baseColorFactor"] = [*color[0, 0, :3].tolist(), float(alpha[0, 0, 0])]
        else:
            shown = [linear_to_srgb(color[..., :3]), *([alpha] if material.alpha_mode != "OPAQUE" else [])]
            edit.set_texture(number, "baseColorTexture", to_8bit(np.concatenate(shown, axis=2)))
    if names & set(_SPECULAR):
        factors |= {"roughnessFactor": 1.0, "metallicFactor": 1.0}
        if is_constant:
            factors |= {"roughnessFactor": float(specular[0, 0, 1]), "metallicFactor": float(specular[0, 0, 2])}
        else:
            orm = np.concatenate([np.ones_like(specular[..., :1]), specular[..., 1:]], axis=2)
            edit.set_texture(number, "metallicRoughnessTexture", to_8bit(orm))
    if factors:
        edit.set_factors(number, **factors)
    if "normal" in names and not is_constant:
        edit.set_texture(number, "normalTexture", encode_normal(normal))
