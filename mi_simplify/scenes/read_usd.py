"""
USD in all its forms (usd, usda, usdc, usdz): meshes as parts, placements as instances.

USD speaks row vectors, has its texture origin at the bottom left, and may be Z-up or left-handed; that ends here.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils

from ..errors import AssetError, MeshError
from ..machine import memory
from .asset import FEWER_INSTANCES, PER_CORNER, PER_INSTANCE, Asset, Instance, Material, Part
from .mapping import Mapping
from .polygons import fan, smooth_normals, split_corners, unique_rows
from .resources import Resources
from .rig import Skin
from .usd_layers import LONGEST, check_layers, reason_of, rehearse
from .usd_material import display_material, read_usd_material
from .usd_skeleton import Skeletons
from .validate import check_indices

_TIME = Usd.TimeCode.EarliestTime()
_ALL = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
_UV_NAMES = ("st", "st0", "st_0", "UVMap", "uv", "uvs", "map1", "UVW", "Texture_uv")
_Z_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)


def read_usd(path: Path) -> Asset:
    """
    Read the meshes of a stage at its earliest time; the unit of length stays what it is.

    Instances (scenegraph and point instancers) share parts. Skinned meshes stand in their bind pose, and the asset has
    a rig; subdivision surfaces are taken as their control cage. Warnings of the library become notes instead of lines
    on the screen.

    Raises
    ------
    AssetError
        The stage, a layer, or a texture is missing, lies outside the file's folder, or cannot be read.
    MemoryLimitError
        Its prims or instances do not fit into memory.
    MeshError
        Face counts and indices that do not fit together.
    """
    notes: list[str] = []
    resources = Resources(path, notes)
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        rehearse(path)
        check_layers(path, resources)
        stage = Usd.Stage.Open(str(path))
        _note_diagnostics(diagnostics, resources)
        asset = _Stage(stage, resources).read()
        _note_diagnostics(diagnostics, resources)
    except Tf.ErrorException as error:
        raise AssetError(f"{path.name}: USD cannot read it: {reason_of(error)}") from error
    return replace(asset, notes=tuple(notes))


def _note_diagnostics(delegate: UsdUtils.CoalescingDiagnosticDelegate, resources: Resources) -> None:
    for item in delegate.TakeUncoalescedDiagnostics():
        text = item.commentary[:LONGEST]
        line = " ".join(re.sub(r"\(instantiating stage.*|:SDF_FORMAT_ARGS:[^@]*", "", text).split())
        missing = re.search(r"Could not open asset @([^@]+)@", line)
        if missing and "Cannot determine file format" not in line:
            reason = line.removeprefix(f"{missing[0]} for ")
            raise AssetError(f"{resources.model.name}: it refers to '{missing[1]}', which cannot be opened: {reason}")
        resources.note(f"USD: {line}")


class _Stage:
    def __init__(self, stage: Usd.Stage, resources: Resources):
        self.stage, self.resources = stage, resources
        self.parts: list[Part] = []
        self.instances: list[Instance] = []
        self._xforms = UsdGeom.XformCache(_TIME)
        up_axis = UsdGeom.GetStageUpAxis(stage)
        self.up = _Z_UP if up_axis == UsdGeom.Tokens.z else np.eye(4)
        self._skeletons = Skeletons(stage, resources, self.up)
        self._carriers: list[Usd.Prim | None] = []
        """Of each instance, the prim whose transform it follows; None where it has a skin."""
        self._of_mesh: dict[tuple, list[int]] = {}
        self._materials: dict[str, tuple] = {}

    def read(self) -> Asset:
        self._collect(self.stage.GetPseudoRoot(), self.up)
        if all(part.skin is None for part in self.parts):
            return Asset(tuple(self.parts), tuple(self.instances))
        rig, new, joints = self._skeletons.rig([c for c in self._carriers if c is not None])
        parts = [
            p if p.skin is None else replace(p, skin=replace(p.skin, joints=new[p.skin.joints])) for p in self.parts
        ]
        left = iter(joints)
        instances = [
            i if c is None else replace(i, joint=next(left))
            for i, c in zip(self.instances, self._carriers, strict=True)
        ]
        return Asset(tuple(parts), tuple(instances), rig=rig)

    def _collect(self, root: Usd.Prim, to_world: np.ndarray, depth: int = 0) -> None:
        """Place everything visible below a prim, its world transforms put behind ``to_world``."""
        prims = iter(Usd.PrimRange(root, _ALL))
        for prim in prims:
            imageable = UsdGeom.Imageable(prim)
            if not imageable:
                continue
            if imageable.ComputeVisibility(_TIME) == UsdGeom.Tokens.invisible:
                prims.PruneChildren()
            elif imageable.ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
                prims.PruneChildren()
                self.resources.note(f"'{prim.GetPath()}' was left out: its purpose is not to be rendered")
            elif prim.IsA(UsdGeom.PointInstancer):
                prims.PruneChildren()
                self._point_instances(UsdGeom.PointInstancer(prim), to_world, depth)
            elif prim.IsA(UsdGeom.Mesh):
                self._place(prim, to_world, depth)
            elif prim.IsA(UsdGeom.Gprim):
                self.resources.note(f"'{prim.GetPath()}' was left out: a {prim.GetTypeName()} is no mesh")

    def _world(self, prim: Usd.Prim) -> np.ndarray:
        return _matrix(self._xforms.GetLocalToWorldTransform(prim))

    def _place(self, prim: Usd.Prim, to_world: np.ndarray, depth: int) -> None:
        """One mesh as instances, of which a skinned one follows its skeleton instead of its parents."""
        query = self._skeletons.query(prim)
        if query is not None and depth:
            self.resources.note(f"'{prim.GetName()}' is skinned and placed many times; it stands in its bind pose")
            query = None
        if query is None:
            placement, parts, carrier = to_world @ self._world(prim), self._parts_of(prim), prim
        else:
            placement, carrier = self._skeletons.placement(prim, query), None
            parts = self._added(self._mesh(prim, query))
        above = prim.GetPath().GetParentPath().pathString.strip("/")
        self.instances += [Instance(part, placement, prim.GetName(), above) for part in parts]
        self._carriers += [carrier] * len(parts)

    def _added(self, parts: list[Part]) -> list[int]:
        """The numbers of new parts."""
        self.parts += parts
        return list(range(len(self.parts) - len(parts), len(self.parts)))

    def _point_instances(self, instancer: UsdGeom.PointInstancer, to_world: np.ndarray, depth: int) -> None:
        name = instancer.GetPrim().GetName()
        if depth > 8:
            raise AssetError(f"{self.resources.model.name}: point instancers are nested deeper than 8 at '{name}'")
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        which = instancer.GetProtoIndicesAttr().Get(_TIME)
        matrices = instancer.ComputeInstanceTransformsAtTime(_TIME, _TIME, applyMask=UsdGeom.PointInstancer.IgnoreMask)
        if which is None or not len(which) or len(matrices) != len(which):
            self.resources.note(f"point instancer '{name}' was left out: it places nothing")
            return
        which = np.array(which)
        check_indices(which, len(targets), self.resources.model.name, name, "prototype")
        mask = instancer.ComputeMaskAtTime(_TIME)
        shown = np.array(mask, bool) if len(mask) else np.ones(len(which), bool)
        own = to_world @ self._world(instancer.GetPrim())
        placements = own @ np.array(matrices, np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        for number, target in enumerate(targets):
            prototype = self.stage.GetPrimAtPath(target)
            if not prototype:
                raise AssetError(f"{self.resources.model.name}: prototype '{target}' of '{name}' does not exist")
            before = len(self.instances)
            # The instance transforms hold the prototype's own one already.
            self._collect(prototype, np.linalg.inv(self._world(prototype)), depth + 1)
            members, self.instances = self.instances[before:], self.instances[:before]
            self._carriers = self._carriers[:before]
            n = len(members) * int((shown & (which == number)).sum())
            what = f"{self.resources.model.name}: point instancer '{name}' of {n:,} instances"
            memory.require(PER_INSTANCE * n, what, FEWER_INSTANCES)
            for k, placement in enumerate(placements[shown & (which == number)]):
                node = f"{name}/{number}.{k}"
                self.instances += [Instance(m.part, placement @ m.to_world, m.name, node=node) for m in members]
                self._carriers += [instancer.GetPrim()] * len(members)

    def _parts_of(self, prim: Usd.Prim) -> list[int]:
        """Indices of the parts of a mesh, read at its first use; instances of a prototype share them."""
        own = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
        key = own.GetPath(), _path(_bound_material(prim))
        if key not in self._of_mesh:
            self._of_mesh[key] = self._added(self._mesh(prim))
        return self._of_mesh[key]

    def _mesh(self, prim: Usd.Prim, query: UsdSkel.SkinningQuery | None = None) -> list[Part]:
        mesh, name, model = UsdGeom.Mesh(prim), prim.GetName(), self.resources.model.name
        points = _array(mesh.GetPointsAttr().Get(_TIME), np.float64, 3)
        counts = _array(mesh.GetFaceVertexCountsAttr().Get(_TIME), np.int64)
        index = _array(mesh.GetFaceVertexIndicesAttr().Get(_TIME), np.int64)
        if not len(counts) or not len(points):
            self.resources.note(f"'{prim.GetPath()}' was left out: it has no faces")
            return []
        if counts.min() < 0 or counts.sum() != len(index):
            raise MeshError(
                f"{model}: the faces of part '{name}' ask for {counts.sum()} indices, there are {len(index)}"
            )
        memory.require(PER_CORNER * len(index), f"{model}: '{name}' of {len(index):,} corners", FEWER_INSTANCES)
        check_indices(index, len(points), model, name)
        if mesh.GetSubdivisionSchemeAttr().Get() not in (None, "none"):
            scheme = mesh.GetSubdivisionSchemeAttr().Get()
            self.resources.note(f"'{name}' is a {scheme} surface; its control cage is used without subdivision")
        corners, polygon = fan(counts)
        holes = _array(mesh.GetHoleIndicesAttr().Get(_TIME), np.int64)
        if len(holes):
            keep = ~np.isin(polygon, holes)
            corners, polygon = corners[keep], polygon[keep]
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            corners = corners[:, ::-1]

        owner, materials = self._owners(prim, len(counts))
        groups = [(m, corners[owner[polygon] == k]) for k, m in enumerate(materials)]
        groups = [(m, c) for m, c in groups if len(c)]
        reader = _Corners(prim, index, np.repeat(np.arange(len(counts)), counts), len(points), self.resources)
        normals = reader.normals(mesh)
        if normals is None and len(groups) > 1:
            normals = smooth_normals(points, index[corners]), index
        skin = None if query is None else self._skeletons.skin(prim, query, points)
        parts = [self._part(name, m, c, points, index, normals, reader, skin) for m, c in groups]
        return [p if len(parts) == 1 else _renamed(p, f"{name}_{k}") for k, p in enumerate(parts)]

    def _part(self, name, bound, corners, points, index, normals, reader, skin: Skin | None) -> Part:
        """Corners, shape (F, 3), of one material as a part."""
        material, mapping, color_primvar = self._material(bound)
        flat = corners.reshape(-1)
        color_rows = None
        if bound is None:
            color, alpha = reader.primvar("displayColor", 3), reader.primvar("displayOpacity", 1)
            material, color_rows = _displayed(color, alpha)
        elif color_primvar:
            color_rows = reader.primvar(color_primvar, 3)
        attributes = [normals, reader.uvs(mapping), color_rows]
        first, vertex = split_corners(index[flat], *(a[1][flat] for a in attributes if a is not None))
        chosen = flat[first]
        of_vertex = [None if a is None else a[0][a[1][chosen]] for a in attributes]
        uvs, colors = of_vertex[1:]
        if uvs is not None:
            if mapping is not None:
                uvs = mapping.apply(uvs, name, self.resources)
            uvs = np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1)
        elif mapping is not None:
            self.resources.note(f"'{name}' has textures but no primvar '{mapping.set}'; they show one texel")
        if colors is not None and colors.shape[1] == 3:
            colors = np.concatenate([colors, np.ones((len(colors), 1))], axis=1)
        skin = None if skin is None else skin.taken(index[chosen])
        return Part(points[index[chosen]], vertex.reshape(-1, 3), of_vertex[0], uvs, colors, material, name, skin)

    def _owners(self, prim: Usd.Prim, n_faces: int) -> tuple[np.ndarray, list]:
        """The material of every face as an index into a list of bound materials, None where there is none."""
        materials = [_bound_material(prim)]
        owner = np.zeros(n_faces, np.int64)
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            faces = _array(subset.GetIndicesAttr().Get(_TIME), np.int64)
            check_indices(faces, n_faces, self.resources.model.name, subset.GetPrim().GetName(), "face")
            owner[faces] = len(materials)
            materials.append(_bound_material(subset.GetPrim()))
        return owner, materials

    def _material(self, bound: UsdShade.Material | None) -> tuple[Material, Mapping | None, str | None]:
        if bound is None:
            return Material(), None, None
        key = _path(bound)
        if key not in self._materials:
            self._materials[key] = read_usd_material(bound, self.resources)
        return self._materials[key]


class _Corners:
    """
    Primvars of a mesh as pairs: values, shape (N, C), and a row of them for every corner, shape (corners,).
    """

    def __init__(self, prim: Usd.Prim, index: np.ndarray, polygon: np.ndarray, n_points: int, resources: Resources):
        self.prim, self.index, self.polygon, self.n_points = prim, index, polygon, n_points
        self.resources = resources

    def primvar(self, name: str, width: int) -> tuple[np.ndarray, np.ndarray] | None:
        """A primvar of the mesh or inherited from above it."""
        primvar = UsdGeom.PrimvarsAPI(self.prim).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            return None
        values = _array(primvar.Get(_TIME), np.float64, width)
        indices = _array(primvar.GetIndices(_TIME), np.int64) if primvar.IsIndexed() else None
        return self._rows(name, values, primvar.GetInterpolation(), indices)

    def normals(self, mesh: UsdGeom.Mesh) -> tuple[np.ndarray, np.ndarray] | None:
        """``primvars:normals``, else ``normals``."""
        found = self.primvar("normals", 3)
        attribute = mesh.GetNormalsAttr()
        if found is not None or not attribute.HasValue():
            return found
        values = _array(attribute.Get(_TIME), np.float64, 3)
        return self._rows("normals", values, mesh.GetNormalsInterpolation(), None) if len(values) else None

    def uvs(self, mapping: Mapping | None) -> tuple[np.ndarray, np.ndarray] | None:
        """The texture coordinates that a material names; without one the usual name, or the only ones."""
        if mapping is not None:
            return self.primvar(str(mapping.set), 2)
        primvars = UsdGeom.PrimvarsAPI(self.prim).GetPrimvarsWithValues()
        kinds = ("2f[]", "2h[]", "2d[]", "float2[]")
        two = [p.GetPrimvarName() for p in primvars if str(p.GetTypeName()).endswith(kinds)]
        name = next((n for n in _UV_NAMES if n in two), two[0] if two else None)
        return self.primvar(name, 2) if name else None

    def _rows(self, name, values, interpolation, indices) -> tuple[np.ndarray, np.ndarray] | None:
        rows = {
            "constant": lambda: np.zeros(len(self.index), np.int64),
            "uniform": lambda: self.polygon,
            "vertex": lambda: self.index,
            "varying": lambda: self.index,
            "faceVarying": lambda: np.arange(len(self.index)),
        }[interpolation]()
        n = len(values) if indices is None else len(indices)
        if len(rows) and rows.max() >= n:
            self.resources.note(
                f"'{name}' of '{self.prim.GetName()}' was left out: its {n} values are too few for '{interpolation}'"
            )
            return None
        if indices is not None:
            check_indices(indices, len(values), self.resources.model.name, self.prim.GetName(), f"value of '{name}'")
            return values, indices[rows]
        if interpolation in ("faceVarying", "uniform"):  # equal values need not split a vertex
            values, index = unique_rows(values)
            rows = index[rows]
        return values, rows


def _displayed(color, alpha) -> tuple[Material, tuple[np.ndarray, np.ndarray] | None]:
    """Material and vertex colours of a mesh that has ``displayColor`` and ``displayOpacity`` instead of a material."""
    constant_color = None if color is None or len(color[0]) > 1 else color[0][0]
    constant_alpha = None if alpha is None or len(alpha[0]) > 1 else alpha[0][0, 0]
    if color is None or constant_color is not None:
        return display_material(constant_color, constant_alpha), None
    return display_material(np.ones(3), constant_alpha), color


def _bound_material(prim: Usd.Prim) -> UsdShade.Material | None:
    for purpose in ("preview", "full"):
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(purpose)[0]
        if material:
            return material
    return None


def _path(material: UsdShade.Material | None) -> str:
    """A name that all instances of a material share."""
    if material is None:
        return ""
    prim = material.GetPrim()
    return str((prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath())


def _array(value: object, dtype, width: int | None = None) -> np.ndarray:
    """A USD array as NumPy, empty where it is not authored."""
    out = np.zeros(0) if value is None else np.array(value)
    return out.astype(dtype).reshape(-1) if width is None else out.astype(dtype).reshape(-1, width)


def _matrix(matrix: object) -> np.ndarray:
    """USD's row-vector matrix for column vectors."""
    return np.array(matrix, np.float64).T


def _renamed(part: Part, name: str) -> Part:
    return replace(part, name=name)
