"""
Surfaces behind each other: which ones a ray goes through, and what they look like together.

Depth peeling (Everitt 2001; Hasselgren et al. 2021, Sect. 5.2) on a ray tracer: front to back, both sides of a surface,
in whatever order the triangles are.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from ..latent.surface import Surface
from ..latent.textures import Textures
from ..machine.meshes import MISS
from .gbuffer import Hits

#: Where the next layer begins behind a surface, as a fraction of the coordinates: a few units in the last place; and
#: where it begins if rounding led to the same surface again.
_STEP, _FARTHER = 5e-7, 1e-4

#: How much farther off an edge either side is looked at with layers: the next one must be beyond :data:`_STEP`.
WIDTH = 8.0

#: Transmittance below which nothing more is looked for.
_DARK = 1e-4


@dr.syntax
def peel(
    scene: mi.Scene,
    surface: Surface,
    textures: Textures,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    layers: int,
    at_edge: Callable[[mi.UInt32, mi.Float], mi.Bool] = lambda face, t: mi.Bool(False),
) -> tuple[mi.UInt32, mi.Float, mi.Bool]:
    """
    The first surfaces along each ray, until one is opaque; those that are wholly transparent there do not count.

    Parameters
    ----------
    layers : int
        How many at most.
    at_edge : callable, optional
        Of a face and its distance.

    Returns
    -------
    face : mi.UInt32, width N·layers
        Triangles of each ray, front to back, then :data:`.gbuffer.MISS`.
    unpeeled : mi.Float, width N
        Coverage that the next surface would add.
    meets : mi.Bool, width N
        Whether ``at_edge`` is true of any of them.

    Notes
    -----
    One kernel. With mip levels opacity depends on the pixel, so that all surfaces count and none ends a ray.
    """
    n, lane = dr.width(direction), dr.arange(mi.UInt32, dr.width(direction))
    origin, direction = mi.Point3f(dr.detach(origin)), mi.Vector3f(dr.detach(direction))
    faces = dr.full(mi.UInt32, MISS, n * layers)
    dr.make_opaque(faces)
    size = dr.max(dr.abs(origin))
    t, through, unpeeled = dr.zeros(mi.Float, n), dr.ones(mi.Float, n), dr.zeros(mi.Float, n)
    last, k = dr.full(mi.UInt32, MISS, n), dr.zeros(mi.UInt32, n)
    active, meets = dr.full(mi.Bool, True, n), dr.full(mi.Bool, False, n)
    while dr.hint(active, label="peel", exclude=[scene, surface, textures, at_edge, faces]):
        ray = mi.Ray3f(dr.fma(direction, t, origin), direction)
        pi = scene.ray_intersect_preliminary(ray, coherent=True, active=active)
        active &= pi.is_valid()
        face, again = pi.prim_index, pi.prim_index == last
        t += dr.select(active, pi.t, 0)
        alpha = _opacity(surface, textures, face, pi.prim_uv, active & ~again)
        counts = active & ~again & (alpha > 0)
        is_layer = counts & (k < layers)
        dr.scatter(faces, face, lane * layers + k, is_layer)
        unpeeled = dr.select(counts & ~is_layer, through * alpha, unpeeled)
        meets |= is_layer & at_edge(face, t)
        through = dr.select(is_layer, through * (1 - alpha), through)
        k = dr.select(is_layer, k + 1, k)
        active &= ~(counts & ~is_layer) & (through > _DARK)
        last = face
        t += dr.maximum(size, t) * dr.select(again, mi.Float(_FARTHER), mi.Float(_STEP))
    return faces, unpeeled, meets


def _opacity(surface: Surface, textures: Textures, face: mi.UInt32, b: mi.Point2f, active: mi.Bool) -> mi.Float:
    """Of points on faces, detached; with mip levels a small number, which neither passes nor ends a ray."""
    if textures.n_levels > 1:
        return mi.Float(1e-3 * _DARK)
    index = dr.gather(mi.Vector4u, surface.faces, face, active)
    weights = (1 - b.x - b.y, b.x, b.y)
    corners = list(zip(weights, (index.x, index.y, index.z), strict=True))
    u = sum(w * dr.gather(mi.Float, surface.packets, i * 12 + 3, active) for w, i in corners)
    v = sum(w * dr.gather(mi.Float, surface.packets, i * 12 + 7, active) for w, i in corners)
    return textures.opacity(u, v, index.w, active)


def layered_hits(faces: mi.UInt32, layers: int, keep: mi.Bool | None = None) -> Hits | None:
    """
    What :func:`peel` found, of the rays that are kept; reads back how much. None where nothing was hit.
    """
    lane = dr.arange(mi.UInt32, dr.width(faces))
    found = faces != MISS
    if keep is not None:
        found &= dr.gather(mi.Bool, keep, lane // layers)
    slot = dr.compress(found)
    if dr.width(slot) == 0:
        return None
    first = dr.compress(slot % layers == 0)
    # Widths that change from step to step must not become part of a kernel.
    ray, last = dr.arange(mi.UInt32, dr.width(first)), dr.opaque(mi.UInt32, dr.width(first) - 1)
    end = dr.gather(mi.UInt32, first, dr.minimum(ray + 1, last))
    count = dr.select(ray == last, dr.opaque(mi.UInt32, dr.width(slot)), end) - first
    dr.eval(first, count)
    return Hits(slot, faces, None, layers, first, count)


def _layers(values: mi.Vector4f, hits: Hits):
    """Index of each ray's layers, front to back, whether it has that many, and the value there."""
    assert hits.first is not None and hits.count is not None
    flat = dr.ravel(dr.detach(values))
    for k in range(hits.layers):
        index, active = hits.first + k, k < hits.count
        yield index, active, dr.gather(mi.Vector4f, flat, index, active)


def composite(values: mi.Vector4f, hits: Hits) -> mi.Vector4f:
    """
    Premultiplied radiance and coverage of whole rays, width ``len(hits.first)``, from those of their layers; detached.
    """
    out, through = mi.Vector4f(0), mi.Float(1)
    for _, _, value in _layers(values, hits):
        out += through * value
        through *= 1 - value.w
    return out


def composite_adjoint(values: mi.Vector4f, hits: Hits, grad: mi.Vector4f) -> mi.Vector4f:
    """
    Derivative by the layers' values, width as theirs, from that by the rays'.

    With ``c_k`` the value of layer k, ``T_k = Π_{j<k} (1 - α_j)`` and ``B_k = c_k + (1 - α_k) B_{k+1}`` the ray is
    ``Σ T_k c_k``; its derivative along ``ċ_k`` is ``T_k (ċ_k - α̇_k B_{k+1})``.
    """
    layers, through = [], mi.Float(1)
    for index, active, value in _layers(values, hits):
        layers.append((index, active, value, through))
        through = through * (1 - value.w)
    out = dr.zeros(mi.Float, 4 * dr.width(hits.slot))
    behind = mi.Vector4f(0)
    for index, active, value, seen in reversed(layers):
        share = mi.Vector4f(seen * grad)
        share.w -= seen * dr.dot(grad, behind)
        dr.scatter(out, share, index, active)
        behind = dr.select(active, value + (1 - value.w) * behind, behind)
    return dr.gather(mi.Vector4f, out, dr.arange(mi.UInt32, dr.width(hits.slot)))


def composite_tangent(values: mi.Vector4f, hits: Hits, tangent: mi.Vector4f) -> mi.Vector4f:
    """
    Derivative of :func:`composite` along ``tangent``, the layers' rates of change.
    """
    rates = dr.ravel(dr.detach(tangent))
    out, rate = mi.Vector4f(0), mi.Float(0)
    through = mi.Float(1)
    for index, active, value in _layers(values, hits):
        change = dr.gather(mi.Vector4f, rates, index, active)
        out += through * change + rate * value
        rate = rate * (1 - value.w) - through * change.w
        through *= 1 - value.w
    return out
