"""
What the integrator sees of the latent model: positions, smooth normals and tangents, all differentiable.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.frozen import frozen
from ..machine.upload import upload
from ..model.mesh import Mesh
from ..model.tangents import face_tangents, split_mirrored
from ..model.topology import CORRECTION


@dataclass
class Surface:
    """
    Vertex data of one instant in packets of four floats: ``(p, u) (n, v) (t, w)``.

    Parameters
    ----------
    packets : mi.Float, width V·12
        Per vertex: position and u, unit normal and v, unit tangent and w. The sign of w is the handedness, its
        magnitude how far the UV moves per unit length, or 1.
    faces : mi.UInt32, width F·4
        Three vertex indices a face, and the cell of the textures that it reads.
    """

    packets: mi.Float
    faces: mi.UInt32

    def detached(self) -> Surface:
        """
        The same, without gradients.
        """
        return Surface(dr.detach(self.packets), self.faces)


class MeshTopology:
    """
    The parts of a mesh that stay while its positions move, on the device.

    Parameters
    ----------
    mesh : Mesh
        Vertices in which mirrored and unmirrored texture meet are split.
    density : bool
        Whether surfaces know how far the UV moves per unit length, which mip levels need.
    """

    def __init__(self, mesh: Mesh, density: bool = False):
        mesh = split_mirrored(mesh)
        self.mesh = mesh
        self.n_positions, self.n_vertices, self.n_faces = len(mesh.positions), len(mesh.uvs), len(mesh.faces)
        cell = np.zeros(self.n_faces, np.int64) if mesh.cell_index is None else mesh.cell_index
        faces4 = np.concatenate([mesh.faces, cell[:, None]], axis=1)
        self.faces = upload(mi.UInt32, faces4.ravel())
        self._stencil, self.has_density = _Stencil.of(mesh, density), density
        self._normals = None if mesh.own_normals is None else upload(mi.Float, mesh.own_normals.ravel())

    def surface(self, positions: mi.Float, normals: mi.Float | None = None) -> Surface:
        """
        The surface of welded positions, flat ``x0 y0 z0 …``, width P·3; gradients flow back to them, and to unit
        normals, one a normal group, flat as well, where they are given. Without them those of the mesh's own stay.

        Where there are neither, normals are fitted to those of the faces; tangents are as in MikkTSpace (paper, Sect.
        5.1): the functions of ``topology.fitted_normals`` and ``tangents.vertex_tangents``, in Dr.Jit.
        """
        normals = self._normals if normals is None else normals
        return Surface(dr.custom(_PacketsOp, self._stencil, positions, normals), self.faces)


@dataclass
class _Stencil:
    """
    What vertex data are made of the positions with.
    """

    position_index: mi.UInt32  # (V,)
    normal_index: mi.UInt32  # (V,)
    face_positions: mi.Vector3u  # (F,)
    face_normals: mi.Vector3u  # (F,)
    face_vertices: mi.Vector3u  # (F,)
    tangent_a: mi.Float  # (F,)
    tangent_b: mi.Float  # (F,)
    has_tangent: mi.Bool  # (F,)
    handedness: mi.Float  # (V,)
    uv: mi.Vector2f  # (V,)
    n_normals: int
    n_vertices: int
    metric: mi.Vector3f | None  # (F,)

    @staticmethod
    def of(mesh: Mesh, density: bool) -> _Stencil:
        uv = mesh.uvs.astype(np.float64)[mesh.faces]
        d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        _, sign = face_tangents(mesh)
        handedness = np.ones(len(mesh.uvs))
        handedness[mesh.faces[sign < 0].ravel()] = -1
        groups = mesh.normal_groups
        return _Stencil(
            position_index=upload(mi.UInt32, mesh.position_index),
            normal_index=upload(mi.UInt32, groups),
            face_positions=upload(mi.Vector3u, mesh.position_faces),
            face_normals=upload(mi.Vector3u, groups[mesh.faces]),
            face_vertices=upload(mi.Vector3u, mesh.faces),
            # t ∝ a·e1 + b·e2 is ∂p/∂u up to a positive factor, whatever the handedness.
            tangent_a=upload(mi.Float, -sign * d2[:, 1]),
            tangent_b=upload(mi.Float, sign * d1[:, 1]),
            has_tangent=upload(mi.Bool, sign != 0),
            handedness=upload(mi.Float, handedness),
            uv=upload(mi.Vector2f, mesh.uvs),
            n_normals=int(groups.max()) + 1,
            n_vertices=len(mesh.uvs),
            metric=upload(mi.Vector3f, np.stack([np.sum(a * b, axis=1) for a, b in ((d1, d1), (d1, d2), (d2, d2))], 1))
            if density
            else None,
        )

    def packets(self, positions: mi.Float, normals: mi.Float | None) -> mi.Float:
        positions = _in_fours(positions)
        face_p = [mi.Point3f(dr.gather(mi.Vector4f, positions, i).xyz) for i in self.face_positions]
        normals = self._normals(face_p) if normals is None else _in_fours(normals)
        corner_n = [mi.Vector3f(dr.gather(mi.Vector4f, normals, i).xyz) for i in self.face_normals]
        tangents = self._tangents(face_p, corner_n)

        p = dr.gather(mi.Vector4f, positions, self.position_index).xyz
        n = dr.gather(mi.Vector4f, normals, self.normal_index).xyz
        t = dr.gather(mi.Vector4f, tangents, dr.arange(mi.UInt32, self.n_vertices)).xyz
        t -= n * dr.dot(n, t)
        length2 = dr.squared_norm(t)
        # A vertex whose tangents cancel, or without UV area: the direction that the export takes, without a gradient.
        t = dr.select(length2 > 1e-12, t * dr.rsqrt(dr.maximum(length2, 1e-12)), dr.detach(_any_tangent(n)))
        return dr.ravel(mi.ArrayXf([*p, self.uv.x, *n, self.uv.y, *t, self._w(face_p)]))

    def _w(self, face_p: list[mi.Point3f]) -> mi.Float:
        """
        Handedness times the density of the UV around each vertex, the root mean square of what the two directions on
        the surface have: |∂uv/∂p|² / 2, weighted by squared areas, so that slivers, whose own is not a number, say
        nothing.

        Taken from the vertices it is continuous across edges, which that of a face is not: a jump of the mip level
        within the surface would be one that no edge sample sees.
        """
        if self.metric is None:
            return self.handedness
        e1, e2 = mi.Vector3f(face_p[1] - face_p[0]), mi.Vector3f(face_p[2] - face_p[0])
        uu, uv, vv = self.metric
        stretch = uu * dr.squared_norm(e2) - 2 * uv * dr.dot(e1, e2) + vv * dr.squared_norm(e1)
        total = dr.zeros(mi.Float, self.n_vertices * 2)
        for c in range(3):
            dr.scatter_add(total, mi.Vector2f(stretch, dr.squared_norm(dr.cross(e1, e2))), self.face_vertices[c])
        total = dr.gather(mi.Vector2f, total, dr.arange(mi.UInt32, self.n_vertices))
        return self.handedness * dr.sqrt(dr.maximum(0.5 * total.x / dr.maximum(total.y, 1e-24), 1e-12))

    def _normals(self, face_p: list[mi.Point3f]) -> mi.Float:
        n = dr.cross(face_p[1] - face_p[0], face_p[2] - face_p[0])
        area = dr.sqrt(dr.maximum(dr.squared_norm(n), 1e-24))
        group = dr.arange(mi.UInt32, self.n_normals)
        total = dr.zeros(mi.Float, self.n_normals * 4)
        for c in range(3):
            dr.scatter_add(total, mi.Vector4f(*n, area), self.face_normals[c])
        total = dr.gather(mi.Vector4f, total, group)
        scale = dr.select(total.w > 1e-11, dr.rcp(dr.maximum(total.w, 1e-11)), 0)
        mean = mi.Vector3f(total.xyz) * scale
        flat = dr.ravel(_padded(mean))
        corner = [mi.Vector3f(dr.gather(mi.Vector4f, flat, i).xyz) for i in self.face_normals]
        middle = corner[0] + corner[1] + corner[2]
        missed = dr.zeros(mi.Float, self.n_normals * 4)
        for c in range(3):
            dr.scatter_add(missed, _padded(n - 0.25 * area * (corner[c] + middle)), self.face_normals[c])
        out = mean + CORRECTION * scale * mi.Vector3f(dr.gather(mi.Vector4f, missed, group).xyz)
        length2 = dr.squared_norm(out)
        out = dr.select(length2 > 1e-12, out * dr.rsqrt(dr.maximum(length2, 1e-12)), mi.Vector3f(0, 1, 0))
        return dr.ravel(_padded(out))

    def _tangents(self, face_p: list[mi.Point3f], corner_n: list[mi.Vector3f]) -> mi.Float:
        flat = self.tangent_a * (face_p[1] - face_p[0]) + self.tangent_b * (face_p[2] - face_p[0])
        total = dr.zeros(mi.Float, self.n_vertices * 4)
        for c in range(3):
            n = corner_n[c]
            plane = lambda x, n=n: _unit(x - n * dr.dot(n, x))  # noqa: E731
            angle = _angle(plane(face_p[(c + 1) % 3] - face_p[c]), plane(face_p[(c + 2) % 3] - face_p[c]))
            dr.scatter_add(total, _padded(plane(_unit(flat)) * angle), self.face_vertices[c], self.has_tangent)
        return total


class _PacketsOp(dr.CustomOp):
    """
    :meth:`_Stencil.packets`, recorded at the first call: tracing it took longer than computing it.
    """

    def eval(self, stencil, positions, normals):
        self.stencil, self.positions, self.normals = stencil, positions, normals
        return _packets(stencil, positions, normals)

    def forward(self):
        grads = self.grad_in("positions"), None if self.normals is None else self.grad_in("normals")
        self.set_grad_out(_packets_forward(self.stencil, self.positions, self.normals, *grads))

    def backward(self):
        grads = _packets_backward(self.stencil, self.positions, self.normals, self.grad_out())
        self.set_grad_in("positions", grads[0])
        if self.normals is not None:
            self.set_grad_in("normals", grads[1])

    def name(self):
        return "Packets"


@frozen()
def _packets(stencil, positions, normals):
    return stencil.packets(positions, normals)


@frozen()
def _packets_forward(stencil, positions, normals, positions_grad, normals_grad):
    inputs, packets = _tracked(stencil, positions, normals)
    for x, grad in zip(inputs, (positions_grad, normals_grad), strict=False):
        dr.set_grad(x, grad)
        dr.enqueue(dr.ADMode.Forward, x)
    dr.traverse(dr.ADMode.Forward)
    return dr.grad(packets)


@frozen()
def _packets_backward(stencil, positions, normals, grad):
    inputs, packets = _tracked(stencil, positions, normals)
    dr.set_grad(packets, grad)
    dr.enqueue(dr.ADMode.Backward, packets)
    dr.traverse(dr.ADMode.Backward)
    return [dr.grad(x) for x in inputs]


def _tracked(stencil, positions, normals):
    """Copies of what is given, with gradients, and the packets of them."""
    inputs = [mi.Float(x) for x in (positions, normals) if x is not None]
    dr.enable_grad(inputs)
    return inputs, stencil.packets(inputs[0], inputs[1] if len(inputs) > 1 else None)


def _in_fours(flat: mi.Float) -> mi.Float:
    """Flat triples, each padded to four."""
    return dr.ravel(_padded(dr.gather(mi.Vector3f, flat, dr.arange(mi.UInt32, dr.width(flat) // 3))))


def _padded(x: mi.Vector3f) -> mi.Vector4f:
    """
    With a fourth component: fours are added to memory together, threes one by one, which takes four times as long.
    """
    return mi.Vector4f(x.x, x.y, x.z, 0)


def _any_tangent(n: mi.Vector3f) -> mi.Vector3f:
    """
    A direction in the plane of ``n``: across the axis that is farthest from it, as ``tangents.vertex_tangents`` has it.
    """
    x, y, z = dr.abs(n)
    side = dr.select(y <= z, mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    return _unit(dr.cross(dr.select((x <= y) & (x <= z), mi.Vector3f(1, 0, 0), side), n))


def _unit(x: mi.Vector3f) -> mi.Vector3f:
    """
    Unit vector, zero where there is no length.
    """
    return x * dr.rsqrt(dr.maximum(dr.squared_norm(x), 1e-30))


def _angle(a: mi.Vector3f, b: mi.Vector3f) -> mi.Float:
    """
    Angle between unit vectors, with a finite derivative at 0 and π.
    """
    return dr.atan2(dr.sqrt(dr.maximum(dr.squared_norm(dr.cross(a, b)), 1e-14)), dr.dot(a, b))
