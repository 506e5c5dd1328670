"""
Views of a displaced model in several tessellations, each of which it is to look right in.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..model.model import Displacement
from ..scenes.views import Views


def tessellating(draw: Callable, displacement: Displacement | None, per_level: int) -> Callable:
    """
    A function that draws views of all tessellations that a model is fitted for: their ``subdivisions``.

    Parameters
    ----------
    draw : callable
        ``draw(n, rng, resolution) -> list of Views``; returned as it is where there is no choice.
    displacement : Displacement, optional
    per_level : int
        Views of one tessellation in turn.
    """
    if displacement is None or not displacement.fitted:
        return draw
    levels = np.array(displacement.fitted)

    def drawn(n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
        out = []
        for views in draw(n, rng, resolution):
            arrays = views.arrays()
            shown = levels[(np.arange(len(views)) // per_level + rng.integers(len(levels))) % len(levels)]
            for level in np.unique(shown):
                some = {key: value[shown == level] for key, value in (arrays | {"subdivisions": shown}).items()}
                out.append(Views.from_arrays(some, views.width, views.height))
        return out

    return drawn
