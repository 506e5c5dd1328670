"""
FBX and Collada through Assimp (package assimp-py), which splits polygons, concave ones too, and applies a file's axes
and, of Collada, its unit: positions are metres then, +Y up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AssetError
from ...model.asset import Asset, Instance, Material, Part
from ...model.color import srgb_to_linear
from ..images import constant, is_normal_map, join_channels, opacity, rgb, to_float, unit_normals
from ..resources import MissingFile, Resources, printable, read_bytes
from ..validate import check_indices

#: Assimp's numbers of textures (aiTextureType); of each of ours those that can hold it, the better first.
_BASE, _OPACITY, _EMISSION, _NORMAL = (12, 1), (8,), (14, 4), (6, 13, 5)
_ROUGHNESS, _METALLIC, _OCCLUSION = (16,), (15,), (17, 10)

#: Words by which files begin what Assimp's bindings do not hand over, and what that is.
_LEFT_OUT = {
    ".fbx": {b"AnimationCurveNode": "animation", b"BlendShape": "morph targets", b"Cluster": "skeletons"},
    ".dae": {b"<animation": "animation", b"<morph": "morph targets", b"<skin": "skeletons", b"<light": "lights",
             b"<camera": "cameras"},
}  # fmt: skip


def read_by_assimp(path: Path) -> Asset:
    """
    Read a model file by Assimp: its nodes as instances, normals, UVs, vertex colours, materials with textures.

    Colours are taken as sRGB, as three.js does; textures replace them. Gloss of Phong materials is left out as of MTL:
    roughness is .5 where no texture has it.

    Raises
    ------
    AssetError
        It cannot be read, holds no triangles, or the package is missing.
    """
    try:
        import assimp_py as assimp
    except ImportError as error:
        raise AssetError(
            f"{path.name}: {path.suffix[1:].upper()} needs the package assimp-py: pip install 'mi-simplify[formats]', "
            "or export the file as GLB"
        ) from error
    notes: list[str] = []
    resources = Resources(path, notes)
    data = read_bytes(path, "model file")
    for word, meaning in _LEFT_OUT[path.suffix.lower()].items():
        if word in data:
            notes.append(f"{meaning} of the file left out: {path.suffix[1:].upper()} gives its shape at rest")
    steps = assimp.Process_Triangulate | assimp.Process_JoinIdenticalVertices | assimp.Process_SortByPType
    try:
        scene = assimp.import_file(str(path), steps | assimp.Process_TransformUVCoords)
    except Exception as error:  # whatever a reader of somebody else's stumbles over
        line = " ".join(str(error).split()).replace(str(path), path.name)
        raise AssetError(f"{path.name}: Assimp cannot read it ({printable(line)}); export it as GLB") from error
    materials = [_material(values, resources) for values in scene.materials]
    parts: list[Part] = []
    which: dict[int, int] = {}
    for k, mesh in enumerate(scene.meshes):
        if mesh.num_faces and mesh.num_indices == 3 * mesh.num_faces:
            which[k] = len(parts)
            parts.append(_part(mesh, materials[mesh.material_index], resources))
        else:
            resources.note(f"'{printable(mesh.name)}' holds points or lines and was left out")
    instances: list[Instance] = []
    _place(scene.root_node, np.eye(4), "", which, instances)
    if not instances:
        raise AssetError(f"{path.name}: Assimp finds no triangles in it; export a mesh, as GLB")
    return Asset(tuple(parts), tuple(instances), notes=tuple(notes))


def _place(node: Any, above: np.ndarray, names: str, which: dict[int, int], instances: list[Instance]) -> None:
    """The meshes of a node and of those below it as instances."""
    to_world = above @ np.array(node.transformation, np.float64)
    names = f"{names}/{node.name}" if names else node.name
    for mesh in node.mesh_indices or ():
        if mesh in which:
            instances.append(Instance(which[mesh], to_world, name=node.name or f"node {len(instances)}", node=names))
    for child in node.children or ():
        _place(child, to_world, names, which, instances)


def _part(mesh: Any, material: Material, resources: Resources) -> Part:
    n, name = mesh.num_vertices, printable(mesh.name) or "part"
    faces = np.array(mesh.indices, np.int64).reshape(-1, 3)
    check_indices(faces.ravel(), n, resources.model.name, name)
    uvs = colors = None
    if mesh.texcoords and mesh.texcoords[0] is not None:
        uvs = np.array(mesh.texcoords[0], np.float32).reshape(n, -1)[:, :2] * [1, -1] + [0, 1]
        if len(mesh.texcoords) > 1:
            resources.note(f"further UV sets of '{name}' were left out: its textures are looked up in the first")
    if mesh.colors and mesh.colors[0] is not None and material.base_color.size == 4:
        colors = np.array(mesh.colors[0], np.float32).reshape(n, 4)
        colors[:, :3] = srgb_to_linear(colors[:, :3])
        if (colors[:, :3] == 1).all():  # what exporters write where nothing was painted
            colors = None
    normals = None if mesh.normals is None else np.array(mesh.normals, np.float32).reshape(n, 3)
    return Part(
        np.array(mesh.vertices, np.float64).reshape(n, 3), faces, normals,
        None if uvs is None else uvs.astype(np.float32), colors, material, name,
    )  # fmt: skip


def _material(values: dict[str, Any], resources: Resources) -> Material:
    name = printable(str(values.get("NAME", "material")))
    textures = {int(kind): names for kind, names in values.get("TEXTURES", {}).items()}

    def texture(kinds: tuple[int, ...]) -> np.ndarray | None:
        """The first image there is, shape (H, W, C)."""
        for uri in (uri for kind in kinds for uri in textures.pop(kind, ())[:1]):
            try:
                return None if uri.startswith("*") else resources.image(uri)
            except MissingFile as missing:
                resources.note(f"{missing}; its texture is left out")
        return None

    def factor(key: str, default: tuple[float, ...]) -> np.ndarray:
        found = np.ravel(values.get(key, default))[: len(default)]
        return found if len(found) == len(default) and np.isfinite(found).all() else np.array(default)

    embedded = any(str(uri).startswith("*") for names in textures.values() for uri in names)
    base, cut = texture(_BASE), texture(_OPACITY)
    flat = constant(*srgb_to_linear(np.clip(factor("COLOR_DIFFUSE", (0.8,) * 3), 0, 1)))
    color = flat if base is None else to_float(rgb(base), srgb=True)
    alpha = min(max(float(factor("OPACITY", (1.0,))[0]), 0.0), 1.0)
    if alpha == 0:  # as of MTL, some exporters mean the opposite
        resources.note(f"material '{name}' is fully transparent and was taken as opaque")
        alpha = 1.0
    shown = constant(alpha)
    if cut is not None:
        channel = opacity(cut)
        shown = to_float(cut[..., :1] if channel is None else channel, srgb=False) * np.float32(alpha)
    image = texture(_EMISSION)
    glow = constant(*srgb_to_linear(np.clip(factor("COLOR_EMISSIVE", (0.0,) * 3), 0, 1)))
    emission = glow if image is None else to_float(rgb(image), srgb=True)
    gloss, metal = texture(_ROUGHNESS), texture(_METALLIC)
    roughness = constant(0.5) if gloss is None else to_float(gloss[..., :1], srgb=False)
    metallic = constant(0.0) if metal is None else to_float(metal[..., :1], srgb=False)
    bumps, shade = texture(_NORMAL), texture(_OCCLUSION)
    normal = None
    if bumps is not None and is_normal_map(bumps):
        normal = unit_normals(to_float(rgb(bumps), srgb=False) * 2 - 1)
    elif bumps is not None:
        resources.note(f"bump map of material '{name}' was left out: it holds heights, not normals")
    if textures or embedded:
        what = "textures that are packed into the file" if embedded else "further textures"
        resources.note(f"{what} of material '{name}' were left out; export it as GLB to keep them")
    return Material(
        name=name,
        base_color=join_channels(color, shown),
        specular=np.clip(join_channels(constant(0), roughness, metallic), 0, 1),
        normal=normal,
        alpha_mode="OPAQUE" if shown.min() >= 1 else "BLEND",
        emission=emission if emission.any() else None,
        occlusion=None if shade is None else to_float(shade[..., :1], srgb=False),
    )
