"""
Mitsuba XML scenes as assets: triangles and approximate materials to start from; the scene itself is what is rendered.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import AssetError
from ...machine.meshes import mesh_faces, mesh_normals, mesh_positions, mesh_uvs
from ...machine.upload import upload
from ...model.asset import Asset, Instance, Material, Part
from ...model.marching_cubes import marching_cubes
from ...model.topology import area_vectors, vertex_normals
from ..mapping import Mapping
from ..resources import Resources
from .file import Node, SceneFile
from .look import Look
from .looks import look_of
from .material import Materials, vertex_colors
from .tessellate import SHAPES, Patch

log = logging.getLogger("mi_simplify")


@dataclass(frozen=True)
class SceneAsset(Asset):
    """
    An asset that stands for a Mitsuba scene: what is rendered as reference is the scene with its own shapes and BSDFs.

    Parameters
    ----------
    file : SceneFile
    to_frame : ndarray, shape (4, 4)
        How the asset was moved since it was read: a uniform scale and a translation.
    without_triangles : tuple of str
        Shapes that their bounding boxes stand in for, so that at least the extent of the asset is known.
    """

    file: SceneFile = None  # type: ignore[assignment] # always given; fields of the base class have defaults
    to_frame: np.ndarray = field(default_factory=lambda: np.eye(4))
    without_triangles: tuple[str, ...] = ()

    @property
    def scale(self) -> float:
        """Length of one unit of the scene in the asset's frame."""
        return float(self.to_frame[0, 0])

    @property
    def center(self) -> np.ndarray:
        """Point of the scene, shape (3,), at the origin of the asset's frame."""
        return -self.to_frame[:3, 3] / self.scale

    def transformed(self, to_world: np.ndarray) -> SceneAsset:
        """
        The asset moved; the scene cannot be, so its cameras will be.

        Raises
        ------
        ValueError
            The transform does more than scale uniformly and translate.
        """
        expected = np.diag([to_world[0, 0]] * 3 + [1.0])
        expected[:3, 3] = to_world[:3, 3]
        if not (np.allclose(to_world, expected, rtol=1e-9, atol=0) and to_world[0, 0] > 0):
            raise ValueError("a Mitsuba scene can only be scaled uniformly and translated")
        moved = super().transformed(to_world)
        assert isinstance(moved, SceneAsset)
        return replace(moved, to_frame=to_world @ self.to_frame)

    def placed(self) -> list[Part]:
        """
        As for any asset.

        Raises
        ------
        AssetError
            Some shape has no triangles.
        """
        self.require_triangles()
        return super().placed()

    def require_triangles(self) -> None:
        """
        Raise where a shape is not known as triangles, so that nothing can be decimated or baked from it.
        """
        if self.without_triangles:
            raise AssetError(
                f"{self.file.path.name}: {self.without_triangles[0]} has no triangles to decimate or to bake from; "
                "start from a sphere: --set initial.kind=sphere --set initial.textures=constant"
            )


def read_mitsuba(path: Path) -> SceneAsset:
    """
    Read a Mitsuba XML scene.

    Emitting shapes and those of BSDF ``null`` are left out. Meshes keep their triangles, spheres,
    cylinders, disks and rectangles are tessellated, of an `sdfgrid` the isosurface is taken, others are stood in for by
    their bounding boxes; using these as a surface raises. Materials are approximated by metallic-roughness, a note for
    each.

    Raises
    ------
    AssetError
        Mitsuba cannot load the scene, or nothing in it can be seen.
    """
    notes: list[str] = []
    file = SceneFile(path)
    reader = _Shapes(file, Resources(path, notes))
    for node in file.shapes:
        if node.plugin == "instance":
            for member in node.of_kind("Shape")[0].of_kind("Shape"):
                reader.place(member, _matrix(node.values.get("to_world")), node.id or node.plugin)
        elif node.plugin != "shapegroup":
            reader.place(node, np.eye(4), node.id or node.plugin)
    if reader.n_emitting:
        notes.append(f"{reader.n_emitting} shapes are area lights and stay out")
        log.warning("%s: %s", path.name, notes[-1])
    if not reader.instances:
        raise AssetError(f"{path.name}: the scene has no shapes that can be seen")
    return SceneAsset(
        tuple(reader.parts), tuple(reader.instances), notes=tuple(notes), file=file,
        without_triangles=tuple(reader.without_triangles),
    )  # fmt: skip


def is_emitting(shape: Node) -> bool:
    """
    Whether a shape is an area light.
    """
    return bool(shape.of_kind("Emitter"))


class _Shapes:
    """Parts and instances, as they are collected."""

    def __init__(self, file: SceneFile, resources: Resources):
        self.file, self.resources = file, resources
        self.materials = Materials(file, resources, look_of)
        self.parts: list[Part] = []
        self.instances: list[Instance] = []
        self.without_triangles: list[str] = []
        self.n_emitting = 0
        self._index: dict[int, int | None] = {}
        self._turned: dict[tuple, Material] = {}

    def place(self, node: Node, to_world: np.ndarray, name: str) -> None:
        """An instance of a shape, if it is one that can be seen."""
        if is_emitting(node):
            self.n_emitting += 1
            return
        if node.index not in self._index:
            part = self._part(node)
            self._index[node.index] = None if part is None else len(self.parts)
            self.parts += [] if part is None else [part]
        index = self._index[node.index]
        if index is not None:
            self.instances.append(Instance(index, to_world, name))

    def _part(self, node: Node) -> Part | None:
        bsdfs = node.of_kind("BSDF")
        shape = self.file.make(node)
        look, material, mapping = self.materials.of(bsdfs[0] if bsdfs else None)
        if not look.has_surface:
            self.resources.note(f"{node} has no surface ('null'); only the reference shows it")
            return None
        name = node.id or node.plugin
        flip = bool(node.values.get("flip_normals", False))
        if node.plugin in SHAPES:
            to_world = _matrix(mi.traverse(shape)["to_world"])
            # Mitsuba turns a mirrored sphere inside out, and a disk's transform holds the flip already.
            flip = {"sphere": flip != (np.linalg.det(to_world) < 0), "disk": False}.get(node.plugin, flip)
            patch = SHAPES[node.plugin]().placed(to_world, flip)
            points = _points(patch)
        elif node.plugin == "sdfgrid":
            patch, points = _grid_patch(shape, str(node))
        elif shape.is_mesh():
            if not shape.face_count():  # any such mesh makes Dr.Jit fail at the others
                raise AssetError(f"{self.resources.model.name}: {node} has no triangles; take it out of the scene")
            patch, points = _mesh_patch(shape)
            patch = patch.placed(np.eye(4), flip)
        else:
            self.without_triangles.append(str(node))
            self.resources.note(f"{node} has no triangles; its bounding box stands in for it")
            return _box(shape.bbox(), name)
        colors = None
        if look.at_vertices:
            colors = vertex_colors(shape.bsdf(), points)
            if colors is None:
                self.resources.note(f"{node} starts grey, its BSDF knows no diffuse reflectance")
                colors = np.full((len(patch.vertices), 4), [0.5, 0.5, 0.5, 1.0], np.float32)
        uvs = None
        if patch.uvs is not None:
            material = self._with_turned_normals(material, look, mapping, patch.uvs[patch.faces])
            uvs = mapping.apply(patch.uvs).astype(np.float32)
        return Part(patch.vertices, patch.faces, patch.normals.astype(np.float32), uvs, colors, material, name)

    def _with_turned_normals(self, material: Material, look: Look, mapping: Mapping, corner: np.ndarray) -> Material:
        """
        The material with its normal map in the tangent frames of MikkTSpace instead of Mitsuba's.

        ``corner``, shape (F, 3, 2), are the texture coordinates of the faces.
        """
        if material.normal is None:
            return material
        linear = np.eye(2) if mapping.transform is None else mapping.transform[:, :2]
        if linear[0, 1] or linear[1, 0]:
            self.resources.note(
                f"the normal map of '{material.name}' is turned by its UV transform; it starts unturned"
            )
        (a, b), (c, d) = ((corner[:, k] - corner[:, 0]).T for k in (1, 2))
        area = a * d - b * c  # positive where mirrored: v runs down the image
        mirrored = np.sum(area) > 0 and not look.normal_follows_charts
        if not look.normal_follows_charts and min((area > 0).mean(), (area < 0).mean()) > 0.01:
            self.resources.note(f"mirrored charts of '{material.name}' start with their normal map upside down")
        signs = (1.0 if linear[0, 0] > 0 else -1.0, 1.0 if (linear[1, 1] > 0) != mirrored else -1.0, 1.0)
        key = id(material), signs
        if key not in self._turned:
            self._turned[key] = replace(material, normal=material.normal * np.array(signs, np.float32))
        return self._turned[key]


def _matrix(transform) -> np.ndarray:
    """A transform of Mitsuba, or None for the identity, as shape (4, 4), float64."""
    return np.eye(4) if transform is None else np.array(transform.matrix, np.float64).reshape(4, 4)


def _mesh_patch(mesh: mi.Mesh) -> tuple[Patch, mi.SurfaceInteraction3f]:
    """
    Triangles of a mesh, apart where it is shaded flat, and Mitsuba's interaction at each vertex.

    Mitsuba shades by the normals alone; a mirrored mesh is wound against them and is rewound here.
    """
    vertices = mesh_positions(mesh).numpy().reshape(-1, 3).astype(np.float64)
    faces, normals, uvs = mesh_faces(mesh), mesh_normals(mesh), mesh_uvs(mesh)
    first = np.zeros(len(vertices), np.int64)  # some corner at each vertex, as 3 face + corner
    first[faces.ravel()] = np.arange(faces.size)
    p = vertices[faces]
    area = area_vectors(p)
    if normals is not None and np.einsum("fi,fi->", area, normals[faces].sum(1)) < 0:
        rewound = faces[:, ::-1]
    else:
        rewound = faces
    if normals is None:
        first = np.arange(faces.size)
        normals = np.repeat(area, 3, axis=0)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        vertices, uvs = p.reshape(-1, 3), None if uvs is None else uvs[faces.ravel()]
        rewound = first.reshape(-1, 3)
    pi = dr.zeros(mi.PreliminaryIntersection3f, len(vertices))
    pi.valid, pi.t = dr.full(mi.Bool, True, len(vertices)), dr.full(mi.Float, 1, len(vertices))
    pi.prim_index = upload(mi.UInt32, first // 3)
    pi.prim_uv = upload(mi.Point2f, np.stack([first % 3 == 1, first % 3 == 2], 1))
    pi.shape = mi.ShapePtr(mesh)
    ray = dr.zeros(mi.Ray3f, len(vertices))
    ray.d = mi.Vector3f(0, 0, 1)
    return Patch(vertices, rewound, normals, uvs), pi.compute_surface_interaction(ray)


def _grid_patch(shape: mi.Shape, name: str) -> tuple[Patch, mi.SurfaceInteraction3f]:
    """
    The isosurface of a grid of distances over the unit cube, and its vertices as textures see them.
    """
    params = mi.traverse(shape)
    grid = np.array(params["grid"].numpy()[..., 0].T, np.float32)  # from z, y, x
    positions, faces = marching_cubes(grid, np.zeros(3), 1 / (np.array(grid.shape) - 1), name)
    normals = vertex_normals(positions, faces)
    patch = Patch(positions, faces, normals, np.zeros((len(positions), 2)))
    patch = patch.placed(_matrix(params["to_world"]))
    return replace(patch, uvs=None), _points(patch)


def _points(patch: Patch) -> mi.SurfaceInteraction3f:
    """Vertices of a tessellated shape, as textures see them."""
    assert patch.uvs is not None
    si = dr.zeros(mi.SurfaceInteraction3f, len(patch.vertices))
    si.p, si.uv, si.n = (
        upload(mi.Point3f, patch.vertices),
        upload(mi.Point2f, patch.uvs),
        upload(mi.Normal3f, patch.normals),
    )
    si.sh_frame = mi.Frame3f(si.n)
    return si


def _box(bounds: mi.ScalarBoundingBox3f, name: str) -> Part:
    """The twelve triangles of a bounding box."""
    low, high = np.array(bounds.min, np.float64).ravel(), np.array(bounds.max, np.float64).ravel()
    corner = np.indices((2, 2, 2)).reshape(3, -1).T  # (8, 3)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Part(low + corner * (high - low), faces, name=name)
