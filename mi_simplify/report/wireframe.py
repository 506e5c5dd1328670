"""
The mesh of an asset drawn as lines over a picture.
"""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from ..model.asset import Asset
from ..scenes.views import Views

#: Of lines, sRGB.
_COLOUR = (120, 200, 220)


def wireframe(asset: Asset, views: Views, background: Image.Image) -> Image.Image:
    """
    The edges of faces that face the first camera, over a dimmed picture of what it sees.

    Parameters
    ----------
    asset : Asset
    views : Views
        Square; the first is drawn.
    background : Image
        As large as lines are wanted; grey where it is black.
    """
    view = views.arrays()
    out = Image.blend(background, Image.new("RGB", background.size), 0.75)
    draw = ImageDraw.Draw(out)
    origin, right, up, forward = (view[name][0] for name in ("origin", "right", "up", "forward"))
    half = background.width / 2
    for part in asset.placed():
        d = part.vertices - origin
        scale = half / (d @ forward * view["tan_x"][0])
        points = np.stack([half + d @ right * scale, half - d @ up * scale], 1)
        corners = part.vertices[part.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        seen = part.faces[np.einsum("fc,fc->f", normals, origin - corners[:, 0]) > 0]
        pairs = np.unique(np.sort(np.stack([seen, np.roll(seen, -1, 1)], 2).reshape(-1, 2), 1), axis=0)
        for line in points[pairs].reshape(-1, 4).tolist():
            draw.line(line, _COLOUR)
    return out
