"""
Direct light of one point light on the latent surface: what the latent renderer calls an image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..bsdfs import microfacet
from ..latent.ambient import Harmonics, MapLight
from ..latent.footprint import Footprint
from ..latent.surface import Surface
from ..latent.texel_gradient import TouchedBlocks
from ..latent.textures import Texels, Textures
from ..machine.frozen import frozen
from .camera import FilmRays, PixelRays
from .gbuffer import Fragment, Hits, fragment

if TYPE_CHECKING:
    from .edge_rays import EdgeRays

#: Least cosine that a pixel's footprint is stretched by: what is seen more edge-on is filtered as if it were at this.
GRAZING = 0.1


def mapped_normal(hit: Fragment, normal: mi.Vector3f, wi: mi.Vector3f) -> mi.Vector3f:
    """
    The normal map's vector in the world, on the viewer's side, turned continuously to face the viewer.

    Parameters
    ----------
    normal : mi.Vector3f
        Tangent-space vector of the map, any length > 0.
    wi : mi.Vector3f
        Unit direction to the viewer.
    """
    n = hit.normal
    t = hit.tangent - n * dr.dot(n, hit.tangent)
    # Where shading bends the tangent into the normal it fades: normalised, it would flip inside the face.
    t *= dr.rsqrt(dr.maximum(dr.squared_norm(t), microfacet.MIN_TANGENT**2))
    b = dr.cross(n, t) * hit.handedness
    m = t * normal.x + b * normal.y + n * normal.z
    m *= dr.rsqrt(dr.maximum(dr.squared_norm(m), 1e-12))
    m = dr.select(hit.is_back, -m, m)
    return microfacet.face_viewer(m, wi)


def shade(
    hit: Fragment,
    texels: Texels,
    direction: mi.Vector3f,
    light_position: mi.Point3f,
    light_intensity: mi.Color3f,
    form: str = "gltf",
    ambient: Harmonics | MapLight | None = None,
) -> mi.Vector4f:
    """
    Premultiplied radiance and coverage of a fragment under one point light and an ambient one, no shadows.

    Parameters
    ----------
    direction : mi.Vector3f
        Of the camera ray.
    light_position : mi.Point3f
    light_intensity : mi.Color3f
    ambient : Harmonics or MapLight, optional
        See :mod:`..latent.ambient`.

    Returns
    -------
    mi.Vector4f
        ``(r, g, b, coverage)``, zero where nothing was hit.
    """
    wi = -direction
    n = mapped_normal(hit, texels.normal, wi)
    to_light = mi.Vector3f(light_position) - mi.Vector3f(hit.p)
    inv_d2 = dr.rcp(dr.maximum(dr.squared_norm(to_light), 1e-8))
    wo = to_light * dr.sqrt(inv_d2)
    value = microfacet.evaluate(
        texels.base_color, texels.gamma, texels.roughness, texels.metallic, n, wi, wo, form
    )  # fmt: skip
    radiance = value * mi.Color3f(light_intensity) * inv_d2
    if ambient is not None:
        radiance += ambient.radiance(texels, n, wi)
    radiance *= texels.opacity
    out = mi.Vector4f(radiance.x, radiance.y, radiance.z, texels.opacity)
    return dr.select(hit.active, out, 0)


def shade_hits(
    surface: Surface,
    textures: Textures,
    rays: FilmRays | PixelRays | EdgeRays,
    hits: Hits,
    form: str,
    offset: mi.ArrayXf | None = None,
) -> tuple[mi.Vector4f, Footprint]:
    """
    Radiance and coverage of rays with known hits.

    Parameters
    ----------
    rays : FilmRays, PixelRays or EdgeRays
    offset : mi.ArrayXf, shape (channels, N), optional
        Added to what is looked up in the textures.

    Returns
    -------
    value : mi.Vector4f, width N
    footprint : Footprint
        Of the texture lookup.
    """
    view, origin, direction = rays.at(hits.ray)
    hit = fragment(surface, dr.gather(mi.UInt32, hits.face, hits.slot), origin, direction)
    level = None
    if textures.n_levels > 1:
        # Of a whole pixel, however many samples it has: that is what viewers filter textures for.
        width = rays.cameras.pixel_width(view, direction) * dr.dot(mi.Vector3f(hit.p - origin), direction)
        level = textures.level(width * hit.density / dr.maximum(dr.abs(dr.dot(hit.normal, direction)), GRAZING))
    footprint = textures.footprint(hit.u, hit.v, level, hit.cell)
    looked_up = textures.lookup(footprint)
    texels = textures.unpack(looked_up if offset is None else looked_up + offset)
    light, intensity = rays.cameras.fetch(view, 4).xyz, rays.cameras.fetch(view, 5).xyz
    if hits.lit is not None:
        intensity = dr.select(hits.lit, intensity, 0)
    ambient = rays.cameras.ambient()
    return shade(hit, texels, direction, light, intensity, form, ambient), footprint


@frozen("hits")
def hit_values(
    surface: Surface, textures: Textures, rays: FilmRays | PixelRays | EdgeRays, hits: Hits, form: str, touch: bool
) -> tuple[mi.Vector4f, mi.UInt32 | None]:
    """
    Premultiplied radiance and coverage of every hit, width N, and where ``touch`` asks for it a flag for every block of
    texels that they show.
    """
    value, footprint = shade_hits(surface, textures, rays, hits, form)
    return value, TouchedBlocks.flags(textures, footprint) if touch else None
