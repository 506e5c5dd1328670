"""
At which size on the screen one level of detail may take over from another.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable

import numpy as np

from ..config.schema import ViewsSettings
from ..model.model import Model
from ..scenes.views import Views, held_out_views
from .metrics import COVERED, flip_maps
from .screen import Screen

#: Sides of the square images that are compared [pixels], which the bounding sphere of the model just fills.
SIZES = tuple(int(4 * round(2 ** (k / 2) / 4)) for k in range(20, 5, -1))

#: Images of a fit are no smaller than this: in fewer pixels a mesh drifts to where larger ones show that it is wrong.
LEAST_FILM = 64

#: Images of a larger side are costly [pixels].
LARGE = 512


def views_of(size: int, n_views: int) -> int:
    """
    How many images of a side to look at: half as many of large ones, which have pixels enough.
    """
    return n_views if size <= LARGE else max(1, n_views // 2)


def film_of(size: float, bounds: np.ndarray, views: ViewsSettings) -> int:
    """
    Side of the images of a fit that show the bounding sphere of a box at least so large [pixels], in tiles of four.

    Parameters
    ----------
    size : float
        Diameter of the sphere [pixels].
    bounds : ndarray, shape (2, 3)
        In the normalised frame.
    """
    radius = np.linalg.norm(bounds[1] - bounds[0]) / 2
    share = radius / (views.distance * np.tan(np.radians(views.fov) / 2))
    return int(max(4 * round(size / share / 4), LEAST_FILM))


def difference(above: Screen, level: Screen, views: Views) -> float:
    """
    Mean FLIP between two models over the pixels that either covers, both without aliasing.
    """
    spp = int(np.clip(_SPP * (256 / views.width) ** 2, _SPP, 256))
    a, b = (screen.images(views, spp=spp) for screen in (above, level))
    covered = np.maximum(a[..., 3], b[..., 3]) > 1 - COVERED
    return float(flip_maps(a, b)[covered].mean()) if covered.any() else 0.0


def switching_size(
    above: Model,
    level: Model,
    bounds: np.ndarray,
    threshold: float,
    *,
    largest: float = float(SIZES[0]),
    form: str = "gltf",
    n_views: int = 6,
    on_size: Callable[[int], None] | None = None,
) -> tuple[float, dict[int, float]]:
    """
    The largest size at which two levels look alike, their FLIP being below a threshold.

    Parameters
    ----------
    above, level : Model
        The finer one and the coarser one.
    bounds : ndarray, shape (2, 3)
        Box that the cameras look at, as of ``held_out_views``.
    threshold : float
        Of :func:`difference`.
    largest : float
        Nothing above this is tried [pixels].
    n_views : int
        Of small images, see :func:`views_of`.
    on_size : callable, optional
        Called with every size that is tried.

    Returns
    -------
    size : float
        Diameter of the bounding sphere on the screen [pixels], between the sizes tried by the logarithms of both; the
        smallest of them where not even that is below the threshold.
    differences : dict of int to float
        FLIP by size.
    """
    # Without mip levels: those of a texture far larger than the image would mix what lies beside each other in it.
    finer, coarser = (Screen(model, form=form, mips="none") for model in (above, level))
    sizes = [s for s in SIZES if s <= max(largest, SIZES[-1])]
    found: dict[int, float] = {}

    def is_alike(k: int) -> bool:
        if on_size is not None:
            on_size(sizes[k])
        count = views_of(sizes[k], n_views)
        found[sizes[k]] = difference(finer, coarser, held_out_views(bounds, count, sizes[k], seed=7))
        return found[sizes[k]] < threshold

    # The first of the falling sizes that is alike, by bisection: every size is kernels of its own.
    first = bisect.bisect_left(range(len(sizes)), True, key=is_alike)
    if first in (0, len(sizes)):
        return float(sizes[min(first, len(sizes) - 1)]), found
    between = sizes[first], sizes[first - 1]
    y = np.log(np.maximum([found[s] for s in between], 1e-6))
    return float(np.exp(np.interp(np.log(threshold), y, np.log(between)))), found


#: Samples per pixel of an image that is compared; with fewer the two images' noise would count.
_SPP = 16
