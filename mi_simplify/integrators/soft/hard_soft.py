"""
Soft visibility, HardSoftRas (Takimoto et al. 2022, supplement, Sect. 1.3), in the batched renderer.

A camera ray within r of an outline sees two planes: the hard one, which it meets, and a soft one, what lies just beyond
the edge, shaded there. With d the distance to the outline on the film the soft one counts

    w(d) = (1 / (1 + exp(d / σ)) - e) / (1 - 2 e),    e = 1 / (1 + exp(R / σ)),    R = min(r, δ)

and the hard one 1 - w: on the edge both count one half, from either side, and at distance R the soft one counts
nothing, so that the image is a continuous function of the vertices. It is differentiated as such, by automatic
differentiation; nothing is sampled on edges. With r = 0 it is the hard image.

Departures from the supplement: the planes are those to either side of outlines, not those of any triangle, so that no
edge inside a smooth surface shows; the soft plane is shaded at the edge, where extrapolated attributes of a face seen
edge-on would be anything; of K planes there are two.

Where two outlines come within r of each other, as a fold beside a silhouette, only the nearer one is soft: the image
jumps there, which its derivative does not know: 1 to 3 % of a gradient on a smooth mesh with folds, 2 to 7 % on a thin
tube.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ...latent.surface import MeshTopology, Surface
from ...latent.texel_gradient import TexelGradient, TouchedBlocks
from ...latent.textures import Textures
from ...machine.frozen import frozen
from ...machine.meshes import MISS
from ...scenes.views import Views
from ..boundary import backward_from
from ..camera import Cameras, FilmRays, film_samples
from ..deferred import DeferredRenderer, gradients_wanted, pixels
from ..gbuffer import kept_hits, trace, with_light
from ..rendered import RenderedBatch
from ..shading import shade_hits
from .outlines import NONE, Nearest, closest_on_segment, nearest_outlines, nothing_near


@dataclass
class SoftRays(FilmRays):
    """
    The N camera rays of a batch, and behind them one ray for each that is near an outline: to just beyond the edge.

    Parameters
    ----------
    near : Nearest
        The M that are near an outline.
    positions : mi.Float, width P·3
        Welded; where they are attached the rays beyond edges and all weights are differentiable in them.
    reach, sigma : float
        R and σ [pixels].
    """

    near: Nearest
    positions: mi.Float
    reach: float
    sigma: float

    @property
    def film(self) -> FilmRays:
        """The camera rays alone."""
        return FilmRays(self.cameras, self.spp, self.seed)

    @property
    def n_film(self) -> int:
        """N."""
        return self.cameras.n_pixels * self.spp

    def __len__(self) -> int:
        return self.n_film + dr.width(self.near.ray)

    def _place(self, index: mi.UInt32):
        """Whether rays are soft ones, and the camera rays that these belong to: pixel, view, film position."""
        n = self.n_film
        soft = index >= n
        ray = dr.select(soft, dr.gather(mi.UInt32, self.near.ray, index - n, soft), index)
        return soft, ray, *film_samples(self.cameras, self.spp, self.seed, ray)

    def _edge(self, slot: mi.UInt32, view: mi.UInt32, x: mi.Float, y: mi.Float, active) -> tuple[mi.Float, mi.Float]:
        """Closest point on the outline, film position, differentiable in positions and cameras."""
        take = lambda a: dr.gather(type(a), a, slot, active)  # noqa: E731
        a, b = (dr.gather(mi.Point3f, self.positions, take(k), active) for k in (self.near.end0, self.near.end1))
        p, q = (self.cameras.project(view, dr.lerp(a, b, take(s))) for s in (self.near.s0, self.near.s1))
        return closest_on_segment(x, y, p.x, p.y, q.x, q.y)

    def at(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.Point3f, mi.Vector3f]:
        """View, origin and unit direction of some of the rays."""
        soft, _, _, view, x, y = self._place(index)
        slot = index - self.n_film
        ex, ey = self._edge(slot, view, x, y, soft)
        ex = ex + dr.gather(mi.Float, self.near.off_x, slot, soft)
        ey = ey + dr.gather(mi.Float, self.near.off_y, slot, soft)
        return view, *self.cameras.ray(view, dr.select(soft, ex, x), dr.select(soft, ey, y))

    def source(self, index: mi.UInt32) -> mi.UInt32:
        """The camera rays that some of the rays belong to: they themselves, but for those beyond edges."""
        return self._place(index)[1]

    def pixel(self, index: mi.UInt32) -> mi.UInt32:
        """Pixel of the batch that some of the rays belong to."""
        return self._place(index)[2]

    def weight(self, index: mi.UInt32) -> mi.Float:
        """What some of the rays count in their pixels; differentiable in positions and cameras."""
        soft, ray, _, view, x, y = self._place(index)
        slot = dr.gather(mi.UInt32, self.near.slot, ray)
        is_near = slot != NONE
        ex, ey = self._edge(slot, view, x, y, is_near)
        d = dr.sqrt(dr.maximum(dr.square(x - ex) + dr.square(y - ey), 1e-12))
        low = 1 / (1 + math.exp(min(self.reach / self.sigma, 80.0)))
        w = (dr.rcp(1 + dr.exp(d / self.sigma)) - low) / (1 - 2 * low)
        w = dr.maximum(w, 0)
        return dr.select(soft, w, dr.select(is_near, 1 - w, 1)) / self.spp


def beyond_outlines(scene: mi.Scene, rays: SoftRays, face: mi.UInt32) -> tuple[Nearest, mi.UInt32]:
    """
    What the soft rays meet, and where they lead: on the edge itself to the side that the camera ray did not meet.

    Parameters
    ----------
    scene : mi.Scene
        Of the mesh alone.
    face : mi.UInt32, width N
        What the camera rays meet.
    """
    near, lane = rays.near, dr.arange(mi.UInt32, dr.width(rays.near.ray)) + rays.n_film
    met = dr.gather(mi.UInt32, face, near.ray)
    _, origin, direction = rays.at(lane)
    beyond, _ = trace(scene, origin, direction)
    same = near.at_edge & (beyond == met)
    turned = replace(near, off_x=-near.off_x, off_y=-near.off_y)
    _, origin, direction = replace(rays, near=turned).at(lane)
    other, _ = trace(scene, origin, direction, active=same)
    turn = same & (other != met)
    beyond = dr.select(turn, other, beyond)
    off_x, off_y = (dr.select(turn, -off, off) for off in (near.off_x, near.off_y))
    dr.eval(beyond, off_x, off_y)
    return replace(near, off_x=off_x, off_y=off_y), beyond


class HardSoftRenderer(DeferredRenderer):
    """
    :class:`..deferred.DeferredRenderer` with soft outlines, whose gradient is that of its own image.

    Parameters
    ----------
    topology : MeshTopology
    radius, sigma, delta : float
        r, σ and δ in halves of the film's width; σ by default r / 7, δ by default r.
    options
        ``form`` and ``shadows`` of the other renderer.
    """

    def __init__(
        self,
        topology: MeshTopology,
        *,
        radius: float = 0.01,
        sigma: float | None = None,
        delta: float | None = None,
        form: str = "gltf",
        shadows: bool = False,
    ):
        super().__init__(topology, form=form, shadows=shadows)
        self.reach = min(radius, radius if delta is None else delta)
        self.sigma = radius / 7 if sigma is None else sigma
        self._positions = mi.Float(topology.mesh.positions.ravel())

    def move(self, positions: mi.Float) -> None:
        """See :class:`..deferred.DeferredRenderer`."""
        super().move(positions)
        self._positions = mi.Float(dr.detach(positions))

    def render(self, surface: Surface, textures: Textures, views: Views, *, spp: int, seed: mi.UInt32) -> RenderedBatch:
        """See :class:`..deferred.DeferredRenderer`."""
        cameras = Cameras.of(views)
        film = FilmRays(replace(cameras, packets=dr.detach(cameras.packets)), spp, seed)
        half, surface = 0.5 * film.cameras.width, surface.detached()
        _, origin, direction = film.at(dr.arange(mi.UInt32, len(film)))
        face, _ = trace(self.tracer.scene, origin, direction)
        near = None
        if self.reach > 0:
            near = nearest_outlines(
                self.boundary.edges, self.tracer.scene, self._positions, film, half * self.reach, 3 * half * self.sigma
            )
        is_any, near = near is not None, near or nothing_near(len(film))
        rays = SoftRays(
            film.cameras, spp, seed, near, self._positions, half * self.reach, half * max(self.sigma, 1e-9)
        )  # fmt: skip
        beyond = dr.full(mi.UInt32, MISS, 1)
        if is_any:
            near, beyond = beyond_outlines(self.tracer.scene, rays, face)
            rays = replace(rays, near=near)
        both = dr.concat([face, beyond])
        hits = kept_hits(both, both != MISS)
        if hits is None:
            return RenderedBatch(dr.zeros(mi.Vector4f, film.cameras.n_pixels), cameras.packets, rays)
        if self.shadows:
            hits = with_light(self.tracer.scene, surface, rays, hits)
        image, flags = _image(
            surface, textures, film, near, hits, self._positions, rays.reach, rays.sigma, self.form, gradients_wanted()
        )
        touched = None if flags is None else TouchedBlocks.of(textures, flags)
        return RenderedBatch(pixels(image, film.cameras), cameras.packets, rays, hits, touched)

    def backward(
        self,
        frame: RenderedBatch,
        grad_image: mi.Vector4f,
        surface: Surface,
        textures: Textures,
        positions: mi.Float,
        seed: mi.UInt32,
    ) -> TexelGradient | None:
        """See :class:`..deferred.DeferredRenderer`; ``seed`` is not used."""
        if frame.hits is None or frame.touched is None:
            return None
        rays, views_move = frame.rays, dr.grad_enabled(frame.views)
        assert isinstance(rays, SoftRays)
        values, by_surface, by_positions, by_views = _gradient(
            surface.detached(), textures, rays.film, rays.near, frame.hits, frame.touched, dr.detach(positions),
            rays.reach, rays.sigma, self.form, dr.ravel(grad_image), views_move,
        )  # fmt: skip
        if dr.grad_enabled(surface.packets):
            backward_from(surface.packets, by_surface)
        if dr.grad_enabled(positions):
            dr.accum_grad(positions, by_positions)
        if views_move:
            backward_from(frame.views, by_views)
        return TexelGradient(frame.touched.blocks, values)

    def forward(
        self,
        frame: RenderedBatch,
        surface: Surface,
        textures: Textures,
        positions: mi.Float,
        seed: mi.UInt32,
        texel_tangent: Textures | None = None,
    ) -> mi.Vector4f:
        """See :class:`..deferred.DeferredRenderer`; ``seed`` is not used."""
        rays, tangent = frame.rays, dr.grad(positions)
        assert isinstance(rays, SoftRays)
        moving, cameras = surface.detached(), replace(rays.cameras, packets=dr.detach(rays.cameras.packets))
        for source, leaf in ((surface.packets, moving.packets), (frame.views, cameras.packets)):
            dr.enable_grad(leaf)
            dr.set_grad(leaf, dr.forward_to(source) if dr.grad_enabled(source) else 0)
        leaf = mi.Float(dr.detach(positions))
        dr.enable_grad(leaf)
        dr.set_grad(leaf, tangent)
        image = dr.zeros(mi.Float, cameras.n_pixels * 4)
        if frame.hits is not None:
            offset = dr.zeros(mi.ArrayXf, (textures.n_channels, dr.width(frame.hits.ray)))
            dr.enable_grad(offset)
            moved = replace(rays, cameras=cameras, positions=leaf)
            value, footprint = shade_hits(moving, textures, moved, frame.hits, self.form, offset)
            if texel_tangent is not None:
                dr.set_grad(offset, dr.detach(texel_tangent.lookup(footprint)))
            rate = dr.forward_to(value * moved.weight(frame.hits.ray))
            dr.scatter_reduce(dr.ReduceOp.Add, image, rate, rays.pixel(frame.hits.ray))
        return pixels(image, cameras)


@frozen("near", "hits")
def _image(surface, textures, film, near, hits, positions, reach, sigma, form, touch):
    """
    Flat image of a batch, and a flag for every block of texels that it shows.
    """
    rays = SoftRays(film.cameras, film.spp, film.seed, near, positions, reach, sigma)
    value, footprint = shade_hits(surface, textures, rays, hits, form)
    image, ray = dr.zeros(mi.Float, rays.cameras.n_pixels * 4), hits.ray
    dr.scatter_reduce(dr.ReduceOp.Add, image, value * rays.weight(ray), rays.pixel(ray), mode=dr.ReduceMode.Local)
    return image, TouchedBlocks.flags(textures, footprint) if touch else None


@frozen("near", "hits", "touched")
def _gradient(
    surface, textures, film, near, hits, touched, positions, reach, sigma, form, grad, views_move
):  # fmt: skip
    """
    Derivatives by touched texels, surface packets, positions and packets of the views, from those by the image.
    """
    packets, positions, views = mi.Float(surface.packets), mi.Float(positions), mi.Float(film.cameras.packets)
    offset = dr.zeros(mi.ArrayXf, (textures.n_channels, dr.width(hits.ray)))
    dr.enable_grad(packets, positions, offset)
    if views_move:
        dr.enable_grad(views)
    cameras = replace(film.cameras, packets=views)
    rays = SoftRays(cameras, film.spp, film.seed, near, positions, reach, sigma)
    value, footprint = shade_hits(replace(surface, packets=packets), textures, rays, hits, form, offset)
    value = value * rays.weight(hits.ray)
    backward_from(value, dr.gather(mi.Vector4f, grad, rays.pixel(hits.ray)))
    texels = TexelGradient.collect(textures, footprint, touched, dr.grad(offset))
    return texels.values, dr.grad(packets), dr.grad(positions), dr.grad(views) if views_move else 0.0
