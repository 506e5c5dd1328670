"""
What the latent model is fitted to: anything that turns views into images.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeGuard, runtime_checkable

import numpy as np

from ...errors import UserError
from ..views import Views


class Reference(Protocol):
    """
    A black box: the only thing that crosses from it to the latent model while fitting is images.
    """

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        Images of the views.

        Returns
        -------
        ndarray, shape (B, height, width, 4), float32
            Linear radiance on black (premultiplied by coverage), and coverage.
        """
        ...


@runtime_checkable
class OwnViews(Reference, Protocol):
    """
    A reference that shows some views only, and says which.
    """

    def draw(self, n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
        """
        ``n`` views to fit, of a square film, in lists of one animation frame each.
        """
        ...

    def held_out(self, n: int, resolution: int) -> Views:
        """
        Up to ``n`` views that are never drawn.
        """
        ...


@runtime_checkable
class AlignedReference(Reference, Protocol):
    """
    A reference without noise of its own, which looks at pixels through the film positions that it is told to.

    With ``spp`` samples and ``seed`` these are those of :func:`...integrators.camera.film_samples`. A latent image with
    the same ones differs from it by what the surfaces differ, and not by what either has seen of a pixel.
    """

    @property
    def is_aligned(self) -> bool:
        """Whether it is one: some only stand in front of another reference."""
        ...

    def render(self, views: Views, seed: int = 0, spp: int | None = None) -> np.ndarray:
        """
        As :meth:`Reference.render`, with ``spp`` samples a pixel, its own number where that is None.
        """
        ...


def is_aligned(reference: Reference) -> TypeGuard[AlignedReference]:
    """
    Whether a reference is an :class:`AlignedReference`.
    """
    return isinstance(reference, AlignedReference) and reference.is_aligned


class FramedReference:
    """
    A reference that cannot be moved, seen from another frame: its cameras and lights are moved instead.

    Parameters
    ----------
    reference : Reference
    scale : float
        Length of one of the reference's units in the frame of the views.
    center : ndarray, shape (3,)
        Point of the reference at the origin of that frame.
    """

    def __init__(self, reference: Reference, scale: float, center: np.ndarray):
        self.reference, self.scale, self.center = reference, scale, np.asarray(center, np.float64)

    @property
    def is_aligned(self) -> bool:
        """See :class:`AlignedReference`."""
        return is_aligned(self.reference)

    def render(self, views: Views, seed: int = 0, spp: int | None = None) -> np.ndarray:
        """
        See :class:`AlignedReference`; intensities follow the squared distance, so that radiance stays as it is.
        """
        arrays = views.arrays()
        moved = {name: arrays[name] / self.scale + self.center for name in ("origin", "light_position")}
        moved["light_intensity"] = arrays["light_intensity"] / self.scale**2
        moved_views = Views.from_arrays(arrays | moved, views.width, views.height)
        return self.reference.render(moved_views, seed, **({} if spp is None else {"spp": spp}))


class CallableReference:
    """
    A Python function ``f(views) -> (B, H, W, 4)`` as a reference.
    """

    def __init__(self, function: Callable[[Views], np.ndarray]):
        self.function = function

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`Reference`; checks what the function returns.
        """
        images = np.asarray(self.function(views), np.float32)
        expected = (len(views), views.height, views.width, 4)
        if images.shape != expected:
            raise UserError(
                f"the reference function returned shape {images.shape}, expected {expected}: (B, H, W, RGBA)"
            )
        if not np.isfinite(images).all():
            raise UserError("the reference function returned NaN or infinite radiance")
        return images
