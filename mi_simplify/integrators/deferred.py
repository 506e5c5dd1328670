"""
The batched renderer of the fitting loop: B views of a latent surface in a few kernels, with exact gradients.

Interior derivatives come from automatic differentiation of the deferred shading, those of visibility from samples on
the edges across which the image jumps: two ordinary camera rays a tiny step to either side, and the difference of
what they see. Occluded edges give zero by themselves, so no visibility test is needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..latent.surface import MeshTopology, Surface
from ..latent.textures import Footprint, TexelGradient, Textures, TouchedBlocks
from ..scenes.shapes import MovingMesh
from ..scenes.views import Views
from .camera import Cameras, film_samples
from .edges import EdgeSamples, EdgeSet, edge_table
from .gbuffer import MISS, fragment, occluded, trace
from .shading import shade


@dataclass
class Lookup:
    """
    One texture lookup of a frame: where, and the zero that was added to it and collects its gradient.
    """

    footprint: Footprint
    offset: mi.ArrayXf
    touched: TouchedBlocks


@dataclass
class Frame:
    """
    One rendered batch: its image, and what its gradient needs.

    ``image`` holds premultiplied radiance and coverage of every pixel, width ``B·height·width``, evaluated;
    ``samples`` and ``pixel`` are those of the camera samples that hit something, None where none did. ``packets`` and
    ``cameras.packets`` are leaves of the graph: what gathers on them goes on to the surface and the views at the end.
    """

    image: mi.Vector4f
    views: mi.Float
    cameras: Cameras
    packets: mi.Float
    samples: mi.Vector4f | None
    pixel: mi.UInt32 | None
    lookup: Lookup | None
    spp: int


class DeferredRenderer:
    """
    Renders a moving, textured mesh under one point light a view.

    Parameters
    ----------
    topology : MeshTopology
    form : {'gltf', 'paper'}
        Mixing of the lobes.
    edge_fraction : float
        Edge samples for one camera sample.
    shadows : bool
        Test the visibility of the light; a constant, the borders of shadows have no gradient.
    """

    def __init__(
        self, topology: MeshTopology, *, form: str = "gltf", edge_fraction: float = 0.15, shadows: bool = False
    ):
        mesh = topology.mesh
        self.topology, self.form, self.edge_fraction, self.shadows = topology, form, edge_fraction, shadows
        self.tracer = MovingMesh(mesh.positions, mesh.position_faces)
        table = edge_table(mesh.position_faces, mesh.faces)
        self.edges = EdgeSet(table, mesh.position_faces, positions=mesh.positions)

    def move(self, positions: mi.Float) -> None:
        """
        Take new welded positions, width P·3 (detached), into the acceleration structure.
        """
        self.tracer.move(positions)

    def _shade(self, packets: mi.Float, textures: Textures, cameras: Cameras, view, face, ray, offset=None):
        """
        Radiance and coverage of rays with known hits; also the footprint of the texture lookup.
        """
        origin, direction = ray
        hit = fragment(Surface(packets, self.topology.faces), face, origin, direction)
        footprint = textures.footprint(hit.u, hit.v)
        value = textures.lookup(footprint)
        texels = textures.unpack(value if offset is None else value + offset)
        light, intensity = cameras.fetch(view, 4).xyz, cameras.fetch(view, 5).xyz
        if self.shadows:
            intensity = dr.select(occluded(self.tracer.scene, hit, mi.Point3f(light)), 0, intensity)
        return shade(hit, texels, direction, light, intensity, self.form), footprint

    def render(self, surface: Surface, textures: Textures, views: Views, *, spp: int, seed: mi.UInt32) -> Frame:
        """
        Image of a batch; keeps the graph that :meth:`backward` needs.

        Parameters
        ----------
        surface : Surface
            Of the positions last given to :meth:`move`.
        spp : int
            Samples per pixel.
        seed : mi.UInt32
            Opaque; the same seed gives the same sample positions.

        Notes
        -----
        Three kernels: hits of all samples; the list of those that hit (read back); their shading. Most samples of a
        view see the background, so shading and its derivative run over a fraction of them.
        """
        cameras = Cameras.of(views)
        attached = cameras.packets
        cameras = replace(cameras, packets=dr.detach(attached))
        if dr.grad_enabled(attached):
            dr.enable_grad(cameras.packets)
        packets = dr.detach(surface.packets)
        _, view, x, y = film_samples(cameras, spp, seed)
        face = trace(self.tracer.scene, *cameras.ray(view, x, y))[0]
        is_hit = face != MISS
        dr.eval(face, is_hit, packets)
        hits = dr.compress(is_hit)
        n_hits = dr.width(hits)
        if n_hits == 0:
            return Frame(dr.zeros(mi.Vector4f, cameras.n_pixels), attached, cameras, packets, None, None, None, spp)

        face = dr.gather(mi.UInt32, face, hits)
        pixel, view, x, y = film_samples(cameras, spp, seed, hits)
        offset = dr.zeros(mi.ArrayXf, (textures.n_channels, n_hits))
        dr.enable_grad(offset, packets)
        samples, footprint = self._shade(packets, textures, cameras, view, face, cameras.ray(view, x, y), offset)
        flags = TouchedBlocks.flags(textures, footprint)
        image = dr.zeros(mi.Float, cameras.n_pixels * 4)
        value = dr.detach(samples)
        if spp == 1:
            dr.scatter(image, value, pixel)
        else:
            dr.scatter_reduce(dr.ReduceOp.Add, image, value * (1 / spp), pixel, mode=dr.ReduceMode.Local)
        dr.eval(image, flags)
        image = dr.gather(mi.Vector4f, image, dr.arange(mi.UInt32, cameras.n_pixels))
        lookup = Lookup(footprint, offset, TouchedBlocks.of(flags))
        return Frame(image, attached, cameras, packets, samples, pixel, lookup, spp)

    def backward(
        self,
        frame: Frame,
        grad_image: mi.Vector4f,
        surface: Surface,
        textures: Textures,
        positions: mi.Float,
        seed: mi.UInt32,
    ) -> TexelGradient | None:
        """
        Carry the derivative of a loss by the image to positions and texels, and to the views where they are attached.

        Parameters
        ----------
        grad_image : mi.Vector4f, width B·height·width
            ∂loss/∂image.
        surface : Surface
            As given to :meth:`render`, attached to ``positions``.
        positions : mi.Float, width P·3
            Leaf that receives its gradient; nothing is done for it where it carries none.
        seed : mi.UInt32
            For the edge samples.

        Returns
        -------
        TexelGradient or None
            None where no sample hit the model.
        """
        grad_flat = dr.ravel(grad_image)
        dr.eval(grad_flat)
        texel_grad = None
        if frame.samples is not None:
            dr.set_grad(frame.samples, dr.gather(mi.Vector4f, grad_flat, frame.pixel) * (1 / frame.spp))
            dr.enqueue(dr.ADMode.Backward, frame.samples)
            dr.traverse(dr.ADMode.Backward)
            look = frame.lookup
            texel_grad = TexelGradient.collect(textures, look.footprint, look.touched, dr.grad(look.offset))
            packets_grad = dr.grad(frame.packets)
            dr.eval(texel_grad.values, packets_grad)  # one kernel
            if dr.grad_enabled(surface.packets):
                dr.set_grad(surface.packets, packets_grad)
                dr.enqueue(dr.ADMode.Backward, surface.packets)
                dr.traverse(dr.ADMode.Backward)
        views_move = dr.grad_enabled(frame.views)
        if self.edge_fraction > 0 and (views_move or dr.grad_enabled(positions)):
            self._boundary(frame, grad_flat, textures, positions, seed)
        if views_move:
            dr.set_grad(frame.views, dr.grad(frame.cameras.packets))
            dr.enqueue(dr.ADMode.Backward, frame.views)
            dr.traverse(dr.ADMode.Backward)
        return texel_grad

    def forward(
        self,
        frame: Frame,
        surface: Surface,
        textures: Textures,
        positions: mi.Float,
        seed: mi.UInt32,
        texel_tangent: Textures | None = None,
    ) -> mi.Vector4f:
        """
        Derivative of the image along the tangents (``dr.set_grad``) of positions and views, which are consumed.

        Parameters
        ----------
        texel_tangent : Textures, optional
            Rates of change in the layout of ``textures``.

        Returns
        -------
        mi.Vector4f, width B·height·width
        """
        tangent = dr.grad(positions)
        for source, leaf in ((surface.packets, frame.packets), (frame.views, frame.cameras.packets)):
            if dr.grad_enabled(source):
                dr.set_grad(leaf, dr.forward_to(source))
        rates = dr.grad(frame.cameras.packets) if dr.grad_enabled(frame.views) else None
        image = dr.zeros(mi.Float, frame.cameras.n_pixels * 4)
        if frame.samples is not None:
            if texel_tangent is not None:
                dr.set_grad(frame.lookup.offset, dr.detach(texel_tangent.lookup(frame.lookup.footprint)))
            value = dr.forward_to(frame.samples) * (1 / frame.spp)
            dr.scatter_reduce(dr.ReduceOp.Add, image, value, frame.pixel)
        if self.edge_fraction > 0 and (rates is not None or dr.grad_enabled(positions)):
            e, jump, pixel = self._edge_jumps(frame, textures, positions, seed)
            if dr.grad_enabled(positions):
                dr.set_grad(positions, tangent)
            if rates is not None:
                dr.set_grad(frame.cameras.packets, rates)
            speed = dr.forward_to(self._motion(frame.cameras, positions, e))
            dr.scatter_reduce(dr.ReduceOp.Add, image, jump * speed, pixel)
        return dr.gather(mi.Vector4f, image, dr.arange(mi.UInt32, frame.cameras.n_pixels))

    def _boundary(
        self, frame: Frame, grad_flat: mi.Float, textures: Textures, positions: mi.Float, seed: mi.UInt32
    ) -> None:
        """
        Add the gradient that moving edges have on the image, to ``positions`` and cameras.
        """
        e, jump, pixel = self._edge_jumps(frame, textures, positions, seed)
        motion = self._motion(frame.cameras, positions, e)
        dr.set_grad(motion, dr.dot(jump, dr.gather(mi.Vector4f, grad_flat, pixel)))
        dr.enqueue(dr.ADMode.Backward, motion)
        dr.traverse(dr.ADMode.Backward)

    def _edge_jumps(self, frame: Frame, textures: Textures, positions: mi.Float, seed: mi.UInt32):
        """
        Edge samples, what a pixel there gains where the edge moves by a pixel along its normal, and which pixel it is.
        """
        cameras = frame.cameras
        n = max(64, int(cameras.n_pixels * frame.spp * self.edge_fraction))
        with dr.suspend_grad():
            e = self.edges.sample(positions, cameras, n, seed, dr.ravel(frame.image))
            dr.eval(e)
            jump = self._jump(e, dr.detach(frame.packets), textures, cameras, n)
            return e, jump * e.weight, cameras.pixel(e.view, e.x, e.y)

    @staticmethod
    def _motion(cameras: Cameras, positions: mi.Float, e: EdgeSamples) -> mi.Float:
        """
        Where edge samples lie along the normals of their edges on the film [pixels]; only the derivative matters.

        What lies on the low side gains area where this grows.
        """
        p = dr.lerp(dr.gather(mi.Point3f, positions, e.end0), dr.gather(mi.Point3f, positions, e.end1), e.s)
        film = cameras.project(e.view, p)
        return film.x * e.nx + film.y * e.ny

    def _jump(self, e, packets: mi.Float, textures: Textures, cameras: Cameras, n: int) -> mi.Vector4f:
        """
        Radiance and coverage on the low side of each edge sample less those on its high side, width N.
        """
        def ray(lane):
            # Neighbouring lanes are the two sides of one sample: nearly the same ray.
            i = lane // 2
            take = lambda a: dr.gather(type(a), a, i)  # noqa: E731
            side = mi.Float(mi.Int32(lane - 2 * i) * 2 - 1) * take(e.step)
            view = take(e.view)
            x, y = dr.fma(side, take(e.nx), take(e.x)), dr.fma(side, take(e.ny), take(e.y))
            return view, cameras.ray(view, x, y)

        _, (origin, direction) = ray(dr.arange(mi.UInt32, 2 * n))
        face = trace(self.tracer.scene, origin, direction)[0]
        dr.eval(face)
        # Where both rays meet the same triangle the edge is hidden, and nothing jumps.
        other = dr.gather(mi.UInt32, face, dr.arange(mi.UInt32, 2 * n) ^ 1)
        sides = dr.zeros(mi.Float, 8 * n)
        hits = dr.compress((face != MISS) & (face != other))
        if dr.width(hits) > 0:
            view, rays = ray(hits)
            value, _ = self._shade(packets, textures, cameras, view, dr.gather(mi.UInt32, face, hits), rays)
            dr.scatter(sides, value, hits)
        lane = dr.arange(mi.UInt32, n) * 2
        return dr.gather(mi.Vector4f, sides, lane) - dr.gather(mi.Vector4f, sides, lane + 1)
