"""
Fixed views of a surface at rest: all that does not depend on its texels is found once and kept.

A step is then shading, loss, and the way back to the texels: which texels every hit reads is known, so that each texel
gathers its own gradient, and nothing is added up in memory that others write, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..latent.ambient import in_packets, light_of
from ..latent.surface import Surface
from ..latent.textures import Textures
from ..machine.frozen import frozen
from ..machine.meshes import MISS, MovingMesh
from ..machine.upload import upload
from ..scenes.views import Views
from .boundary import backward_from
from .camera import Cameras, FilmRays
from .deferred import pixels
from .gbuffer import Fragment, fragment, kept_hits, one_a_pixel, trace
from .shading import shade


@dataclass
class KeptHits:
    """
    Every hit of some views, and which texels it reads.

    Parameters
    ----------
    p, normal, tangent, handedness, is_back
        As of :class:`.gbuffer.Fragment`, width N.
    view, pixel : mi.UInt32, width N
    weight : mi.Float, width N
        What it counts in its pixel.
    texel : mi.UInt32, width 4 N
        Texels of its bilinear lookup, those of one hit behind each other.
    fraction : mi.Float, width 2 N
        Towards the second column and row.
    looked_up : mi.Float, width channels · N
        What it read at first, hit after hit; that of channels that are not optimised stays.
    """

    p: mi.Point3f
    normal: mi.Vector3f
    tangent: mi.Vector3f
    handedness: mi.Float
    is_back: mi.Bool
    view: mi.UInt32
    pixel: mi.UInt32
    weight: mi.Float
    texel: mi.UInt32
    fraction: mi.Float
    looked_up: mi.Float

    def __len__(self) -> int:
        return dr.width(self.view)

    def fragment(self) -> Fragment:
        """The hits as fragments; what shading does not look at is left at 0."""
        zero, n = mi.Float(0), len(self)
        return Fragment(
            self.p, self.normal, self.tangent, self.handedness, mi.Float(1), zero, zero, mi.UInt32(0), self.is_back,
            mi.Vector3f(0), dr.full(mi.Bool, True, n),
        )  # fmt: skip


@dataclass
class Readers:
    """
    The transposed lookup: of every texel that is seen, the hits that read it.

    Parameters
    ----------
    texel : mi.UInt32, width T
        Ascending.
    begin, end : mi.UInt32, width T
        Where its readers stand among the E.
    hit : mi.UInt32, width E
    weight : mi.Float, width E
    """

    texel: mi.UInt32
    begin: mi.UInt32
    end: mi.UInt32
    hit: mi.UInt32
    weight: mi.Float


@dataclass
class Kept:
    """
    What some views show of a surface, but for its texels and the light from everywhere; None where they show nothing.
    """

    cameras: Cameras
    hits: KeptHits | None
    readers: Readers | None


def keep(
    tracer: MovingMesh, surface: Surface, textures: Textures, views: Views, *, spp: int, seed: mi.UInt32, shade: str
) -> Kept:
    """
    Find what the samples of some views hit.

    Parameters
    ----------
    tracer : MovingMesh
        Holds the positions of the surface.
    surface : Surface
    textures : Textures
        Of one level; opaque.
    views : Views
    spp, seed, shade
        As of :class:`.deferred.DeferredRenderer`; 'sample' or 'pixel'.
    """
    with dr.suspend_grad():
        cameras = Cameras.of(views.under(None))
        rays = FilmRays(cameras, spp, seed)
        _, origin, direction = rays.at(dr.arange(mi.UInt32, len(rays)))
        face, _ = trace(tracer.scene, origin, direction)
        if shade == "pixel":
            rays, face = one_a_pixel(rays, face)
        hits = kept_hits(face, face != MISS)
        if hits is None:
            return Kept(cameras, None, None)
        view, origin, direction = rays.at(hits.ray)
        hit = fragment(surface.detached(), dr.gather(mi.UInt32, hits.face, hits.slot), origin, direction)
        footprint = textures.footprint(hit.u, hit.v, None, hit.cell)
        n = dr.width(hits.ray)
        looked_up = dr.ravel(textures.lookup(footprint))
        texel = dr.ravel(mi.ArrayXu([*footprint.index]))
        fraction = dr.ravel(mi.ArrayXf([footprint.fx, footprint.fy]))
        weight = mi.Float(rays.weight(hits.ray)) + dr.zeros(mi.Float, n)
        pixel = rays.pixel(hits.ray)
        found = KeptHits(
            hit.p, hit.normal, hit.tangent, hit.handedness, hit.is_back, view, pixel, weight, texel, fraction, looked_up
        )
        dr.eval(found)
        weights = np.stack([w.numpy() for _, w in footprint.weighted()], axis=1).ravel()
    return Kept(cameras, found, _readers(texel.numpy(), weights))


def _readers(texel: np.ndarray, weight: np.ndarray) -> Readers:
    order = np.argsort(texel, kind="stable")
    order = order[weight[order] > 0]
    of, begin = np.unique(texel[order], return_index=True)
    end = np.append(begin[1:], len(order))
    return Readers(
        upload(mi.UInt32, of), upload(mi.UInt32, begin), upload(mi.UInt32, end), upload(mi.UInt32, order // 4),
        upload(mi.Float, weight[order]),
    )  # fmt: skip


def image_of(kept: Kept, textures: Textures, channels: tuple[int, ...], ambient: mi.Float | None, form: str):
    """
    Image of the kept views, mi.Vector4f of width B·height·width; detached.

    Parameters
    ----------
    channels : tuple of int
        Of the textures, those that may have changed.
    ambient : mi.Float, optional
        See :mod:`..latent.ambient`, flat.
    """
    if kept.hits is None:
        return dr.zeros(mi.Vector4f, kept.cameras.n_pixels)
    light, _ = in_packets(None if ambient is None else dr.detach(ambient))
    return pixels(_image(kept.hits, kept.cameras, textures, channels, light, form), kept.cameras)


def gradient_of(
    kept: Kept, textures: Textures, channels: tuple[int, ...], ambient: mi.Float | None, form: str, grad: mi.Vector4f
) -> tuple[mi.UInt32, mi.ArrayXf] | None:
    """
    Derivative of a loss by the texels that the kept views show, from that by their image.

    It is added to the gradient of ``ambient``, too, where that has one.

    Returns
    -------
    texel : mi.UInt32, width T
        As they are stored.
    values : mi.ArrayXf, shape (len(channels), T)
        Unevaluated: part of the kernel that uses it.
    """
    if kept.hits is None or kept.readers is None:
        return None
    light, _ = in_packets(ambient)
    wanted, lit = dr.grad_enabled(light), dr.detach(light)
    by_hit, by_light = _by_hit(kept.hits, kept.cameras, textures, channels, lit, form, dr.ravel(grad), wanted)
    if wanted:
        backward_from(light, by_light)
    if not channels:
        return None
    return kept.readers.texel, _gathered(kept.readers, by_hit, len(channels))


def _values(hits: KeptHits, textures: Textures, channels: tuple[int, ...]) -> list[mi.Float]:
    """What the hits read now, channel by channel."""
    lane, n = dr.arange(mi.UInt32, len(hits)), textures.n_channels
    first = dr.gather(mi.ArrayXf, hits.looked_up, lane, shape=(n, len(hits)))
    out = [first[c] for c in range(n)]
    texel = dr.gather(mi.Vector4u, hits.texel, lane)
    fx, fy = dr.gather(mi.Vector2f, hits.fraction, lane)
    data = dr.detach(textures.data)
    for c in channels:
        a, b, d, e = (dr.gather(mi.Float, data, i * n + c) for i in texel)
        out[c] = dr.lerp(dr.lerp(a, b, fx), dr.lerp(d, e, fx), fy)
    return out


def _shaded(
    hits: KeptHits, cameras: Cameras, textures: Textures, values: list[mi.Float], light: mi.Float, form: str
) -> mi.Vector4f:
    """Premultiplied radiance and coverage of every hit."""
    position, intensity = cameras.fetch(hits.view, 4).xyz, cameras.fetch(hits.view, 5).xyz
    direction = dr.normalize(mi.Vector3f(hits.p - cameras.origin(hits.view)))
    ambient = light_of(light, 0, dr.width(light) // 4)
    texels = textures.unpack(mi.ArrayXf(values))
    return shade(hits.fragment(), texels, direction, position, intensity, form, ambient)


@frozen("hits")
def _image(hits, cameras, textures, channels, light, form):
    """Flat image of the views."""
    image = dr.zeros(mi.Float, cameras.n_pixels * 4)
    value = _shaded(hits, cameras, textures, _values(hits, textures, channels), light, form) * hits.weight
    dr.scatter_reduce(dr.ReduceOp.Add, image, value, hits.pixel, mode=dr.ReduceMode.Local)
    return image


@frozen("hits")
def _by_hit(hits, cameras, textures, channels, light, form, grad, light_moves):
    """Derivatives by the values that every hit reads, flat, hit after hit, and by the light's packets."""
    values, light = _values(hits, textures, channels), mi.Float(light)
    for c in channels:
        dr.enable_grad(values[c])
    if light_moves:
        dr.enable_grad(light)
    out = _shaded(hits, cameras, textures, values, light, form)
    backward_from(out, dr.gather(mi.Vector4f, grad, hits.pixel) * hits.weight)
    by_value = dr.ravel(mi.ArrayXf([dr.grad(values[c]) for c in channels])) if channels else mi.Float(0)
    return by_value, dr.grad(light) if light_moves else mi.Float(0)


@dr.syntax
def _gathered(readers: Readers, by_hit: mi.Float, n: int) -> mi.ArrayXf:
    """Sums over the readers of every texel, shape (n, T)."""
    k, end = mi.UInt32(readers.begin), readers.end
    total = dr.zeros(mi.ArrayXf, (n, dr.width(k)))
    while dr.hint(k < end, label="readers", exclude=[readers, by_hit, n]):
        hit = dr.gather(mi.UInt32, readers.hit, k)
        total += dr.gather(mi.ArrayXf, by_hit, hit, shape=(n, dr.width(hit))) * dr.gather(mi.Float, readers.weight, k)
        k += 1
    return total
