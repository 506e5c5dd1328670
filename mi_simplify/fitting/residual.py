"""
What the latent renderer leaves out, as a constant: the `matched` transport.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..integrators.deferred import DeferredRenderer
from ..latent.surface import Surface
from ..latent.textures import Textures
from ..model.model import Model
from ..scenes.references.path_traced import make_reference
from ..scenes.views import Views


class PathResidual:
    """
    ``path(θ) - direct(θ)`` of the current latent model: indirect light, to be added to the differentiable image.

    With it the latent image has the values of a path tracer and the gradients of the direct renderer, so that a
    path-traced reference leaves neither shadows nor indirect light in the textures. The residual belongs to a view and
    is as old as the view is in the pool.

    Parameters
    ----------
    current : callable
        ``current(views) -> (Model, Surface, Textures)``: the state θ as views of one frame show it, which the renderer
        then holds.
    renderer : DeferredRenderer
        With shadows.
    spp, max_depth : int
        Of the path tracer.
    form : str
        Mixing of the lobes.
    """

    def __init__(
        self,
        current: Callable[[Views], tuple[Model, Surface, Textures]],
        renderer: DeferredRenderer,
        *,
        spp: int,
        max_depth: int,
        form: str,
    ):
        self._current, self._renderer = current, renderer
        self._spp, self._max_depth, self._form = spp, max_depth, form

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        Residual radiance, shape (B, height, width, 4); coverage is 0.
        """
        residual = np.empty((len(views), views.height, views.width, 4), np.float32)
        for index, part in views.by_shape():
            residual[index] = self._rendered(part, seed)
        return residual

    def _rendered(self, views: Views, seed: int) -> np.ndarray:
        model, surface, textures = self._current(views)
        tracer = make_reference(
            model.as_asset(),
            transport="baked",
            spp=self._spp,
            max_depth=self._max_depth,
            form=self._form,
            emission=False,
        )
        path = tracer.render(views, seed)
        with dr.suspend_grad():
            frame = self._renderer.render(surface, textures, views, spp=self._spp, seed=dr.opaque(mi.UInt32, seed))
        direct = frame.images()
        residual = path - direct
        residual[..., 3] = 0
        return residual
