"""
three.js as a renderer of models: a rasteriser, as viewers and engines are, that shares nothing with Mitsuba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...model.asset import Asset
from .files import own_file, written
from .page import ThreePage

if TYPE_CHECKING:  # importing it would need a Mitsuba variant
    from ...scenes.views import Views


class ThreeRenderer:
    """
    An asset as three.js shows it, as a :class:`...scenes.references.reference.Reference`: metallic-roughness shading
    under the point light of each view and a constant sky, without shadows.

    A GLB or glTF file is read by three.js itself, with the decoders of meshopt, Draco and KTX2; other formats, and
    characters in each of their frames, are handed over as GLB.

    Parameters
    ----------
    page : ThreePage
        Shared by all that are compared.
    asset : Asset
    spp : int
        Samples per pixel: n x n with n the whole number near the square root.
    sky : float
        Radiance of the sky.
    to_views : ndarray, shape (4, 4)
        From the units of the asset to those of the views.
    """

    def __init__(self, page: ThreePage, asset: Asset, spp: int, sky: float, to_views: np.ndarray):
        self._page, self._asset, self._sky, self._to_views = page, asset, sky, to_views
        self._n, self._size = max(1, round(spp**0.5)), float(np.linalg.norm(np.ptp(asset.bounds, axis=0)))

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        Images, shape (B, H, W, 4), linear radiance on black and coverage; there is no noise, so ``seed`` changes
        nothing.

        Raises
        ------
        AssetError
            three.js cannot read the file.
        """
        out = np.empty((len(views), views.height, views.width, 4), np.float32)
        for index, part in views.by_shape():
            self._show(float(part.frame[0]))
            for k, view in zip(index, _described(part, self._to_views, self._size), strict=True):
                out[k] = self._page.shot(view | {"n": self._n}).reshape(out.shape[1:])
        return out

    def _show(self, frame: float) -> None:
        """Load the model as it stands in a frame, unless the page shows that already."""
        asset = self._asset
        key = (id(self), frame if asset.rig is not None else None)
        if self._page.shown == key:
            return
        file = own_file(asset)
        self._page.load(written(asset.posed(frame)) if file is None else file, self._sky, asset.source or asset.name)
        self._page.shown = key


def _described(views: Views, to_views: np.ndarray, size: float) -> list[dict]:
    """
    Views as the page takes them, in units of the model's size: three.js bounds the falloff of light near a lamp.
    """
    arrays = views.arrays()
    unit = 1 / (size * np.cbrt(abs(np.linalg.det(to_views[:3, :3]))))
    scaled = np.diag([unit, unit, unit, 1.0]) @ to_views
    tan_y = arrays["tan_x"].astype(np.float64) * views.height / views.width
    return [
        {
            "eye": (arrays["origin"][k].astype(float) * unit).tolist(),
            "lamp": (arrays["light_position"][k].astype(float) * unit).tolist(),
            "intensity": (arrays["light_intensity"][k].astype(float) * unit**2).tolist(),
            "fov": float(np.degrees(2 * np.arctan(tan_y[k]))),
            "transform": scaled.T.ravel().tolist(),
            "width": views.width,
            "height": views.height,
            **{name: arrays[name][k].astype(float).tolist() for name in ("right", "up", "forward")},
        }
        for k in range(len(views))
    ]
