"""
The part of a derivative that moving edges make: the image jumps across them, by what is seen to either side.

Two ordinary camera rays pass every sample on an edge, a tiny step to either side of it; the difference of what they see
times the speed of the edge is what the pixel gains (Li et al. 2018).
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..latent.surface import MeshTopology, Surface
from ..latent.textures import Textures
from ..machine.frozen import frozen
from ..machine.meshes import MISS, MovingMesh
from .camera import Cameras
from .edge_rays import EdgeRays
from .edge_samples import EdgeSamples
from .edge_set import EdgeSet
from .edges import edge_table
from .gbuffer import Hits, kept_hits, trace, with_light
from .layers import WIDTH, composite, layered_hits, peel
from .rendered import RenderedBatch
from .shading import hit_values, shade_hits


class Boundary:
    """
    The edges of a mesh, and what it takes to differentiate images across them.

    Parameters
    ----------
    topology : MeshTopology
    tracer : MovingMesh
        Holds the positions that rays meet.
    form, edge_fraction, shadows, layers
        As of :class:`.deferred.DeferredRenderer`.
    """

    def __init__(
        self, topology: MeshTopology, tracer: MovingMesh, *, form: str, edge_fraction: float, shadows: bool, layers: int
    ):
        mesh, self.tracer = topology.mesh, tracer
        self.form, self.edge_fraction, self.shadows, self.layers = form, edge_fraction, shadows, layers
        table = edge_table(mesh.position_faces, mesh.faces)
        self.edges = EdgeSet(table, mesh.position_faces, positions=mesh.positions, opaque=layers == 1)

    def backward(
        self,
        frame: RenderedBatch,
        grad: mi.Float,
        surface: Surface,
        textures: Textures,
        positions: mi.Float,
        seed: mi.UInt32,
    ) -> tuple[mi.Float | float, mi.Float | float]:
        """
        Derivatives by positions and by the views' packets, from ``grad``, those by the flat image.
        """
        found = self._hits(frame, surface, textures, positions, seed)
        if found is None:
            return 0.0, 0.0
        views_move, detached = dr.grad_enabled(frame.views), dr.detach(positions)
        if self.layers > 1:
            return _of_sides(found[0], self._sides(surface, textures, *found), grad, detached, views_move)
        return _of_hits(surface.detached(), textures, *found, self.form, grad, detached, views_move)

    def forward(
        self,
        frame: RenderedBatch,
        surface: Surface,
        textures: Textures,
        positions: mi.Float,
        seed: mi.UInt32,
        by_positions: mi.Float,
        by_views: mi.Float,
    ) -> tuple[mi.Vector4f, mi.UInt32] | None:
        """
        What pixels gain along tangents of positions and of the views' packets, and which pixels; None for nothing.
        """
        found = self._hits(frame, surface, textures, positions, seed)
        if found is None:
            return None
        rays, cameras = found[0], frame.rays.cameras
        with dr.suspend_grad():
            jump, pixel = _jumps(rays, self._sides(surface, textures, *found))
        leaf, views = mi.Float(dr.detach(positions)), mi.Float(dr.detach(cameras.packets))
        for array, tangent in ((leaf, by_positions), (views, by_views)):
            dr.enable_grad(array)
            dr.set_grad(array, tangent)
        speed = dr.forward_to(rays.samples.motion(replace(cameras, packets=views), leaf))
        return jump * speed, pixel

    def _sides(self, surface: Surface, textures: Textures, rays: EdgeRays, hits: Hits) -> mi.Float:
        """
        What the rays beside all edge samples see, flat, evaluated.
        """
        if self.layers == 1:
            sides = _sides(surface.detached(), textures, rays, hits, self.form)
        else:
            values, _ = hit_values(surface.detached(), textures, rays, hits, self.form, False)
            sides = dr.zeros(mi.Float, 8 * dr.width(rays.samples.view))
            dr.scatter(sides, composite(values, hits), hits.front_ray)
        dr.eval(sides)
        return sides

    def _hits(
        self, frame: RenderedBatch, surface: Surface, textures: Textures, positions: mi.Float, seed: mi.UInt32
    ) -> tuple[EdgeRays, Hits] | None:
        """
        Rays to either side of samples on edges that are in view and move, and what they hit; None where there are none.
        """
        if self.edge_fraction == 0 or not (dr.grad_enabled(frame.views) or dr.grad_enabled(positions)):
            return None
        cameras = frame.rays.cameras
        n = max(64, int(len(frame.rays) * self.edge_fraction))
        samples = _edge_samples(self.edges, dr.detach(positions), cameras, n, seed, dr.ravel(frame.image))
        rays, lane = EdgeRays(cameras, samples, 1.0 if self.layers == 1 else WIDTH), dr.arange(mi.UInt32, 2 * n)
        surface = surface.detached()
        _, origin, direction = rays.at(lane)
        if self.layers == 1:
            face, t = trace(self.tracer.scene, origin, direction)
            seen = (face != MISS) & rays.seen(lane, face, self.edges, direction, t)
        else:
            at_edge = lambda face, t: rays.seen(lane, face, self.edges, direction, t)  # noqa: E731
            face, _, seen = peel(self.tracer.scene, surface, textures, origin, direction, self.layers, at_edge)
        dr.eval(face, seen)
        shown = samples.shows(*(dr.gather(mi.Bool, seen, dr.arange(mi.UInt32, n) * 2 + k) for k in (0, 1)))
        keep = dr.gather(mi.Bool, shown, lane // 2)
        if self.layers == 1:
            hits = kept_hits(face, (face != MISS) & keep)
        else:
            hits = layered_hits(face, self.layers, keep)
        if hits is None:
            return None
        return rays, with_light(self.tracer.scene, surface, rays, hits) if self.shadows else hits


@frozen()
def _edge_samples(
    edges: EdgeSet, positions: mi.Float, cameras: Cameras, n: int, seed: mi.UInt32, image: mi.Float
) -> EdgeSamples:
    return edges.sample(positions, cameras, n, seed, image)


def _sides(surface: Surface, textures: Textures, rays: EdgeRays, hits: Hits, form: str) -> mi.Float:
    """
    What the rays beside all edge samples see, flat.
    """
    sides = dr.zeros(mi.Float, 8 * dr.width(rays.samples.view))
    dr.scatter(sides, shade_hits(surface, textures, rays, hits, form)[0], hits.ray)
    return sides


def _jumps(rays: EdgeRays, sides: mi.Float) -> tuple[mi.Vector4f, mi.UInt32]:
    """
    What a pixel gains where an edge moves by one pixel along its normal, and which pixel that is, for every sample.
    """
    e = rays.samples
    low = dr.arange(mi.UInt32, dr.width(e.view)) * 2
    jump = dr.gather(mi.Vector4f, sides, low) - dr.gather(mi.Vector4f, sides, low + 1)
    return jump * e.weight, rays.cameras.pixel(e.view, e.x, e.y)


@frozen("hits")
def _of_hits(
    surface: Surface,
    textures: Textures,
    rays: EdgeRays,
    hits: Hits,
    form: str,
    grad: mi.Float,
    positions: mi.Float,
    views_move: bool,
) -> tuple[mi.Float, mi.Float | float]:
    """
    Derivatives by positions and by the views' packets.
    """
    return _carried(rays, _sides(surface, textures, rays, hits, form), grad, positions, views_move)


@frozen()
def _of_sides(
    rays: EdgeRays, sides: mi.Float, grad: mi.Float, positions: mi.Float, views_move: bool
) -> tuple[mi.Float, mi.Float | float]:
    """
    The same, from what is seen beside the edges.
    """
    return _carried(rays, sides, grad, positions, views_move)


def _carried(
    rays: EdgeRays, sides: mi.Float, grad: mi.Float, positions: mi.Float, views_move: bool
) -> tuple[mi.Float, mi.Float | float]:
    """
    Derivatives by positions and by the views' packets, from those by the flat image.
    """
    jump, pixel = _jumps(rays, sides)
    positions, views = mi.Float(positions), mi.Float(rays.cameras.packets)
    dr.enable_grad(positions)
    if views_move:
        dr.enable_grad(views)
    motion = rays.samples.motion(replace(rays.cameras, packets=views), positions)
    backward_from(motion, dr.dot(jump, dr.gather(mi.Vector4f, grad, pixel)))
    return dr.grad(positions), dr.grad(views) if views_move else 0.0


def backward_from(array: dr.ArrayBase, grad: dr.ArrayBase) -> None:
    """
    Carry the derivative by an array, ``grad``, to all leaves that it depends on.
    """
    dr.set_grad(array, grad)
    dr.enqueue(dr.ADMode.Backward, array)
    dr.traverse(dr.ADMode.Backward)
