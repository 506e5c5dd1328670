"""
A reference that is looked at from a few views alone, the same in every step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..views import Views
from .reference import Reference


class FixedViews:
    """
    Any reference as one with views of its own, see :class:`.reference.OwnViews`: what is fitted is what is judged.

    Parameters
    ----------
    reference : Reference
    views : Views
        Of a square film; its side is left to who draws.
    """

    def __init__(self, reference: Reference, views: Views):
        self.reference, self.views = reference, views

    def __len__(self) -> int:
        return len(self.views)

    def draw(self, n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
        """See :class:`.reference.OwnViews`; all of them in their order, as often as it takes."""
        return [self.views.take(np.arange(n) % len(self.views)).resized(resolution, resolution)]

    def held_out(self, n: int, resolution: int) -> Views:
        """Some of the views that are fitted, evenly spread: there are no others."""
        n = min(n, len(self.views))
        return self.views.take(np.arange(n) * len(self.views) // n).resized(resolution, resolution)

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """See :class:`.reference.Reference`."""
        return self.reference.render(views, seed)


class LitViews:
    """
    Any reference, looked at from random views whose light is not theirs to choose, see :class:`.reference.OwnViews`.

    Parameters
    ----------
    reference : Reference
    views : callable
        ``views(n, rng, resolution) -> Views``.
    seed : int
        Of the views that are never drawn.
    """

    def __init__(self, reference: Reference, views: Callable[[int, np.random.Generator, int], Views], seed: int):
        self.reference, self._views, self._seed = reference, views, seed

    def draw(self, n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
        """See :class:`.reference.OwnViews`."""
        return [self._views(n, rng, resolution)]

    def held_out(self, n: int, resolution: int) -> Views:
        """See :class:`.reference.OwnViews`."""
        return self._views(n, np.random.default_rng(self._seed), resolution)

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """See :class:`.reference.Reference`."""
        return self.reference.render(views, seed)
