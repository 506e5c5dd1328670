"""
Mitsuba as the reference in direct light: all views in one launch, at the places that the latent renderer looks at.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..views import Views
from .mitsuba import MitsubaReference


class DirectReference(MitsubaReference):
    """
    A Mitsuba scene in the light of the views alone, without shadows: an :class:`.reference.AlignedReference`.

    Parameters
    ----------
    shapes, spp, glows
        As of :class:`.mitsuba.MitsubaReference`.
    integrator : dict
        A ``direct_edge``.
    """

    is_aligned = True

    def __init__(self, shapes: dict, integrator: dict, spp: int, glows: bool = False):
        super().__init__(shapes, integrator, spp, glows)
        self._views = mi.load_dict(integrator | {"type": "direct_views", "glows": glows})

    def _loaded(self) -> mi.Scene:
        if self._scene is None:
            self._scene = mi.load_dict({"type": "scene"} | self.shapes, optimize=False)
            self._params = mi.traverse(self._scene)
            self._params.keep(list(self._moved))
            self._apply_moved()
        return self._scene

    def render(self, views: Views, seed: int = 0, spp: int | None = None) -> np.ndarray:
        """
        See :class:`.reference.AlignedReference`.
        """
        return self._views.render_views(self._loaded(), views, spp or self.spp, seed)
