"""
The displaced surface of a base mesh as a mesh operation: gradients reach base vertices and map.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from ..model.mesh import Mesh
from ..model.model import Model
from ..model.tangents import split_mirrored
from ..model.tessellation import Tessellation, bilinear
from ..scenes.views import Views
from .surface import MeshTopology, Surface


class Displaced:
    """
    Fine positions ``v + n d(t)``: v and n are interpolated from the base mesh by edge-midpoint subdivision, which is
    fixed beforehand, and d is the bilinear displacement map at the texture coordinate t (Hasselgren et al. 2021,
    Sect. 5.1). All of it is computed anew from the parameters, so that gradients reach base vertices and map.

    Where a texture seam runs, a position has two texture coordinates and takes the mean of both: no crack opens.

    Fitted for several tessellations at once, views say by their ``subdivisions`` which one they show. A coarser one is
    made on the topology of the finest all the same, whose further vertices then lie in the middle of the coarse edges,
    and have the means of the coarse normals, tangents and texture coordinates: the same surface, to the bit of its
    image. All of them are shaded with the normals of the coarsest, see :attr:`..model.model.Displacement.framed`.

    Parameters
    ----------
    model : Model
        With a displacement; its mesh is the base mesh.
    """

    def __init__(self, model: Model):
        displacement = model.displacement
        assert displacement is not None
        tessellation = Tessellation.of(model.mesh, displacement.subdivisions)
        self.base, self._height = tessellation.base, displacement.height
        self.mesh = replace(tessellation.mesh, positions=tessellation.positions(self.base.positions, self._height))
        self.parameters = {"displacement": displacement.height.ravel()}
        self._topology = MeshTopology(self.base)
        self._vertex, self._framed = _a_vertex_each(self._topology.mesh), displacement.framed
        self._edges = [tuple(upload(mi.UInt32, end) for end in edges.T) for edges in tessellation.position_edges]
        index, weight = bilinear(self.mesh.uvs, displacement.height.shape)
        where, n = self.mesh.position_index, len(self.mesh.positions)
        weight = weight / np.bincount(where, minlength=n)[where][:, None]
        self._texels = [upload(mi.UInt32, column) for column in index.T]
        self._weights = [upload(mi.Float, column) for column in weight.T]
        self._where, self._n = upload(mi.UInt32, where), n
        self._vertex_edges = [tuple(upload(mi.UInt32, end) for end in edges.T) for edges in tessellation.vertex_edges]
        self._coarser = {k: Tessellation.of(model.mesh, k).mesh for k in displacement.fitted}
        self._frame_vertex = _a_vertex_each(split_mirrored(self._coarser.get(self._framed, self.mesh)))
        self._topologies: dict[int, MeshTopology] = {}

    def positions(self, base: mi.Float, parameters: dict[str, mi.Float], views: Views) -> mi.Float:
        """See :class:`.operation.MeshOperation`."""
        level = self._level(views)
        normals = self._normals(self._topology, base, self._vertex, self._edges[:level])
        points = mi.Vector3f(dr.gather(mi.Point3f, base, dr.arange(mi.UInt32, dr.width(self._vertex))))
        for edges in self._edges[:level]:
            points = _with_midpoints(points, *edges)
        height, total = parameters["displacement"], mi.Float(0)
        for texel, weight in zip(self._texels, self._weights, strict=True):
            total = total + dr.gather(mi.Float, height, texel) * weight
        heights = dr.zeros(mi.Float, self._n)
        dr.scatter_add(heights, total, self._where)
        points += normals * dr.gather(mi.Float, heights, dr.arange(mi.UInt32, dr.width(points)))
        for edges in self._edges[level:]:
            points = _with_midpoints(points, *edges)
        return dr.ravel(points)

    @staticmethod
    def _normals(topology: MeshTopology, positions: mi.Float, vertex: mi.UInt32, edges: list) -> mi.Vector3f:
        """Unit normals of a mesh at a vertex of each of its positions, interpolated along what is appended."""
        normals = mi.Vector3f(dr.gather(mi.Vector4f, topology.surface(positions).packets, vertex * 3 + 1).xyz)
        for ends in edges:
            normals = _with_midpoints(normals, *ends)
        return normals * dr.rsqrt(dr.maximum(dr.squared_norm(normals), 1e-12))

    def _at_level(self, level: int, finest: MeshTopology, positions: mi.Float) -> tuple[MeshTopology, mi.Float]:
        """The mesh of so many subdivisions, and its own of the positions."""
        if level == len(self._edges):
            return finest, positions
        if level not in self._topologies:
            self._topologies[level] = MeshTopology(self._coarser[level], finest.has_density)
        topology = self._topologies[level]
        return topology, dr.gather(mi.Float, positions, dr.arange(mi.UInt32, 3 * topology.n_positions))

    def _level(self, views: Views | None) -> int:
        """Subdivisions that views show; reads them where there is a choice."""
        if views is None or views.subdivisions is None or not self._coarser:
            return len(self._edges)
        level = int(views.subdivisions.numpy()[0])
        return level if level in self._coarser else len(self._edges)

    def surface(
        self, topology: MeshTopology, positions: mi.Float, base: mi.Float, parameters: dict[str, mi.Float], views: Views
    ) -> Surface:
        """See :class:`.operation.MeshOperation`."""
        level, normals = self._level(views), None
        if level > self._framed:
            coarse = self._at_level(self._framed, topology, positions)
            normals = dr.ravel(self._normals(*coarse, self._frame_vertex, self._edges[self._framed : level]))
        shown, own = self._at_level(level, topology, positions)
        packets = shown.surface(own, normals).packets
        for ends in self._vertex_edges[level:]:
            packets = _with_middle_packets(packets, *ends)
        return Surface(packets, topology.faces)

    def written(self, model: Model, parameters: dict[str, np.ndarray]) -> Model:
        """See :class:`.operation.MeshOperation`."""
        assert model.displacement is not None
        height = np.asarray(parameters["displacement"], np.float32).reshape(self._height.shape)
        return replace(model, displacement=replace(model.displacement, height=height))


def _a_vertex_each(mesh: Mesh) -> mi.UInt32:
    """Of every position one of its vertices, all of which share its normal."""
    first = np.zeros(len(mesh.positions), np.int64)
    first[mesh.position_index] = np.arange(len(mesh.uvs))
    return upload(mi.UInt32, first)


def _with_middle_packets(packets: mi.Float, first: mi.UInt32, second: mi.UInt32) -> mi.Float:
    """Packets of twelve floats with the means of those at the two ends of every edge appended."""
    n, m = dr.width(packets), 12 * dr.width(first)
    dr.eval(packets)
    lane = dr.arange(mi.UInt32, m)
    edge = lane // 12
    ends = (dr.gather(mi.UInt32, index, edge) * 12 + (lane - edge * 12) for index in (first, second))
    a, b = (dr.gather(mi.Float, packets, index) for index in ends)
    out = dr.zeros(mi.Float, n + m)
    dr.scatter(out, packets, dr.arange(mi.UInt32, n))
    dr.scatter(out, 0.5 * (a + b), lane + n)
    return out


def _with_midpoints(values: mi.Vector3f, first: mi.UInt32, second: mi.UInt32) -> mi.Vector3f:
    """With the means of the two ends of every edge appended."""
    n = dr.width(values)
    flat = dr.ravel(values)
    dr.eval(flat)
    ends = [dr.gather(mi.Point3f, flat, index) for index in (first, second)]
    middle = mi.Vector3f(0.5 * (ends[0] + ends[1]))
    out = dr.zeros(mi.Float, 3 * (n + dr.width(first)))
    dr.scatter(out, values, dr.arange(mi.UInt32, n))
    dr.scatter(out, middle, dr.arange(mi.UInt32, dr.width(first)) + n)
    return mi.Vector3f(dr.gather(mi.Point3f, out, dr.arange(mi.UInt32, n + dr.width(first))))
