"""
Meshes of a USD stage: polygons, primvars and bound materials as parts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pxr import Usd, UsdGeom, UsdShade, UsdSkel
from scipy.sparse import csr_array

from ...errors import MeshError
from ...machine import memory
from ...model.asset import FEWER_INSTANCES, PER_CORNER, Material, Part
from ...model.rig import Skin
from ..mapping import Mapping, placed
from ..polygons import smooth_normals, split_corners, unique_rows
from ..resources import Resources
from ..triangulate import triangulate
from ..validate import check_indices
from .material import bound_material, display_material, material_path, read_usd_material
from .primitives import primitive_mesh
from .skeleton import Skeletons
from .subdivide import Cage, refined
from .values import TIME, array

#: Schemes that smooth.
_SCHEMES = ("catmullClark", "loop")

#: How often a surface is subdivided, and how many faces that may make of one mesh.
_TIMES, _MOST_FACES = 2, 200_000

_UV_NAMES = ("st", "st0", "st_0", "UVMap", "uv", "uvs", "map1", "UVW", "Texture_uv")


class Meshes:
    """
    The meshes of a stage; each of their materials is read once.

    Parameters
    ----------
    resources : Resources
        Takes the notes.
    skeletons : Skeletons
    """

    def __init__(self, resources: Resources, skeletons: Skeletons):
        self.resources, self._skeletons = resources, skeletons
        self._materials: dict[str, tuple[Material, tuple[Mapping, ...], str | None]] = {}
        self._one_sided: dict[int, tuple[Material, Material]] = {}

    def parts(self, prim: Usd.Prim, query: UsdSkel.SkinningQuery | None = None) -> list[Part]:
        """
        A mesh as parts, one for each of its materials; skinned where ``query`` says how.

        They are of one side where the file says so, not where that is the default alone: viewers of USD show both then.

        Raises
        ------
        MeshError
            Face counts and indices that do not fit together.
        """
        found = self._parts(prim, query)
        sides = UsdGeom.Gprim(prim).GetDoubleSidedAttr()
        if not sides.HasAuthoredValue() or sides.Get(TIME):
            return found
        return [replace(part, material=self._of_one_side(part.material)) for part in found]

    def _of_one_side(self, material: Material) -> Material:
        """The same object for all parts of a material."""
        return self._one_sided.setdefault(id(material), (material, replace(material, double_sided=False)))[1]

    def _parts(self, prim: Usd.Prim, query: UsdSkel.SkinningQuery | None) -> list[Part]:
        solid = primitive_mesh(prim)
        if solid is not None:
            return [self._solid(prim, *solid)]
        mesh, name, model = UsdGeom.Mesh(prim), prim.GetName(), self.resources.model.name
        points = array(mesh.GetPointsAttr().Get(TIME), np.float64, 3)
        counts = array(mesh.GetFaceVertexCountsAttr().Get(TIME), np.int64)
        index = array(mesh.GetFaceVertexIndicesAttr().Get(TIME), np.int64)
        if not len(counts) or not len(points):
            self.resources.note(f"'{prim.GetPath()}' was left out: it has no faces")
            return []
        if counts.min() < 0 or counts.sum() != len(index):
            raise MeshError(
                f"{model}: the faces of part '{name}' ask for {counts.sum()} indices, there are {len(index)}"
            )
        memory.require(PER_CORNER * len(index), f"{model}: '{name}' of {len(index):,} corners", FEWER_INSTANCES)
        check_indices(index, len(points), model, name)
        reader = _Corners(prim, index, np.repeat(np.arange(len(counts)), counts), len(points), self.resources)
        n_faces, face = len(counts), np.arange(len(counts))
        times = self._subdivisions(mesh, name, len(counts), query is not None)
        if times:
            cage, face, reader.weights = refined(_cage(mesh, points, index, counts), scheme_of(mesh), times)
            points, index, counts = cage.points, cage.index, cage.counts
        corners, polygon = triangulate(points, index, counts, model)
        polygon = face[polygon]
        holes = array(mesh.GetHoleIndicesAttr().Get(TIME), np.int64)
        if len(holes):
            keep = ~np.isin(polygon, holes)
            corners, polygon = corners[keep], polygon[keep]
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            corners = corners[:, ::-1]

        owner, materials = self._owners(prim, n_faces)
        groups = [(m, corners[owner[polygon] == k]) for k, m in enumerate(materials)]
        groups = [(m, c) for m, c in groups if len(c)]
        normals = reader.normals(mesh)
        if normals is None and len(groups) > 1:
            normals = smooth_normals(points, index[corners]), index
        skin = None if query is None else self._skeletons.skin(prim, query, points)
        parts = [self._part(name, m, c, points, index, normals, reader, skin) for m, c in groups]
        return parts if len(parts) == 1 else [replace(p, name=f"{name}_{k}") for k, p in enumerate(parts)]

    def _subdivisions(self, mesh: UsdGeom.Mesh, name: str, n_faces: int, is_skinned: bool) -> int:
        """How often the faces of a mesh are split, with a line on it."""
        scheme, note = scheme_of(mesh), self.resources.note
        if scheme not in _SCHEMES:
            return 0
        counts = array(mesh.GetFaceVertexCountsAttr().Get(TIME), np.int64)
        reason = None
        if not mesh.GetSubdivisionSchemeAttr().HasAuthoredValue():
            reason = "is one by default only"
        elif mesh.GetNormalsAttr().HasAuthoredValue():
            reason = "has normals of its own"
        elif is_skinned:
            reason = "is skinned"
        elif counts.min() < 3 or (scheme == "loop" and counts.max() > 3):
            reason = "has faces that its scheme cannot split"
        if reason is not None:
            note(f"'{name}', a {scheme} surface, {reason}; its control cage is used without subdivision")
            return 0
        times = _TIMES
        while times and n_faces * 4**times > _MOST_FACES:
            times -= 1
        note(f"'{name}', a {scheme} surface, is subdivided {times} times")
        return times

    def _solid(self, prim: Usd.Prim, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> Part:
        """A sphere, cube, … of one colour: it has no texture coordinates."""
        bound = bound_material(prim)
        material, places, _ = self._material(bound)
        if bound is None:
            values = (
                UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(n) for n in ("displayColor", "displayOpacity")
            )
            color, alpha = (array(v.Get(TIME), np.float64) if v and v.HasValue() else None for v in values)
            material = display_material(
                None if color is None or len(color) < 3 else color[:3],
                None if alpha is None or not len(alpha) else alpha[0],
            )
        elif places:
            self.resources.note(f"'{prim.GetName()}' has textures but no texture coordinates; they show one texel")
        if prim.GetAttribute("orientation").Get(TIME) == UsdGeom.Tokens.leftHanded:
            faces, normals = faces[:, ::-1], -normals
        return Part(vertices, faces, normals.astype(np.float32), material=material, name=prim.GetName())

    def _part(self, name, bound, corners, points, index, normals, reader, skin: Skin | None) -> Part:
        """Corners, shape (F, 3), of one material as a part."""
        material, places, color_primvar = self._material(bound)
        flat = corners.reshape(-1)
        color_rows = None
        if bound is None:
            color, alpha = reader.primvar("displayColor", 3), reader.primvar("displayOpacity", 1)
            material, color_rows = _displayed(color, alpha)
        elif color_primvar:
            color_rows = reader.primvar(color_primvar, 3)
        attributes = [normals, color_rows, *(reader.uvs(place) for place in places or (None,))]
        corner, vertex = split_corners(index[flat], *(a[1][flat] for a in attributes if a is not None))
        chosen = flat[corner]
        of_vertex = [None if a is None else a[0][a[1][chosen]] for a in attributes]
        colors, uvs = of_vertex[1], of_vertex[2:]
        for place, found in zip(places, uvs, strict=False):
            if found is None:
                self.resources.note(f"'{name}' has textures but no primvar '{place.set}'; they show one texel")
        first, *more = (_from_the_top(x) for x in placed(places, uvs))
        if colors is not None and colors.shape[1] == 3:
            colors = np.concatenate([colors, np.ones((len(colors), 1))], axis=1)
        skin = None if skin is None else skin.taken(index[chosen])
        return Part(
            points[index[chosen]], vertex.reshape(-1, 3), of_vertex[0], first, colors, material, name, skin,
            tuple(x for x in more if x is not None),
        )  # fmt: skip

    def _owners(self, prim: Usd.Prim, n_faces: int) -> tuple[np.ndarray, list]:
        """The material of every face as an index into a list of bound materials, None where there is none."""
        materials = [bound_material(prim)]
        owner = np.zeros(n_faces, np.int64)
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            faces = array(subset.GetIndicesAttr().Get(TIME), np.int64)
            check_indices(faces, n_faces, self.resources.model.name, subset.GetPrim().GetName(), "face")
            owner[faces] = len(materials)
            materials.append(bound_material(subset.GetPrim()))
        return owner, materials

    def _material(self, bound: UsdShade.Material | None) -> tuple[Material, tuple[Mapping, ...], str | None]:
        if bound is None:
            return Material(), (), None
        key = material_path(bound)
        if key not in self._materials:
            self._materials[key] = read_usd_material(bound, self.resources)
        return self._materials[key]


def _from_the_top(uvs: np.ndarray | None) -> np.ndarray | None:
    """Texture coordinates of USD, whose v grows upwards, as ours."""
    return None if uvs is None else np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1)


def scheme_of(mesh: UsdGeom.Mesh) -> str:
    """
    'none', 'bilinear', 'catmullClark' or 'loop'.
    """
    return str(mesh.GetSubdivisionSchemeAttr().Get() or "none")


def _cage(mesh: UsdGeom.Mesh, points: np.ndarray, index: np.ndarray, counts: np.ndarray) -> Cage:
    """The mesh with its creases and corners; what of them makes no sense is as if it were not there."""
    lengths = array(mesh.GetCreaseLengthsAttr().Get(TIME), np.int64)
    chain = array(mesh.GetCreaseIndicesAttr().Get(TIME), np.int64)
    sharp = array(mesh.GetCreaseSharpnessesAttr().Get(TIME), np.float64)
    ends = np.zeros((0, 2), np.int64)
    if len(lengths) and lengths.min() >= 2 and lengths.sum() == len(chain):
        run = np.repeat(np.arange(len(lengths)), lengths)
        inside = np.flatnonzero(run[1:] == run[:-1])
        ends = np.stack([chain[inside], chain[inside + 1]], axis=1)
        sharp = sharp if len(sharp) == len(ends) else sharp[run[inside]] if len(sharp) == len(lengths) else sharp[:0]
    good = np.zeros(len(ends), bool)
    if len(ends) == len(sharp):
        good |= ((ends >= 0) & (ends < len(points))).all(axis=1)
    pinned = array(mesh.GetCornerIndicesAttr().Get(TIME), np.int64)
    strength = array(mesh.GetCornerSharpnessesAttr().Get(TIME), np.float64)
    corners = np.zeros(len(points))
    if len(pinned) == len(strength):
        known = (pinned >= 0) & (pinned < len(points))
        corners[pinned[known]] = strength[known]
    return Cage(points, index, counts, ends[good], sharp[: len(good)][good], corners)


class _Corners:
    """
    Primvars of a mesh as pairs: values, shape (N, C), and a row of them for every corner, shape (corners,).
    """

    def __init__(self, prim: Usd.Prim, index: np.ndarray, polygon: np.ndarray, n_points: int, resources: Resources):
        self.prim, self.index, self.polygon, self.n_points = prim, index, polygon, n_points
        self.resources = resources
        self.weights: csr_array | None = None
        """What takes values at the corners to those of the subdivided mesh."""

    def primvar(self, name: str, width: int) -> tuple[np.ndarray, np.ndarray] | None:
        """A primvar of the mesh or inherited from above it."""
        primvar = UsdGeom.PrimvarsAPI(self.prim).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            return None
        values = array(primvar.Get(TIME), np.float64, width)
        indices = array(primvar.GetIndices(TIME), np.int64) if primvar.IsIndexed() else None
        return self._refined(self._rows(name, values, primvar.GetInterpolation(), indices))

    def _refined(self, found: tuple[np.ndarray, np.ndarray] | None) -> tuple[np.ndarray, np.ndarray] | None:
        if found is None or self.weights is None:
            return found
        return unique_rows(self.weights @ found[0][found[1]])

    def normals(self, mesh: UsdGeom.Mesh) -> tuple[np.ndarray, np.ndarray] | None:
        """``primvars:normals``, else ``normals``; a subdivided surface has its own."""
        if self.weights is not None:
            return None
        found = self.primvar("normals", 3)
        attribute = mesh.GetNormalsAttr()
        if found is not None or not attribute.HasValue():
            return found
        values = array(attribute.Get(TIME), np.float64, 3)
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
