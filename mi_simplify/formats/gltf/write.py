"""
glTF 2.0 out: one binary file with mesh, tangents and textures.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ... import __version__
from ...config.schema import GlbSettings
from ...errors import MeshError
from ...machine.files import write_atomic
from ...model.groups import Group
from ...model.model import Model
from ..origin import recentred
from ..packing import PackedTextures, pack_textures
from ..textures import HOLDS_AMBIENT
from .container import Container, some
from .rig import write_nodes, write_rig
from .vertices import write_primitives

LINEAR, LINEAR_MIPMAP_LINEAR, REPEAT = 9729, 9987, 10497


def write_glb(
    model: Model, path: str | Path, *, extras: dict | None = None, settings: GlbSettings = GlbSettings()
) -> Path:
    """
    Write a model as GLB: metallic-roughness material, MikkTSpace tangents, embedded textures of what varies; a
    character with skeleton, weights and animation. Kept nodes have a mesh each, and share the textures.

    Triangles stand in the order of a GPU's vertex cache, vertices in that of their use.
    Further vertex sets are morph targets, named after the size on the screen that they are for.
    Gamma leaves as KHR_materials_specular where a dielectric texel has any (:mod:`..textures`, :mod:`..packing`).
    Vertices in which mirrored and unmirrored charts meet are doubled, since TANGENT's w is per vertex. A model far from
    the origin is stored around it, and its node has the translation.

    Parameters
    ----------
    model : Model
    path : str or Path
        In an existing folder.
    extras : dict, optional
        JSON values for ``asset.extras``: which transport the textures were fitted under, for one.
    settings : GlbSettings
        How it is packed.

    Returns
    -------
    Path

    Raises
    ------
    MeshError
        The mesh has no faces.
    OutputError
        The file cannot be written; or textures cannot be as they are asked for.
    """
    return write_atomic(path, glb_bytes(model, extras=extras, settings=settings))


def glb_bytes(
    model: Model,
    *,
    extras: dict | None = None,
    settings: GlbSettings = GlbSettings(),
    textures: PackedTextures | None = None,
) -> bytes:
    """
    The content of the file that :func:`write_glb` writes, with textures that are packed already where they are given.
    """
    container = Container(settings.compress == "meshopt")
    if not len(model.mesh.faces):
        raise MeshError("nothing to export: the mesh has no faces")
    model = _at_rest(model)
    textures = textures or pack_textures(model, settings)
    tangents = settings.tangents and "normal" in textures.images
    if model.nodes is None:
        scene = _whole(container, model, settings, tangents)
    else:
        scene = write_nodes(container, model, lambda part: _mesh(container, part, settings, tangents))
    kinds = model.face_groups.kinds
    painted = _material(container, textures)
    materials = [_of_group(painted, kind, kind.name if len(kinds) > 1 else model.name) for kind in kinds]
    document = {
        "asset": {"version": "2.0", "generator": f"mi_simplify {__version__}", **_metadata(model, textures, extras)},
        "scene": 0,
        "materials": materials,
        "samplers": [{"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": REPEAT, "wrapT": REPEAT}],
    }
    container.extensions.update(*(material.get("extensions", ()) for material in materials))
    return container.glb(document | scene)


def _whole(container: Container, model: Model, settings: GlbSettings, tangents: bool) -> dict:
    """Scene, nodes and mesh of a model in one piece, with its skeleton."""
    if model.skin is None:
        mesh, place = _mesh(container, model, settings, tangents)
        return {"scenes": [{"nodes": [0]}], "nodes": [{"name": model.name, "mesh": 0, **place}], "meshes": [mesh]}
    model, origin = recentred(model)
    assert model.skin is not None
    primitives = write_primitives(container, model, settings, tangents=tangents)
    node = {"name": model.name, "mesh": 0}
    scene = write_rig(container, model.name, model.skin, primitives.mesh, primitives.grid, node, primitives.attributes)
    if origin.any():  # the joints are moved, the mesh follows them
        for entry in scene["nodes"][:2]:
            entry["translation"] = origin.tolist()
    return scene | {"meshes": [{"name": model.name, "primitives": primitives.entries, **_target_names(model)}]}


def _mesh(container: Container, model: Model, settings: GlbSettings, tangents: bool) -> tuple[dict, dict]:
    """A mesh, and the transform that its node needs: where it stands, and what its positions are rounded to."""
    model, origin = recentred(model)
    primitives = write_primitives(container, model, settings, tangents=tangents)
    place: dict = {"translation": origin.tolist()} if origin.any() else {}
    if primitives.grid is not None:
        place = {"scale": [primitives.grid.scale] * 3, "translation": (origin + primitives.grid.offset).tolist()}
    return {"name": model.name, "primitives": primitives.entries, **_target_names(model)}, place


def _at_rest(model: Model) -> Model:
    """The model with its morph targets at weight 0 instead of their defaults."""
    if model.morphs is None:
        return model
    positions = model.mesh.positions - np.tensordot(model.morphs.weights, model.morphs.offsets, axes=1)
    return replace(model, mesh=replace(model.mesh, positions=positions))


def _metadata(model: Model, textures: PackedTextures, extras: dict | None) -> dict:
    """What is said of the file: the asset's own copyright and extras, and ours, which win."""
    own = model.metadata.get("extras")
    extras = (own if isinstance(own, dict) else {} if own is None else {"asset": own}) | (extras or {})
    if textures.holds_ambient:
        extras[HOLDS_AMBIENT] = True
    return {**some("copyright", model.metadata.get("copyright")), **some("extras", extras or None)}


def _target_names(model: Model) -> dict:
    """What the morph targets are for: sides of the images that the sets were fitted at, the mesh's own first."""
    sets, morphs = model.vertex_sets, model.morphs
    if morphs is not None:
        return {"weights": list(morphs.weights), "extras": {"targetNames": list(morphs.names)}}
    if sets is None:
        return {}
    names = [f"{size:g} px" for size in sets.sizes[1:]]
    return {"weights": [0.0] * len(names), "extras": {"targetNames": names, "imageSizes": list(sets.sizes)}}


def _of_group(painted: dict, group: Group, name: str) -> dict:
    """The material of a group: what all share, and what cannot be painted."""
    cutoff = {"alphaCutoff": float(group.alpha_cutoff)} if group.alpha_mode == "MASK" else {}
    extensions = {**painted.get("extensions", {}), **group.lobes}
    own = {"name": name, "alphaMode": group.alpha_mode, "doubleSided": group.double_sided, **cutoff}
    return painted | own | some("extensions", extensions or None)


def _material(container: Container, textures: PackedTextures) -> dict:
    """What the materials of all groups share, its images appended to the buffer."""
    reference = {
        name: container.image(name, image.content, image.mime, image.extension)
        for name, image in textures.images.items()
    }
    color = list(textures.base_color)
    pbr = {
        **({} if color == [1.0] * 4 else {"baseColorFactor": color}),
        **some("baseColorTexture", reference.get("base_color")),
        **some("metallicRoughnessTexture", reference.get("orm")),
        "metallicFactor": textures.metallic,
        "roughnessFactor": textures.roughness,
    }
    material: dict = {
        "pbrMetallicRoughness": pbr,
        **some("normalTexture", reference.get("normal")),
    }
    extensions: dict = {}
    if textures.has_occlusion:
        material["occlusionTexture"] = dict(reference["orm"])
    if textures.specular_color is not None:
        texture = some("specularColorTexture", reference.get("specular_color"))
        extensions["KHR_materials_specular"] = texture or {"specularColorFactor": list(textures.specular_color)}
    if textures.emission is not None:
        strength = textures.emission_strength
        material |= some("emissiveTexture", reference.get("emission"))
        material["emissiveFactor"] = [min(strength, 1.0) * value for value in textures.emission]
        if strength > 1:
            extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
    if extensions:
        material["extensions"] = extensions
    return material
