"""
What judges render with: Mitsuba's path tracer, or three.js.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from ..model.asset import Asset

if TYPE_CHECKING:  # importing them would need a Mitsuba variant
    from ..scenes.references.reference import Reference
    from ..scenes.views import Views

SKY = 0.1
"""Radiance of the constant sky beside the point light."""

MAX_DEPTH = 6
"""Longest light path [edges]."""

RENDERERS = ("mitsuba", "three")
"""By name: path tracing with shadows and indirect light, and a rasteriser without them, as viewers have."""

Opened = Callable[[Asset, np.ndarray], "Reference"]
"""Of an asset, and the (4, 4) from its units to those of the views: its renderer, in their point light and the sky."""


def half(spp: int) -> int:
    """
    Samples per pixel of each of the two renderings that make a picture of ``spp``.
    """
    return max(1, spp // 2)


@contextmanager
def opened(renderer: str, spp: int) -> Iterator[tuple[Opened, dict, int]]:
    """
    What makes renderers of assets, how they are named in ``settings`` of figures, and how many of their renderings make
    a picture: two with noise of their own, or one without any. Closed afterwards.

    Parameters
    ----------
    renderer : str
        One of :data:`RENDERERS`.
    spp : int
        Samples per pixel of a picture.

    Raises
    ------
    RuntimeUnavailable
        It is not installed.
    """
    if renderer == "mitsuba":
        from mitsuba import __version__ as version

        settings = {"renderer": f"Mitsuba {version}, path tracer", "max_depth": MAX_DEPTH}
        yield lambda asset, to_views: PathTraced(asset.transformed(to_views), half(spp)), settings, 2
        return
    from .three.chromium import chromium
    from .three.package import three_folder, three_version
    from .three.page import ThreePage
    from .three.renderer import ThreeRenderer

    version = three_version(three_folder())
    with chromium("--renderer three") as browser:
        settings = {"renderer": f"three.js {version} in Chromium {browser.version.split('.')[0]}"}
        page = ThreePage(browser)
        yield lambda asset, to_views: ThreeRenderer(page, asset, spp, SKY, to_views), settings, 1


class PathTraced:
    """
    An asset under the point light of each view and a dim constant sky, as a
    :class:`..scenes.references.reference.Reference`.

    Parameters
    ----------
    asset : Asset
    spp : int
        Samples per pixel.
    """

    def __init__(self, asset: Asset, spp: int):
        from ..scenes.references.path_traced import make_reference

        self._reference = make_reference(asset, transport="baked", spp=spp, max_depth=MAX_DEPTH, sky=SKY)

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        Images of the views, shape (B, H, W, 4).
        """
        return self._reference.render(views, seed=seed)
