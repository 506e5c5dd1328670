"""
glTF 2.0 and GLB: primitives as parts, nodes as instances.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import AssetError, MeshError
from ...machine import memory
from ...model.asset import FEWER_INSTANCES, PER_CORNER, PER_INSTANCE, Asset, Instance, Part
from ...model.light.emission import ambient_of, without_ambient
from ..images import constant
from ..influences import renumbered
from ..mapping import Mapping, placed
from ..textures import HOLDS_AMBIENT
from ..validate import check_indices, used_vertices
from .draco import draco_accessors
from .file import GltfFile
from .material import read_material
from .morph import morph_targets, morphed
from .motion import scene_nodes, trs
from .skeleton import Skeletons

_MODES = {0: "points", 1: "lines", 2: "line loop", 3: "line strip", 4: "triangles", 5: "strip", 6: "fan"}


def read_gltf(path: Path) -> Asset:
    """
    Read the default scene of a GLB or glTF file.

    A primitive placed by several nodes becomes one part with several instances. Skinned meshes stand in their bind
    pose, and the asset has a rig, of which nodes that are animated are joints, whether they have a skin or not. Morph
    targets are applied with their default weights; that they could move is left out with a note.

    Raises
    ------
    AssetError
        The file, a buffer or an image is missing or broken, or requires an extension that is not supported.
    MeshError
        Indices out of range.
    """
    notes: list[str] = []
    file = GltfFile(path, notes)
    file.decoded = draco_accessors(file)
    return _Scene(file, notes).read(path)


class _Scene:
    def __init__(self, file: GltfFile, notes: list[str]):
        self.file, self.notes = file, notes
        self.parts: list[Part] = []
        self.instances: list[Instance] = []
        self._of_mesh: dict[tuple, list[int]] = {}
        self._materials: dict[int | None, tuple] = {}
        self._carriers: list[int | None] = []
        """Of each instance, the node whose transform it follows; None where it has a skin."""

    def read(self, path: Path) -> Asset:
        world, self._parents = scene_nodes(self.file)
        self._skeletons = Skeletons(self.file, self._parents, world)
        self._number: dict[int | None, int] = {node: k for k, node in enumerate(world)}
        for index, to_world in world.items():
            node = self.file.item("nodes", index)
            if node.get("mesh") is None:
                continue
            name = node.get("name") or f"node_{index}"
            if node.get("skin") is not None:
                self._skinned(index, node, name, to_world)
                continue
            for placement in self._gpu_instances(node):
                for part in self._parts_of(node["mesh"], node.get("weights")):
                    self._place(part, to_world @ placement, name, index)
        self._note_left_out()
        carriers = [c for c in self._carriers if c is not None]
        if all(part.skin is None for part in self.parts) and not any(map(self._skeletons.motion.moves, carriers)):
            if self.file.json.get("animations"):
                self.file.resources.note("animations were left out; the model stands as its nodes do")
            return self._finished(Asset(tuple(self.parts), tuple(self.instances), tree=self._skeletons.motion.tree()))
        rig, new, joints = self._skeletons.rig(carriers)
        is_rigid = [c is not None for c in self._carriers]
        parts, instances = renumbered(self.parts, self.instances, is_rigid, new, joints)
        tree = self._skeletons.motion.tree() if all(is_rigid) else None  # joints of a skin are its own
        return self._finished(Asset(parts, instances, rig=rig, tree=tree))

    def _note_left_out(self) -> None:
        """A line for everything in the file that has no counterpart here."""
        json, note = self.file.json, self.file.resources.note
        if len(json.get("scenes") or ()) > 1:
            note(f"{len(json['scenes']) - 1} further scenes were left out")
        if json.get("cameras"):
            note(f"{len(json['cameras'])} cameras were left out")
        extensions = json.get("extensions") or {}
        if "KHR_materials_variants" in extensions:
            note("material variants were left out; the default materials are used")
        if (extensions.get("KHR_lights_punctual") or {}).get("lights"):
            note("lights were left out")

    def _finished(self, asset: Asset) -> Asset:
        """With what the file says of itself."""
        about = self.file.json.get("asset") or {}
        ambient, extras = self._ambient(), about.get("extras")
        if isinstance(extras, dict) and extras.get(HOLDS_AMBIENT):
            asset = without_ambient(asset, ambient)
        metadata = {key: about[key] for key in ("copyright", "extras") if about.get(key)}
        return replace(asset, ambient=ambient, metadata=metadata, notes=tuple(self.notes))

    def _ambient(self) -> np.ndarray | None:
        """The light besides point lights that a model of ours was fitted under."""
        extras = self.file.json.get("asset", {}).get("extras")
        value = extras.get("ambient") if isinstance(extras, dict) else None
        if value is None:
            return None
        ambient = ambient_of(value)
        if ambient is None:
            self.notes.append("the ambient light in its extras makes no sense and was left out")
            return None
        return ambient

    def _gpu_instances(self, node: dict) -> np.ndarray:
        """Placements of EXT_mesh_gpu_instancing, shape (N, 4, 4); the identity without it."""
        attributes = ((node.get("extensions") or {}).get("EXT_mesh_gpu_instancing") or {}).get("attributes") or {}
        keys = ("TRANSLATION", "ROTATION", "SCALE")
        columns = [self.file.accessor(attributes[k]).astype(np.float64) if k in attributes else None for k in keys]
        counts = {len(c) for c in columns if c is not None}
        if len(counts) > 1:
            raise AssetError(f"{self.file.name}: the instance attributes of a node differ in number: {sorted(counts)}")
        if not counts:
            return np.eye(4)[None]
        n = counts.pop()
        memory.require(PER_INSTANCE * n, f"{self.file.name}: a node of {n} instances", FEWER_INSTANCES)
        return trs(n, *columns)

    def _parts_of(self, mesh_index: int, weights: list[float] | None) -> list[int]:
        """Indices of the parts of a mesh under a node's morph weights, read at its first use."""
        key = mesh_index, None if weights is None else tuple(weights)
        if key not in self._of_mesh:
            mesh = self.file.item("meshes", mesh_index)
            name = mesh.get("name") or f"mesh_{mesh_index}"
            numbers = []
            for k, primitive in enumerate(mesh.get("primitives", [])):
                shown = f"{name}_{k}" if len(mesh["primitives"]) > 1 else name
                own = mesh.get("weights") if weights is None else weights
                part, _ = self._primitive(primitive, shown, own, _target_names(mesh))
                if part is not None:
                    numbers.append(len(self.parts))
                    self.parts.append(replace(part, place=(mesh_index, k, primitive.get("material", -1))))
            self._of_mesh[key] = numbers
        return self._of_mesh[key]

    def _primitive(
        self, primitive: dict, name: str, weights: list[float] | None, target_names: list[str]
    ) -> tuple[Part | None, np.ndarray]:
        """A primitive as a part under morph weights, and the vertices of the file that it kept."""
        file, attributes = self.file, primitive.get("attributes") or {}
        mode = primitive.get("mode", 4)
        if mode not in (4, 5, 6) or "POSITION" not in attributes:
            what = _MODES.get(mode, f"mode {mode}") if "POSITION" in attributes else "no positions"
            file.resources.note(f"a primitive of '{name}' was left out: {what}")
            return None, np.zeros(0, np.int64)
        vertices = file.accessor(attributes["POSITION"])
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise MeshError(f"{file.name}: positions of '{name}' are no 3D vectors; export the file again")
        index = primitive.get("indices")
        index = np.arange(len(vertices)) if index is None else file.accessor(index).astype(np.int64)
        memory.require(PER_CORNER * len(index), f"{file.name}: '{name}' of {len(index):,} corners", FEWER_INSTANCES)
        check_indices(index, len(vertices), file.name, name)
        faces = _triangles(index, mode)
        if not len(faces):
            file.resources.note(f"a primitive of '{name}' was left out: it has no faces")
            return None, np.zeros(0, np.int64)
        used, faces = used_vertices(faces, len(vertices))

        def attribute(key: str) -> np.ndarray | None:
            if key not in attributes:
                return None
            values = file.accessor(attributes[key])
            if len(values) != len(vertices):
                raise MeshError(f"{file.name}: {key} of '{name}' has {len(values)} rows for {len(vertices)} vertices")
            return morphed(file, primitive, key, values, weights)[used]

        material_index = primitive.get("material")
        if material_index not in self._materials:
            self._materials[material_index] = read_material(file, material_index)
        material, places = self._materials[material_index]
        colors = attribute("COLOR_0")
        if colors is not None:
            colors = colors[:, :4].astype(np.float32)
            if colors.shape[1] == 3:
                colors = np.concatenate([colors, np.ones((len(colors), 1), np.float32)], axis=1)
            if material_index is None:  # vertex colours multiply the base colour, so they want a white one
                material = type(material)("vertex colours", base_color=constant(1, 1, 1, 1))
        normals = attribute("NORMAL")
        part = Part(
            morphed(file, primitive, "POSITION", vertices, weights)[used].astype(np.float64), faces,
            None if normals is None else normals.astype(np.float32), None, colors, material, name,
        )  # fmt: skip
        found = [attribute(f"TEXCOORD_{place.set}") for place in places or (Mapping(),)]
        for place, uvs in zip(places, found, strict=False):
            if uvs is None:
                file.resources.note(f"'{name}' has textures but no TEXCOORD_{place.set}; they show one texel")
        first, *more = placed(places, found)
        morphs = morph_targets(file, primitive, target_names, weights, len(vertices), used)
        return replace(part, uvs=first, more_uvs=tuple(more), morphs=morphs), used

    def _skinned(self, index: int, node: dict, name: str, to_world: np.ndarray) -> None:
        """
        The mesh of a skinned node in its bind pose; the node's own transform does not count (glTF 3.7.3.3).
        """
        file, skeletons = self.file, self._skeletons
        _, placement = skeletons.of(node["skin"], name)
        mesh = file.item("meshes", node["mesh"])
        for k, primitive in enumerate(mesh.get("primitives", [])):
            shown = f"{name}_{k}" if len(mesh["primitives"]) > 1 else name
            own = node.get("weights", mesh.get("weights"))
            part, used = self._primitive(primitive, shown, own, _target_names(mesh))
            if part is None:
                continue
            attributes = primitive["attributes"]
            sets = [s for s in range(4) if f"JOINTS_{s}" in attributes and f"WEIGHTS_{s}" in attributes]
            if not sets:
                file.resources.note(f"'{name}' has a skin but no joint weights; it moves as its node does")
                self._place(self._added(part), to_world, name, index)
                continue
            which, weights = (
                np.concatenate([file.accessor(attributes[f"{key}_{s}"])[used] for s in sets], axis=1)
                for key in ("JOINTS", "WEIGHTS")
            )
            part = replace(
                part,
                place=(node["mesh"], k, primitive.get("material", -1)),
                skin=skeletons.skin(node["skin"], which, weights, part.vertices, name),
            )
            self._place(self._added(part), placement, name, None)

    def _added(self, part: Part) -> int:
        self.parts.append(part)
        return len(self.parts) - 1

    def _place(self, part: int, to_world: np.ndarray, name: str, carrier: int | None) -> None:
        above = "" if carrier is None else self._above(carrier)
        self.instances.append(Instance(part, to_world, name, above, at=self._number.get(carrier, -1)))
        self._carriers.append(carrier)

    def _above(self, index: int) -> str:
        """The names of a node's parents, with their numbers, from the root on."""
        names: list[str] = []
        while (index := self._parents[index]) >= 0:
            names.append(f"{self.file.item('nodes', index).get('name') or 'node'}.{index}")
        return "/".join(reversed(names))


def _target_names(mesh: dict) -> list[str]:
    """What a mesh calls its morph targets, where it says so."""
    extras = mesh.get("extras")
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    return [str(name) for name in names] if isinstance(names, list) else []


def _triangles(index: np.ndarray, mode: int) -> np.ndarray:
    """Vertex indices of a triangle list, strip or fan as faces, shape (F, 3)."""
    if mode == 4:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    k = np.arange(max(len(index) - 2, 0))
    if mode == 6:
        return np.stack([index[k + 1], index[k + 2], np.broadcast_to(index[:1], k.shape)], axis=1)
    odd = k % 2
    return np.stack([index[k], index[k + 1 + odd], index[k + 2 - odd]], axis=1)
