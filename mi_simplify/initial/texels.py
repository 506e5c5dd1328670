"""
How large an atlas is where nobody says: what the asset shows, and not more.
"""

from __future__ import annotations

import numpy as np

from ..config import InitialSettings
from ..config.initial import LARGEST_ATLAS
from ..formats.mitsuba.read import SceneAsset
from ..model.asset import Asset, Part

_FILL = 0.6
"""Share of an atlas that charts cover, about."""

_PER_VERTEX = 4
"""Texels of normal map for each vertex of the asset that the result has not; a closed surface has one for two faces."""

_PER_TRIANGLE = 64
"""Texels that charts need at least, gaps between them included, for each triangle of the result."""

_LEAST = 64


def atlas_side(settings: InitialSettings, asset: Asset, triangles: int) -> int:
    """
    Side of the atlas for a result of so many triangles, a power of two, at most :data:`LARGEST_ATLAS`.

    The larger of the texels of the asset's own textures that its surface shows and those that the normal map needs for
    what decimation takes away. The largest where that cannot be known: for cards, a mesh of the user's own, whose
    charts may leave any space, displaced meshes, and scenes with textures that are no images.
    """
    known = settings.kind in ("decimate", "sphere") and not settings.subdivisions and not isinstance(asset, SceneAsset)
    if not known:
        return LARGEST_ATLAS
    removed = max(0, asset.n_triangles - triangles) / 2
    texels = max(shown_texels(asset), _PER_VERTEX * removed, _PER_TRIANGLE * triangles)
    power = round(float(np.log2(np.sqrt(texels / _FILL))))
    return int(np.clip(2**power, _LEAST, LARGEST_ATLAS))


def shown_texels(asset: Asset) -> float:
    """
    Texels of the asset's textures that its surface shows, of several images at a place the finest; every placement
    counts, as each has its own place in an atlas.
    """
    of_part = [_shown(part) for part in asset.parts]
    return float(sum(of_part[instance.part] for instance in asset.instances))


def _shown(part: Part) -> float:
    """Texels that the triangles of a part cover."""
    found, material = [0.0], part.material
    for name in ("base_color", "specular", "normal", "emission"):
        image, number = getattr(material, name), material.lookup(name).uvs
        uvs = part.uvs if number == 0 else part.more_uvs[number - 1]
        if image is None or uvs is None or image.shape[0] * image.shape[1] == 1:
            continue
        corners = uvs[part.faces].astype(np.float64)
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
        found.append(area * image.shape[0] * image.shape[1])
    return max(found)
