"""
The batched renderer of the fitting loop: B views of a latent surface in a few kernels, with exact gradients.

Interior derivatives come from automatic differentiation of the deferred shading, those of visibility from samples on
the edges across which the image jumps: two ordinary camera rays a tiny step to either side, and the difference of
what they see.

Rays are traced here; what is done with their hits is in functions that are traced by Dr.Jit only once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..latent.surface import MeshTopology, Surface
from ..latent.texel_gradient import TexelGradient, TouchedBlocks
from ..latent.textures import Textures
from ..machine.frozen import frozen
from ..scenes.shapes import MovingMesh
from ..scenes.views import Views
from .camera import Cameras, FilmRays, PixelRays
from .edge_samples import EdgeRays, EdgeSet
from .edges import edge_table
from .gbuffer import MISS, Hits, fragment, occluded, trace
from .layers import WIDTH, composite, composite_adjoint, composite_tangent, layered_hits, peel
from .shading import shade_hits

#: What is traced: samples of a film, one ray a pixel, or those beside edges.
Rays = FilmRays | PixelRays | EdgeRays


@dataclass
class Frame:
    """
    One rendered batch: its image, and what its derivatives need.

    Parameters
    ----------
    image : mi.Vector4f, width B·height·width
        Premultiplied radiance and coverage of every pixel.
    views : mi.Float
        Packets of the cameras, attached where the views are.
    rays : FilmRays or PixelRays
        Those that are shaded; detached.
    hits : Hits or None
        None where nothing was hit.
    touched : TouchedBlocks or None
        Of the textures; None where nothing was hit, or rendered under ``dr.suspend_grad()``.
    values : mi.Vector4f or None
        Premultiplied radiance and coverage of each hit; with several layers only.
    beyond : mi.Float or None
        Coverage that one more layer would add to the pixel of each ray; with several layers only.
    """

    image: mi.Vector4f
    views: mi.Float
    rays: FilmRays | PixelRays
    hits: Hits | None = None
    touched: TouchedBlocks | None = None
    values: mi.Vector4f | None = None
    beyond: mi.Float | None = None


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
        Test the visibility of the light; a constant, the borders of shadows have no gradient. What is transparent casts
        full ones.
    shade : {'sample', 'pixel', 'centre'}
        Shade every sample; or one visible sample a pixel, at random, and weigh it by the share of the pixel's samples
        that hit, as multisampling (MSAA) does: on average that shows what shading all of them does, so that its
        derivatives are those of the same edges; or nothing but the centre of every pixel, without antialiasing.
    layers : int
        Surfaces that a camera ray goes through where their opacity is below 1; with one, what is behind the first is
        not looked at. Where two faces cut through each other their order changes along a line that is no edge of the
        mesh: this derivative is missing.
    """

    def __init__(
        self,
        topology: MeshTopology,
        *,
        form: str = "gltf",
        edge_fraction: float = 0.15,
        shadows: bool = False,
        shade: str = "sample",
        layers: int = 1,
    ):
        if layers > 1 and shade == "pixel":
            raise ValueError("with several layers every sample is shaded")
        mesh, self.shade = topology.mesh, shade
        self.topology, self.form, self.edge_fraction, self.shadows = topology, form, edge_fraction, shadows
        self.layers = layers
        self.tracer = MovingMesh(mesh.positions, mesh.position_faces)
        table = edge_table(mesh.position_faces, mesh.faces)
        self.edges = EdgeSet(table, mesh.position_faces, positions=mesh.positions, opaque=layers == 1)

    def move(self, positions: mi.Float) -> None:
        """
        Take new welded positions, width P·3 (detached), into the acceleration structure.
        """
        self.tracer.move(positions)

    def render(self, surface: Surface, textures: Textures, views: Views, *, spp: int, seed: mi.UInt32) -> Frame:
        """
        Image of a batch.

        Parameters
        ----------
        surface : Surface
            Of the positions last given to :meth:`move`.
        spp : int
            Samples per pixel, of visibility or of both.
        seed : mi.UInt32
            Opaque; the same seed gives the same sample positions.

        Notes
        -----
        Three kernels: hits of all samples; the list of those that hit (read back); their shading. Most samples of a
        view see the background, so shading and its derivative run over a fraction of them. With several layers a fourth
        puts these together.
        """
        cameras = Cameras.of(views)
        detached = replace(cameras, packets=dr.detach(cameras.packets))
        rays = PixelRays.centred(detached) if self.shade == "centre" else FilmRays(detached, spp, seed)
        surface = _detached(surface)
        _, origin, direction = rays.at(dr.arange(mi.UInt32, len(rays)))
        values = beyond = None
        if self.layers == 1:
            face, _ = trace(self.tracer.scene, origin, direction)
            if self.shade == "pixel":
                rays, face = _one_a_pixel(rays, face)
            hits = self._hits(surface, rays, face, face != MISS)
        else:
            face, beyond, _ = peel(self.tracer.scene, surface, textures, origin, direction, self.layers)
            beyond *= rays.weight(dr.arange(mi.UInt32, len(rays)))
            dr.eval(face, beyond)
            hits = self._with_light(surface, rays, layered_hits(face, self.layers))
        if hits is None:
            return Frame(dr.zeros(mi.Vector4f, detached.n_pixels), cameras.packets, rays)
        if self.layers == 1:
            image, flags = _image(surface, textures, rays, hits, self.form, _gradients_wanted())
        else:
            values, flags = _values(surface, textures, rays, hits, self.form, _gradients_wanted())
            image, ray = dr.zeros(mi.Float, detached.n_pixels * 4), hits.front_ray
            whole = composite(values, hits) * rays.weight(ray)
            dr.scatter_reduce(dr.ReduceOp.Add, image, whole, rays.pixel(ray), mode=dr.ReduceMode.Local)
            dr.eval(image)
        touched = None if flags is None else TouchedBlocks.of(textures, flags)
        return Frame(_pixels(image, detached), cameras.packets, rays, hits, touched, values, beyond)

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
        grad, texels = dr.ravel(grad_image), None
        views_move, by_views = dr.grad_enabled(frame.views), mi.Float(0)
        if frame.hits is not None and frame.touched is not None:
            by_value = None
            if frame.values is not None:
                ray = frame.hits.front_ray
                of_ray = dr.gather(mi.Vector4f, grad, frame.rays.pixel(ray)) * frame.rays.weight(ray)
                by_value = composite_adjoint(frame.values, frame.hits, of_ray)
                dr.eval(by_value)
            values, by_surface, share = _interior(
                _detached(surface), textures, frame.rays, frame.hits, frame.touched, self.form, grad, by_value,
                views_move,
            )  # fmt: skip
            texels, by_views = TexelGradient(frame.touched.blocks, values), by_views + share
            if dr.grad_enabled(surface.packets):
                _traverse(surface.packets, by_surface)
        by_positions, share = self._boundary(frame, grad, surface, textures, positions, seed)
        if dr.grad_enabled(positions):
            dr.accum_grad(positions, by_positions)
        by_views += share
        if views_move:
            _traverse(frame.views, by_views)
        return texels

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
        rays, tangent = frame.rays, dr.grad(positions)
        moving, cameras = _detached(surface), replace(rays.cameras, packets=dr.detach(rays.cameras.packets))
        for source, leaf in ((surface.packets, moving.packets), (frame.views, cameras.packets)):
            dr.enable_grad(leaf)
            dr.set_grad(leaf, dr.forward_to(source) if dr.grad_enabled(source) else 0)
        rates = dr.grad(cameras.packets)
        image = dr.zeros(mi.Float, cameras.n_pixels * 4)
        if frame.hits is not None:
            offset = dr.zeros(mi.ArrayXf, (textures.n_channels, dr.width(frame.hits.ray)))
            dr.enable_grad(offset)
            moved_rays = replace(rays, cameras=cameras)
            value, footprint = shade_hits(moving, textures, moved_rays, frame.hits, self.form, offset)
            if texel_tangent is not None:
                dr.set_grad(offset, dr.detach(texel_tangent.lookup(footprint)))
            ray = frame.hits.ray
            rate = dr.forward_to(value)
            if frame.values is not None:
                rate, ray = composite_tangent(frame.values, frame.hits, rate), frame.hits.front_ray
            dr.scatter_reduce(dr.ReduceOp.Add, image, rate * rays.weight(ray), rays.pixel(ray))
        edges = self._edge_hits(frame, surface, textures, positions, seed)
        if edges is not None:
            with dr.suspend_grad():
                jump, pixel = _jumps(edges[0], self._sides(surface, textures, *edges))
            leaf = mi.Float(dr.detach(positions))
            for array, value in ((leaf, tangent), (cameras.packets, rates)):
                dr.enable_grad(array)
                dr.set_grad(array, value)
            speed = dr.forward_to(edges[0].samples.motion(cameras, leaf))
            dr.scatter_reduce(dr.ReduceOp.Add, image, jump * speed, pixel)
        return _pixels(image, cameras)

    def _boundary(self, frame: Frame, grad: mi.Float, surface: Surface, textures: Textures, positions: mi.Float, seed):
        """
        Derivatives by positions and by the views' packets: the part of moving edges.
        """
        edges = self._edge_hits(frame, surface, textures, positions, seed)
        if edges is None:
            return 0.0, 0.0
        views_move, detached = dr.grad_enabled(frame.views), dr.detach(positions)
        if self.layers > 1:
            return _of_jumps(edges[0], self._sides(surface, textures, *edges), grad, detached, views_move)
        return _boundary(_detached(surface), textures, *edges, self.form, grad, detached, views_move)

    def _sides(self, surface: Surface, textures: Textures, rays: EdgeRays, hits: Hits) -> mi.Float:
        """
        What the rays beside all edge samples see, flat, evaluated.
        """
        if self.layers == 1:
            sides = _sides(_detached(surface), textures, rays, hits, self.form)
        else:
            values, _ = _values(_detached(surface), textures, rays, hits, self.form, False)
            sides = dr.zeros(mi.Float, 8 * dr.width(rays.samples.view))
            dr.scatter(sides, composite(values, hits), hits.front_ray)
        dr.eval(sides)
        return sides

    def _edge_hits(
        self, frame: Frame, surface: Surface, textures: Textures, positions: mi.Float, seed
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
        surface = _detached(surface)
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
            hits = self._hits(surface, rays, face, (face != MISS) & keep)
        else:
            hits = self._with_light(surface, rays, layered_hits(face, self.layers, keep))
        return None if hits is None else (rays, hits)

    def _hits(self, surface: Surface, rays: Rays, face: mi.UInt32, keep: mi.Bool) -> Hits | None:
        """
        Those of all rays that are kept; reads back how many.
        """
        dr.eval(face, keep)
        ray = dr.compress(keep)
        return self._with_light(surface, rays, Hits(ray, face, None) if dr.width(ray) else None)

    def _with_light(self, surface: Surface, rays: Rays, hits: Hits | None) -> Hits | None:
        """
        The same hits, knowing whether the light reaches them where that is asked for.
        """
        if hits is None or not self.shadows:
            return hits
        view, origin, direction = rays.at(hits.ray)
        hit = fragment(surface, dr.gather(mi.UInt32, hits.face, hits.slot), origin, direction)
        lit = ~occluded(self.tracer.scene, hit, mi.Point3f(rays.cameras.fetch(view, 4).xyz))
        return replace(hits, lit=lit)


@frozen("hits")
def _image(surface, textures, rays, hits, form, touch):
    """
    Flat image of a batch, and a flag for every block of texels that it shows.
    """
    value, footprint = shade_hits(surface, textures, rays, hits, form)
    image, pixel = dr.zeros(mi.Float, rays.cameras.n_pixels * 4), rays.pixel(hits.ray)
    value *= rays.weight(hits.ray)
    if isinstance(rays, PixelRays) or rays.spp == 1:
        dr.scatter(image, value, pixel)
    else:
        dr.scatter_reduce(dr.ReduceOp.Add, image, value, pixel, mode=dr.ReduceMode.Local)
    return image, TouchedBlocks.flags(textures, footprint) if touch else None


@frozen()
def _one_a_pixel(rays, face):
    """
    Of the samples of every pixel one that hit, and its face.
    """
    rays, chosen = PixelRays.through_visible(rays, face != MISS)
    return rays, dr.select(rays.coverage > 0, dr.gather(mi.UInt32, face, chosen), MISS)


@frozen("hits")
def _values(surface, textures, rays, hits, form, touch):
    """
    Premultiplied radiance and coverage of every hit, and a flag for every block of texels that they show.
    """
    value, footprint = shade_hits(surface, textures, rays, hits, form)
    return value, TouchedBlocks.flags(textures, footprint) if touch else None


@frozen("hits", "touched", "by_value")
def _interior(surface, textures, rays, hits, touched, form, grad, by_value, views_move):
    """
    Derivatives by the touched texels, by surface packets, and by those of the views, from those by the image or, where
    given, by the value of every hit.
    """
    packets, views = mi.Float(surface.packets), mi.Float(rays.cameras.packets)
    offset = dr.zeros(mi.ArrayXf, (textures.n_channels, dr.width(hits.ray)))
    dr.enable_grad(packets, offset)
    if views_move:
        dr.enable_grad(views)
    rays = replace(rays, cameras=replace(rays.cameras, packets=views))
    value, footprint = shade_hits(replace(surface, packets=packets), textures, rays, hits, form, offset)
    if by_value is None:
        by_value = dr.gather(mi.Vector4f, grad, rays.pixel(hits.ray)) * rays.weight(hits.ray)
    _traverse(value, by_value)
    texels = TexelGradient.collect(textures, footprint, touched, dr.grad(offset))
    return texels.values, dr.grad(packets), dr.grad(views) if views_move else 0.0


@frozen()
def _edge_samples(edges, positions, cameras, n, seed, image):
    return edges.sample(positions, cameras, n, seed, image)


def _sides(surface, textures, rays, hits, form) -> mi.Float:
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
def _boundary(surface, textures, rays, hits, form, grad, positions, views_move):
    """
    Derivatives by positions and by the views' packets.
    """
    return _carried(rays, _sides(surface, textures, rays, hits, form), grad, positions, views_move)


@frozen()
def _of_jumps(rays, sides, grad, positions, views_move):
    """
    The same from what is seen beside the edges.
    """
    return _carried(rays, sides, grad, positions, views_move)


def _carried(rays, sides, grad, positions, views_move):
    jump, pixel = _jumps(rays, sides)
    positions, views = mi.Float(positions), mi.Float(rays.cameras.packets)
    dr.enable_grad(positions)
    if views_move:
        dr.enable_grad(views)
    motion = rays.samples.motion(replace(rays.cameras, packets=views), positions)
    _traverse(motion, dr.dot(jump, dr.gather(mi.Vector4f, grad, pixel)))
    return dr.grad(positions), dr.grad(views) if views_move else 0.0


def _detached(surface: Surface) -> Surface:
    return replace(surface, packets=dr.detach(surface.packets))


def _pixels(image: mi.Float, cameras: Cameras) -> mi.Vector4f:
    return dr.gather(mi.Vector4f, image, dr.arange(mi.UInt32, cameras.n_pixels))


def _gradients_wanted() -> bool:
    """Not under ``dr.suspend_grad()``."""
    probe = mi.Float(0)
    dr.enable_grad(probe)
    return dr.grad_enabled(probe)


def _traverse(array, grad) -> None:
    dr.set_grad(array, grad)
    dr.enqueue(dr.ADMode.Backward, array)
    dr.traverse(dr.ADMode.Backward)
