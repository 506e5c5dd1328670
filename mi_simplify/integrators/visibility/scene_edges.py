"""
The meshes of a plain Mitsuba scene and all that can jump in pictures of it, for the ``direct_edge`` plugin.
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import UserError
from ...machine.meshes import NORMALS, POSITIONS, MovingMesh, mesh_faces, mesh_positions
from ...machine.upload import upload
from ...model.topology import weld
from ..edge_rays import AT_EDGE
from ..edge_set import EdgeSet
from ..edges import edge_table
from ..gbuffer import MISS
from .crossings import Crossings, Eyes
from .film_edges import FilmEdges
from .horizon import Horizon
from .projections import Projections
from .shadow_borders import sample_borders


class SceneEdges:
    """
    The edges of all triangle meshes of a scene, over positions welded per mesh.

    Topology is found once a scene; positions are read from the shapes at every call. Only shapes are held: a scene
    holds its integrator, whose edges must not hold the scene, or neither is ever freed.
    """

    def __init__(self, scene: mi.Scene):
        shapes = list(scene.shapes())
        # Mitsuba's rectangle says that it is a mesh, and has no vertices.
        self._shapes = [s for s in shapes if s.is_mesh() and POSITIONS in mi.traverse(s)]
        own = {id(s) for s in self._shapes}
        self._others = [s for s in shapes if id(s) not in own]
        gather, tables, faces, n_positions = [], [], [], 0
        for mesh in self._shapes:
            vertices = dr.detach(mesh_positions(mesh)).numpy().reshape(-1, 3)
            _, index = weld(vertices)
            first = np.full(index.max(initial=-1) + 1, -1, np.int64)
            first[index[::-1]] = np.arange(len(index))[::-1]
            gather.append(first)
            corner = mesh_faces(mesh)
            face = index[corner]
            keys = _shading_keys(mesh, corner)
            tables.append((face, keys))
            faces.append(face + n_positions)
            n_positions += len(first)
        self.edges: FilmEdges | None = None
        self.horizon: Horizon | None = None
        self._bent: list[mi.Mesh] = []
        if faces:
            key_offset = np.cumsum([0] + [int(k.max(initial=0)) + 1 for _, k in tables[:-1]])
            keys = np.concatenate([k + o for (_, k), o in zip(tables, key_offset, strict=True)])
            self._faces, self._keys = np.concatenate(faces), keys
            self.edges = FilmEdges(edge_table(self._faces, keys), self._faces)
            self._find_horizon(faces)
        self._first = [upload(mi.UInt32, g) for g in gather]
        # By the number that Dr.Jit's registry gives a shape, as hits carry it.
        numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]) for s in self._shapes]
        first_face = np.full(max(numbers, default=0) + 1, MISS, np.int64)
        first_face[numbers] = np.cumsum([0, *map(len, faces)])[:-1]
        self._first_face = upload(mi.UInt32, first_face)

    def is_of(self, scene: mi.Scene) -> bool:
        """Whether the topology is that of this scene."""
        return {id(s) for s in self._shapes + self._others} == {id(s) for s in scene.shapes()}

    def _find_horizon(self, welded: list[np.ndarray]) -> None:
        """
        The faces whose shading may jump where their interpolated normal turns away from the viewer.
        """
        bent = [k for k, m in enumerate(self._shapes) if m.has_vertex_normals() and _turns_black(m)]
        self._bent = [self._shapes[k] for k in bent]
        if self._bent:
            first = np.cumsum([0] + [m.vertex_count() for m in self._bent[:-1]])
            corners = [mesh_faces(m) + k for m, k in zip(self._bent, first, strict=True)]
            self.horizon = Horizon(np.concatenate(corners), np.concatenate([welded[k] for k in bent]))

    def _face(self, si: mi.SurfaceInteraction3f) -> mi.UInt32:
        """
        Faces of hits, numbered as in :attr:`edges`; beyond all faces where a hit is on another shape or on none.
        """
        number = dr.reinterpret_array(mi.UInt32, si.shape)
        known = number < dr.width(self._first_face)
        first = dr.select(known, dr.gather(mi.UInt32, self._first_face, number, known), MISS)
        return dr.select(first != MISS, first + si.prim_index, MISS)

    def at_crossing(self, si: mi.SurfaceInteraction3f, c: Crossings, depth: mi.Float) -> mi.Bool:
        """
        Whether hits lie at crossings that are ``depth`` away from the viewer, and not before or behind them.
        """
        is_near = dr.squared_norm(si.p - c.p) < dr.square(depth * AT_EDGE)
        assert self.edges is not None  # there is a crossing, so there are edges
        return is_near | self.edges.touches(self._face(si), c.end0, c.end1)

    def crossings(
        self,
        scene: mi.Scene,
        positions: mi.Float,
        projections: Projections,
        lights: Eyes | None,
        n: int,
        seed: mi.UInt32,
        image: mi.Float | None,
    ) -> Iterator[Crossings]:
        """
        Samples of all curves across which the image may jump: edges, horizons inside faces, borders of shadows.

        Parameters
        ----------
        positions : mi.Float
            As of :meth:`moving_positions`.
        lights : Eyes or None
            Lights that cast sharp shadows, where there are shadows.
        n : int
            How many samples of edges; a quarter of them of horizons, whose jumps are small, and half of borders of
            shadows.
        """
        assert self.edges is not None
        yield self.edges.sample(positions, projections, n, seed, image, lights)
        if self.horizon is not None:
            bent, normals = (_joined([mi.traverse(m)[key] for m in self._bent]) for key in (POSITIONS, NORMALS))
            yield self.horizon.sample(bent, normals, projections, n // 4, seed + 0x632BE5AB)
        if lights is not None:

            def plane(si: mi.SurfaceInteraction3f) -> tuple[mi.Point3f, mi.Vector3f, list[mi.UInt32]]:
                return self._plane(si, positions)

            yield sample_borders(self.edges, positions, lights, projections, scene, plane, n // 2, seed + 0x2545F491)

    def _plane(
        self, si: mi.SurfaceInteraction3f, positions: mi.Float
    ) -> tuple[mi.Point3f, mi.Vector3f, list[mi.UInt32]]:
        """
        A point and the normal of the plane that is hit, attached on our meshes where these move, and two corners of the
        face (:data:`MISS` on other shapes).
        """
        assert self.edges is not None
        face = self._face(si)
        ours = face != MISS
        index = [dr.gather(mi.UInt32, c, face, ours) for c in self.edges.faces]
        a, b, c = (dr.gather(mi.Point3f, positions, i, ours) for i in index)
        n = dr.cross(b - a, c - a)
        corners = [dr.select(ours, i, MISS) for i in index[:2]]
        return dr.select(ours, a, dr.detach(si.p)), dr.select(ours, n, mi.Vector3f(dr.detach(si.n))), corners

    def _refuse_moving_groups(self, scene: mi.Scene) -> None:
        """
        Raise where a mesh moves that is in the scene only through instances.
        """
        # By the variable: shapes without an id in a file have other names here than in the scene's parameters.
        own = {mesh_positions(s).index for s in self._shapes}
        for key, value in mi.traverse(scene):
            if key.endswith("." + POSITIONS) and dr.grad_enabled(value) and value.index not in own:
                raise UserError(
                    f"direct_edge: '{key}' moves inside an instance, whose silhouette has no gradient here;"
                    " place the mesh itself in the scene"
                )

    def moving_positions(self, scene: mi.Scene, sensor: mi.Sensor, lights: Eyes | None) -> mi.Float | None:
        """
        Welded positions of all meshes, flat, attached where they move; None where nothing visible moves.

        Raises
        ------
        UserError
            A shape moves whose silhouette is not handled.
        """
        camera_moves = _attached(sensor)
        for shape in self._others:
            if camera_moves or _attached(shape):
                raise UserError(
                    f"direct_edge: shape '{shape.id()}' is no triangle mesh, its moving silhouette has no gradient"
                    " here; turn it into a mesh, or keep it and the camera still"
                )
        if self._others:
            self._refuse_moving_groups(scene)
        moves = camera_moves or any(dr.grad_enabled(mesh_positions(mesh)) for mesh in self._shapes)
        moves |= lights is not None and dr.grad_enabled(lights.packets)
        normals = [mi.traverse(m)[NORMALS] for m in self._bent]
        if self.edges is None or not (moves or any(dr.grad_enabled(n) for n in normals)):
            return None
        return self.positions()

    def positions(self) -> mi.Float:
        """
        Welded positions of all meshes, flat, attached where they are.
        """
        positions = [mesh_positions(mesh) for mesh in self._shapes]
        return _joined([dr.ravel(dr.gather(mi.Point3f, p, i)) for p, i in zip(positions, self._first, strict=True)])

    def outlines(self) -> tuple[EdgeSet, MovingMesh]:
        """
        The edges for the batched renderer's search of outlines, and all meshes as one that rays are traced against.
        """
        positions = dr.detach(self.positions()).numpy().reshape(-1, 3)
        edges = EdgeSet(edge_table(self._faces, self._keys), self._faces, positions=positions)
        return edges, MovingMesh(positions, self._faces)

    def require_meshes(self, plugin: str) -> None:
        """
        Raise where a shape is no triangle mesh.
        """
        for shape in self._others:
            raise UserError(
                f"{plugin}: shape '{shape.id()}' is no triangle mesh; turn it into one, or take direct_edge"
            )


def _joined(arrays: list[mi.Float]) -> mi.Float:
    return arrays[0] if len(arrays) == 1 else dr.concat(arrays)


#: Parameters by which a shape, sensor or light moves; the rest is its look.
_MOTION = ("to_world", "position", "direction", "x_fov", "center", "radius", "p0", "p1", "grid", "control_points")


def _attached(thing: mi.Object) -> bool:
    """
    Whether a parameter by which this object itself moves (not a texture of it) carries a gradient.
    """
    return any(key in _MOTION and dr.grad_enabled(value) for key, value in mi.traverse(thing))


def _shading_keys(mesh: mi.Mesh, faces: np.ndarray) -> np.ndarray:
    """
    An index per corner, equal where two faces shade alike: of the vertex, or of the face where that shades by itself.
    """
    if not mesh.has_vertex_normals() or _follows_face(mesh):
        return np.repeat(np.arange(len(faces))[:, None], 3, axis=1)
    # Not by the value of normal and UV: Mitsuba computes normals anew, per split vertex, as soon as positions move.
    return faces


def _follows_face(mesh: mi.Mesh) -> bool:
    """
    Whether the shading turns with ∂p/∂u, which in Mitsuba belongs to the face: normal and bump maps, anisotropy.
    """
    bsdf = mesh.bsdf()
    if getattr(bsdf, "mesh_tangents", False):
        return False
    maps = [key for key, _ in mi.traverse(bsdf) if "normal" in key or "nested_texture" in key]
    return bool(maps) or mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic)


def _turns_black(mesh: mi.Mesh) -> bool:
    """
    Whether what a mesh shows may jump where its shading normal turns away from the viewer.
    """
    # `ggx_gamma` turns such normals continuously.
    return mesh.is_emitter() or not hasattr(mesh.bsdf(), "shading_frame")
