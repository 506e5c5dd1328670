"""
Edges and cameras of a plain Mitsuba scene, for the ``direct_edge`` plugin.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import UserError
from ..machine.meshes import POSITIONS, mesh_faces, mesh_positions
from ..machine.upload import upload
from ..model.topology import weld
from ..scenes.views import Views
from .camera import Cameras
from .edge_rays import AT_EDGE
from .edge_samples import EdgeSamples
from .edge_set import EdgeSet
from .edges import edge_table
from .gbuffer import MISS


def sensor_cameras(sensor: mi.Sensor) -> Cameras:
    """
    A Mitsuba sensor as a batch of one camera, attached where the sensor is.

    Raises
    ------
    UserError
        The sensor is no perspective camera, its principal point is off the centre, or its film samples beyond its
        border.
    """
    params = mi.traverse(sensor)
    kind = sensor.class_name() if hasattr(sensor, "class_name") else type(sensor).__name__
    if "to_world" not in params or "x_fov" not in params or sensor.needs_aperture_sample():
        raise UserError(f"direct_edge: sensor '{kind}' has no visibility gradient here, use a `perspective` sensor")
    for axis in "xy":
        key = f"principal_point_offset_{axis}"
        if key in params and float(dr.detach(mi.Float(params[key]))[0]) != 0:
            raise UserError("direct_edge: visibility gradients need the principal point in the middle of the film")
    if sensor.film().sample_border():
        raise UserError("direct_edge: visibility gradients stop at the film's border, set its `sample_border` to false")
    to_world = mi.Matrix4f(params["to_world"].matrix)
    column = lambda k: mi.Vector3f(to_world[0, k], to_world[1, k], to_world[2, k])  # noqa: E731
    size = sensor.film().size()
    views = Views(
        origin=mi.Point3f(column(3)),
        right=-dr.normalize(column(0)),  # Mitsuba's camera x axis points left on the image
        up=dr.normalize(column(1)),
        forward=dr.normalize(column(2)),
        tan_x=dr.tan(dr.deg2rad(mi.Float(params["x_fov"])) * 0.5),
        light_position=mi.Point3f(0),
        light_intensity=mi.Color3f(0),
        frame=mi.Float(0),
        width=int(size[0]),
        height=int(size[1]),
    )
    return Cameras.of(views)


class SceneEdges:
    """
    The edges of all triangle meshes of a scene, over positions welded per mesh.

    Topology is found once a scene; positions are read from the shapes at every call. Only shapes are held: a scene
    holds its integrator, whose edges must not hold the scene, or neither is ever freed.
    """

    def __init__(self, scene: mi.Scene):
        self._shapes = [s for s in scene.shapes() if s.is_mesh()]
        self._others = [s for s in scene.shapes() if not s.is_mesh()]
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
        self.edges: EdgeSet | None = None
        if faces:
            key_offset = np.cumsum([0] + [int(k.max(initial=0)) + 1 for _, k in tables[:-1]])
            keys = np.concatenate([k + o for (_, k), o in zip(tables, key_offset, strict=True)])
            all_faces = np.concatenate(faces)
            # Materials are unknown here, so nothing is taken for granted about what lies behind.
            self.edges = EdgeSet(edge_table(all_faces, keys), all_faces)
        self._first = [upload(mi.UInt32, g) for g in gather]
        # By the number that Dr.Jit's registry gives a shape, as hits carry it.
        numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]) for s in self._shapes]
        first_face = np.full(max(numbers, default=0) + 1, MISS)
        first_face[numbers] = np.cumsum([0, *map(len, faces)])[:-1]
        self._first_face = upload(mi.UInt32, first_face)

    def is_of(self, scene: mi.Scene) -> bool:
        """Whether the topology is that of this scene."""
        return {id(s) for s in self._shapes + self._others} == {id(s) for s in scene.shapes()}

    @staticmethod
    def point(positions: mi.Float, samples: EdgeSamples) -> mi.Point3f:
        """
        Where edge samples lie in the world, attached where the positions are.
        """
        ends = [dr.gather(mi.Point3f, positions, i) for i in (samples.end0, samples.end1)]
        return dr.lerp(*ends, samples.s)

    def at_edge(self, si: mi.SurfaceInteraction3f, e: EdgeSamples, p: mi.Point3f, origin: mi.Point3f) -> mi.Bool:
        """
        Whether hits of rays from ``origin`` lie at edge samples, which are at ``p``, and not before or behind them.
        """
        is_near = dr.squared_norm(si.p - p) < dr.squared_norm(p - origin) * AT_EDGE**2
        number = dr.reinterpret_array(mi.UInt32, si.shape)
        known = number < dr.width(self._first_face)
        first = dr.select(known, dr.gather(mi.UInt32, self._first_face, number, known), MISS)
        face = dr.select(first != MISS, first + si.prim_index, MISS)
        assert self.edges is not None  # there is a sample, so there are edges
        return is_near | self.edges.touches(face, e.end0, e.end1)

    def _refuse_moving_groups(self, scene: mi.Scene) -> None:
        """
        Raise where a mesh moves that is in the scene only through instances.
        """
        own = {f"{s.id()}.{POSITIONS}" for s in self._shapes}
        for key, value in mi.traverse(scene):
            if key.endswith("." + POSITIONS) and key not in own and dr.grad_enabled(value):
                raise UserError(
                    f"direct_edge: '{key}' moves inside an instance, whose silhouette has no gradient here;"
                    " place the mesh itself in the scene"
                )

    def moving_positions(self, scene: mi.Scene, sensor: mi.Sensor) -> mi.Float | None:
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
        positions = [mesh_positions(mesh) for mesh in self._shapes]
        if self.edges is None or not (camera_moves or any(dr.grad_enabled(p) for p in positions)):
            return None
        welded = [dr.ravel(dr.gather(mi.Point3f, p, i)) for p, i in zip(positions, self._first, strict=True)]
        return welded[0] if len(welded) == 1 else dr.concat(welded)


def lights_move(scene: mi.Scene) -> bool:
    """
    Whether a light's place or direction carries a gradient, so that shadow borders move with it.
    """
    return any(_attached(e) for e in scene.emitters())


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
