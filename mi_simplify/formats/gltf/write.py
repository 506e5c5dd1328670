"""
glTF 2.0 out: one binary file with mesh, tangents and textures.
"""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from ... import __version__
from ...errors import MeshError
from ...machine.files import write_atomic
from ...model.model import Model
from ...model.rigging import Rigging
from ...model.skeleton import influences, skeleton_of
from ...model.tangents import split_mirrored, vertex_tangents
from ..origin import recentred
from ..textures import Textures, encode_textures, png

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT, FLOAT = 5121, 5123, 5125, 5126
LINEAR, LINEAR_MIPMAP_LINEAR, REPEAT = 9729, 9987, 10497


def write_glb(model: Model, path: str | Path, *, extras: dict | None = None) -> Path:
    """
    Write a model as GLB: metallic-roughness material, MikkTSpace tangents, embedded PNG textures; a character with
    skeleton, weights and animation.

    Further vertex sets are morph targets, named after the size on the screen that they are for.
    Gamma leaves as KHR_materials_specular where a dielectric texel has any (:mod:`..textures`).
    Vertices in which mirrored and unmirrored charts meet are doubled, since TANGENT's w is per vertex. A model far from
    the origin is stored around it, and its node has the translation.

    Parameters
    ----------
    model : Model
    path : str or Path
        In an existing folder.
    extras : dict, optional
        JSON values for ``asset.extras``: which transport the textures were fitted under, for one.

    Returns
    -------
    Path

    Raises
    ------
    MeshError
        The mesh has no faces.
    OutputError
        The file cannot be written.
    """
    return write_atomic(path, glb_bytes(model, extras=extras))


def glb_bytes(model: Model, *, extras: dict | None = None) -> bytes:
    """
    The content of the file that :func:`write_glb` writes.
    """
    builder = _Builder()
    if not len(model.mesh.faces):
        raise MeshError("nothing to export: the mesh has no faces")
    model, origin = recentred(model)
    place = {"translation": origin.tolist()} if origin.any() else {}
    attributes, indices = _geometry(builder, model)
    targets = _targets(builder, model)
    textures = encode_textures(model)
    material = _material(builder, model, textures)
    node: dict = {"name": model.name, "mesh": 0, **place}
    more: dict = {}
    if model.skin is not None:
        more = _skinned(builder, model, model.skin, node, attributes)
        more["nodes"][1] |= place  # the joints are moved, the mesh follows them
    document = {
        "asset": {"version": "2.0", "generator": f"mi_simplify {__version__}", **_some("extras", extras)},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [
            {
                "name": model.name,
                "primitives": [
                    {"attributes": attributes, "indices": indices, "material": 0, **_some("targets", targets)}
                ],
                **_target_names(model),
            }
        ],
        "materials": [material],
        "samplers": [{"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": REPEAT, "wrapT": REPEAT}],
        "textures": builder.textures,
        "images": builder.images,
        "accessors": builder.accessors,
        "bufferViews": builder.views,
        "buffers": [{"byteLength": len(builder.data)}],
    }
    document |= more
    if material.get("extensions"):
        document["extensionsUsed"] = sorted(material["extensions"])
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text  # "JSON"
    chunks += struct.pack("<II", len(builder.data), 0x004E4942) + bytes(builder.data)  # "BIN"
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


class _Builder:
    """Binary buffer with the views, accessors and images that point into it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.images: list[dict] = []
        self.textures: list[dict] = []

    def view(self, content: bytes, target: int | None = None) -> int:
        """Append bytes, padded to a multiple of 4, and return the view's index."""
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content), **_some("target", target)}
        )
        self.data += content + bytes(-len(content) % 4)
        return len(self.views) - 1

    def accessor(self, array: np.ndarray, component: int, target: int | None = None, *, bounds: bool = False) -> int:
        """Append an array of scalars (n,), vectors (n, k) or 4x4 matrices (n, 16) and return the accessor's index."""
        entry = {
            "bufferView": self.view(np.ascontiguousarray(array).tobytes(), target),
            "componentType": component,
            "count": len(array),
            "type": "SCALAR" if array.ndim == 1 else "MAT4" if array.shape[1] == 16 else f"VEC{array.shape[1]}",
        }
        if bounds:  # float32 to decimal and back is exact
            entry |= {name: np.atleast_1d(f(0)).tolist() for name, f in (("min", array.min), ("max", array.max))}
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def texture(self, name: str, image: np.ndarray) -> dict:
        """Append an image and return the texture reference of a material."""
        self.images.append({"name": name, "mimeType": "image/png", "bufferView": self.view(png(image))})
        self.textures.append({"name": name, "sampler": 0, "source": len(self.images) - 1})
        return {"index": len(self.textures) - 1}


def _geometry(builder: _Builder, model: Model) -> tuple[dict, int]:
    """Attributes and indices of the one primitive."""
    mesh = split_mirrored(model.mesh)
    normals = mesh.normals()
    tangents, w = vertex_tangents(mesh, normals)
    vertices = {
        "POSITION": mesh.vertices,
        "NORMAL": normals[mesh.normal_groups],
        "TANGENT": np.concatenate([tangents, w[:, None]], axis=1),
        "TEXCOORD_0": mesh.uvs,
    }
    attributes = {}
    for name, array in vertices.items():
        array = np.asarray(array, "<f4")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} holds values that are not finite")
        attributes[name] = builder.accessor(array, FLOAT, ARRAY_BUFFER, bounds=name == "POSITION")
    small = len(mesh.uvs) <= 65535  # 65535 itself is reserved (primitive restart)
    indices = mesh.faces.ravel().astype("<u2" if small else "<u4")
    component = UNSIGNED_SHORT if small else UNSIGNED_INT
    return attributes, builder.accessor(indices, component, ELEMENT_ARRAY_BUFFER)


def _skinned(builder: _Builder, model: Model, rigging: Rigging, node: dict, attributes: dict) -> dict:
    """More of the document: joints as nodes after the mesh's, skin and animation; weights join the attributes."""
    skeleton = skeleton_of(rigging.rig)
    joints, weights = influences(rigging)
    index = split_mirrored(model.mesh).position_index
    small = len(skeleton.names) <= 256
    for k in range(joints.shape[1] // 4):
        four = slice(4 * k, 4 * k + 4)
        which = joints[index, four].astype("u1" if small else "<u2")
        attributes[f"JOINTS_{k}"] = builder.accessor(which, UNSIGNED_BYTE if small else UNSIGNED_SHORT, ARRAY_BUFFER)
        attributes[f"WEIGHTS_{k}"] = builder.accessor(weights[index, four].astype("<f4"), FLOAT, ARRAY_BUFFER)
    first = 2  # nodes 0 and 1 are the mesh and what holds all joints
    children: list[list[int]] = [[] for _ in range(len(skeleton.names) + 1)]
    for j, parent in enumerate(skeleton.parents):
        children[parent].append(first + j)  # of -1: the last list
    curves = {"translation": skeleton.translations, "rotation": skeleton.rotations, "scale": skeleton.scales}
    nodes = [node | {"skin": 0}, {"name": "skeleton", "children": children[-1]}]
    for j, name in enumerate(skeleton.names):
        own = {key: curve[0, j].tolist() for key, curve in curves.items()}
        nodes.append({"name": name, **own, **_some("children", children[j] or None)})
    inverse = np.linalg.inv(skeleton.bind).swapaxes(1, 2).reshape(-1, 16)
    skin = {
        "name": model.name, "skeleton": 1, "joints": [first + j for j in range(len(skeleton.names))],
        "inverseBindMatrices": builder.accessor(inverse.astype("<f4"), FLOAT),
    }  # fmt: skip
    more = {"nodes": nodes, "skins": [skin], "scenes": [{"nodes": [0, 1]}]}
    animation = _animation(builder, rigging.rig.times, curves, first)
    return more | ({"animations": [animation]} if animation else {})


def _animation(builder: _Builder, times: np.ndarray, curves: dict[str, np.ndarray], first: int) -> dict | None:
    """Channels of all that moves; None where nothing does."""
    samplers: list[dict] = []
    channels: list[dict] = []
    time = None
    for path, curve in curves.items():
        for j in np.flatnonzero(np.ptp(curve, axis=0).max(1) > 1e-7):
            if time is None:
                time = builder.accessor(times.astype("<f4"), FLOAT, bounds=True)
            channels.append({"sampler": len(samplers), "target": {"node": int(first + j), "path": path}})
            output = builder.accessor(np.asarray(curve[:, j], "<f4"), FLOAT)
            samplers.append({"input": time, "output": output, "interpolation": "LINEAR"})
    return {"name": "clip", "samplers": samplers, "channels": channels} if channels else None


def _targets(builder: _Builder, model: Model) -> list[dict] | None:
    """A morph target for every further vertex set: the set itself at weight 1, blends of two between them."""
    if model.vertex_sets is None:
        return None
    mesh = split_mirrored(model.mesh)
    normals, targets = mesh.normals(), []
    for offset in model.vertex_sets.offsets:
        moved = replace(mesh, positions=mesh.positions + offset).normals()
        deltas = {"POSITION": offset[mesh.position_index], "NORMAL": (moved - normals)[mesh.normal_groups]}
        targets.append(
            {
                name: builder.accessor(np.asarray(x, "<f4"), FLOAT, ARRAY_BUFFER, bounds=name == "POSITION")
                for name, x in deltas.items()
            }
        )
    return targets


def _target_names(model: Model) -> dict:
    """What the morph targets are for: sides of the images that the sets were fitted at, the mesh's own first."""
    sets = model.vertex_sets
    if sets is None:
        return {}
    names = [f"{size:g} px" for size in sets.sizes[1:]]
    return {"weights": [0.0] * len(names), "extras": {"targetNames": names, "imageSizes": list(sets.sizes)}}


def _material(builder: _Builder, model: Model, textures: Textures) -> dict:
    """The material, its images appended to the buffer."""
    material = {
        "name": model.name,
        "pbrMetallicRoughness": {
            "baseColorTexture": builder.texture("base_color", textures.base_color),
            "metallicRoughnessTexture": builder.texture("orm", textures.orm),
            "metallicFactor": 1.0,
            "roughnessFactor": 1.0,
        },
        "normalTexture": builder.texture("normal", textures.normal),
        "alphaMode": model.alpha_mode,
        "doubleSided": True,
    }
    if model.alpha_mode == "MASK":
        material["alphaCutoff"] = float(model.alpha_cutoff)
    extensions: dict = {}
    if textures.specular_color is not None:
        color = builder.texture("specular_color", textures.specular_color)
        extensions["KHR_materials_specular"] = {"specularColorTexture": color}
    if textures.emission is not None:
        material["emissiveTexture"] = builder.texture("emission", textures.emission)
        material["emissiveFactor"] = [min(textures.emission_strength, 1.0)] * 3
        if textures.emission_strength > 1:
            extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": textures.emission_strength}
    if extensions:
        material["extensions"] = extensions
    return material


def _some(key: str, value: object) -> dict:
    """An entry only where there is a value."""
    return {} if value is None else {key: value}
