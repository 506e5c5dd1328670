"""
Pictures of a reference that several sets of candidates are compared with.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # importing it would need a Mitsuba variant
    from ..scenes.views import Views


class KeptPictures:
    """
    Of one reference, as it was looked at last: the same views under the same settings need not be rendered again.
    """

    def __init__(self) -> None:
        self._key: tuple | None = None
        self._pictures: np.ndarray | None = None

    def of(self, views: Views, settings: Mapping[str, Any], render: Callable[[], np.ndarray]) -> np.ndarray:
        """
        The pictures that are kept, or those that ``render`` makes, which then are.

        Parameters
        ----------
        views : Views
        settings : mapping
            Everything else that pictures depend on, as JSON values: renderer, samples, seed, light.
        """
        arrays = views.arrays()
        seen = tuple((name, array.tobytes()) for name, array in sorted(arrays.items()))
        key = (views.height, views.width, seen, json.dumps(settings, sort_keys=True))
        if self._pictures is None or key != self._key:
            self._pictures = render()
            self._key = key
        return self._pictures
