"""
One picture of an asset, to see that it was read the right way up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import AssetError, OutputError
from ..formats.textures import png
from ..judging.pictures import displayed
from ..machine.files import make_folder, write_atomic
from ..model.asset import Asset
from ..model.frame import Frame
from ..scenes.references.path_traced import make_reference
from ..scenes.views import Views, look_at

SUFFIXES = (".png", ".exr")


def portrait_view(bounds: np.ndarray, *, resolution: int = 512, azimuth: float = 30, elevation: float = 20) -> Views:
    """
    One camera that sees a whole box, lit from above its left shoulder.

    Parameters
    ----------
    bounds : ndarray, shape (2, 3)
    resolution : int
        Width and height [px].
    azimuth, elevation : float
        Where the camera stands [degrees]: 0, 0 looks along -Z, the azimuth turns it towards +X.
    """

    def direction(azimuth: float, elevation: float) -> np.ndarray:
        a, e = np.radians([azimuth, elevation])
        return np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])

    center, radius = bounds.mean(0), np.linalg.norm(bounds[1] - bounds[0]) / 2
    light = center + 4 * radius * direction(azimuth - 30, elevation + 25)
    return look_at(
        center + 2.6 * radius * direction(azimuth, elevation), center, light,
        width=resolution, height=resolution, irradiance=2.5,
    )  # fmt: skip


def in_frame(asset: Asset, code: float | None) -> Asset:
    """
    A character as it stands in a frame of its clip, numbered as in its file; without a number the first. Others as they
    are.

    Raises
    ------
    AssetError
        The clip, if there is one, does not have this frame.
    """
    rig = asset.rig
    if rig is None and code is None:
        return asset
    if rig is None:
        raise AssetError(f"{asset.name} has no skeleton, so it has no frames; leave --frame out")
    if code is None:
        return asset.posed(0)
    if not rig.codes[0] <= code <= rig.codes[-1]:
        raise AssetError(
            f"the clip of {asset.name} goes from {rig.codes[0]:g} to {rig.codes[-1]:g}; it has no {code:g}"
        )
    return asset.posed(float(np.interp(code, rig.codes, np.arange(rig.n_frames))))


def render_picture(
    asset: Asset, *, transport: str = "baked", spp: int = 64, max_depth: int = 6, seed: int = 0, **view: Any
) -> np.ndarray:
    """
    Render an asset once, under a point light and a dim sky.

    Parameters
    ----------
    asset : Asset
    transport, spp, max_depth
        As in :func:`mi_simplify.scenes.references.path_traced.make_reference`.
    view
        As in :func:`portrait_view`.

    Returns
    -------
    ndarray, shape (H, W, 4), float32
        Linear radiance on black, and coverage.
    """
    asset = Frame.around(asset.bounds).normalised(asset)  # any units, and coordinates far from the origin
    sky = 0.0 if transport == "direct" else 0.1
    reference = make_reference(asset, transport=transport, spp=spp, max_depth=max_depth, sky=sky)
    return reference.render(portrait_view(asset.bounds, **view), seed=seed)[0]


def check_picture_path(path: str | Path) -> Path:
    """
    The path, if it names a format that :func:`save_picture` writes.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: unknown image format; name the file {' or '.join('*' + s for s in SUFFIXES)}")
    return path


def save_picture(image: np.ndarray, path: str | Path) -> Path:
    """
    Write linear radiance, shape (H, W, 4), as sRGB PNG on black or as linear RGBA EXR, into a folder that is made where
    it is missing.
    """
    path = check_picture_path(path)
    make_folder(path.parent)
    if path.suffix.lower() == ".png":
        return write_atomic(path, png(displayed(image[None])[0]))
    return write_atomic(path, lambda temporary: mi.Bitmap(np.ascontiguousarray(image)).write(str(temporary)))
