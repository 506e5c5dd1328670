"""
The batched renderer of the fitting loop: B views of a latent surface in a few kernels, with exact gradients.

Interior derivatives come from automatic differentiation of the deferred shading, those of visibility from samples on
the edges across which the image jumps, see :mod:`.boundary`.

Rays are traced here; what is done with their hits is in functions that are traced by Dr.Jit only once.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..latent.surface import MeshTopology, Surface
from ..latent.texel_gradient import TexelGradient, TouchedBlocks
from ..latent.textures import Textures
from ..machine.frozen import frozen
from ..machine.meshes import MISS, MovingMesh
from ..scenes.views import Views
from .boundary import Boundary, backward_from
from .camera import Cameras, FilmRays, PixelRays
from .gbuffer import kept_hits, one_a_pixel, trace, with_light
from .layers import composite, composite_adjoint, composite_tangent, layered_hits, peel
from .rendered import RenderedBatch
from .shading import hit_values, shade_hits


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
        self.topology, self.form, self.shadows, self.shade, self.layers = topology, form, shadows, shade, layers
        self.tracer = MovingMesh(topology.mesh.positions, topology.mesh.position_faces)
        self.boundary = Boundary(
            topology, self.tracer, form=form, edge_fraction=edge_fraction, shadows=shadows, layers=layers
        )

    def move(self, positions: mi.Float) -> None:
        """
        Take new welded positions, width P·3 (detached), into the acceleration structure.
        """
        self.tracer.move(positions)

    def render(self, surface: Surface, textures: Textures, views: Views, *, spp: int, seed: mi.UInt32) -> RenderedBatch:
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
        surface = surface.detached()
        _, origin, direction = rays.at(dr.arange(mi.UInt32, len(rays)))
        values = unpeeled = None
        if self.layers == 1:
            face, _ = trace(self.tracer.scene, origin, direction)
            if self.shade == "pixel":
                rays, face = one_a_pixel(rays, face)
            hits = kept_hits(face, face != MISS)
        else:
            face, unpeeled, _ = peel(self.tracer.scene, surface, textures, origin, direction, self.layers)
            unpeeled *= rays.weight(dr.arange(mi.UInt32, len(rays)))
            dr.eval(face, unpeeled)
            hits = layered_hits(face, self.layers)
        if hits is None:
            return RenderedBatch(dr.zeros(mi.Vector4f, detached.n_pixels), cameras.packets, rays)
        if self.shadows:
            hits = with_light(self.tracer.scene, surface, rays, hits)
        if self.layers == 1:
            image, flags = _image(surface, textures, rays, hits, self.form, gradients_wanted())
        else:
            values, flags = hit_values(surface, textures, rays, hits, self.form, gradients_wanted())
            image, ray = dr.zeros(mi.Float, detached.n_pixels * 4), hits.front_ray
            whole = composite(values, hits) * rays.weight(ray)
            dr.scatter_reduce(dr.ReduceOp.Add, image, whole, rays.pixel(ray), mode=dr.ReduceMode.Local)
            dr.eval(image)
        touched = None if flags is None else TouchedBlocks.of(textures, flags)
        return RenderedBatch(pixels(image, detached), cameras.packets, rays, hits, touched, values, unpeeled)

    def backward(
        self,
        frame: RenderedBatch,
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
                surface.detached(), textures, frame.rays, frame.hits, frame.touched, self.form, grad, by_value,
                views_move,
            )  # fmt: skip
            texels, by_views = TexelGradient(frame.touched.blocks, values), by_views + share
            if dr.grad_enabled(surface.packets):
                backward_from(surface.packets, by_surface)
        by_positions, share = self.boundary.backward(frame, grad, surface, textures, positions, seed)
        if dr.grad_enabled(positions):
            dr.accum_grad(positions, by_positions)
        by_views += share
        if views_move:
            backward_from(frame.views, by_views)
        return texels

    def forward(
        self,
        frame: RenderedBatch,
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
        moving, cameras = surface.detached(), replace(rays.cameras, packets=dr.detach(rays.cameras.packets))
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
        jumps = self.boundary.forward(frame, surface, textures, positions, seed, tangent, rates)
        if jumps is not None:
            dr.scatter_reduce(dr.ReduceOp.Add, image, *jumps)
        return pixels(image, cameras)


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
    backward_from(value, by_value)
    texels = TexelGradient.collect(textures, footprint, touched, dr.grad(offset))
    return texels.values, dr.grad(packets), dr.grad(views) if views_move else 0.0


def pixels(image: mi.Float, cameras: Cameras) -> mi.Vector4f:
    return dr.gather(mi.Vector4f, image, dr.arange(mi.UInt32, cameras.n_pixels))


def gradients_wanted() -> bool:
    """Not under ``dr.suspend_grad()``."""
    probe = mi.Float(0)
    dr.enable_grad(probe)
    return dr.grad_enabled(probe)
