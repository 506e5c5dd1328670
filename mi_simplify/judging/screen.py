"""
A model as a viewer shows it on a screen: lit directly, its textures filtered for the size of a pixel.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..integrators.deferred import DeferredRenderer
from ..latent.environment import looked_up
from ..latent.latent import Latent
from ..latent.textures import needs_extended
from ..model.model import Model
from ..scenes.views import Views


class Screen:
    """
    Renders one model from any views at any size.

    Parameters
    ----------
    model : Model
        In the frame of the views; its own mip levels are read where it has them, else means of its textures.
    form : {'gltf', 'paper'}
        Mixing of the lobes.
    shade : {'sample', 'pixel', 'centre'}
        As of :class:`~mi_simplify.integrators.deferred.DeferredRenderer`; 'centre' is one sample a pixel, without
        antialiasing.
    mips : {'none', 'derived', 'custom'}, optional
        Of the textures.
    """

    def __init__(self, model: Model, *, form: str = "gltf", shade: str = "sample", mips: str | None = None):
        sides = model.base_color.shape[:2]
        if mips is None:
            halves = all(side & (side - 1) == 0 for side in sides)
            mips = "none" if not halves else "custom" if model.mips else "derived"
        self.latent = Latent(model, needs_extended(model.base_color, model.specular), mips)
        self.renderer = DeferredRenderer(self.latent.topology, form=form, shade=shade)
        self.ambient = looked_up(model.ambient)

    def images(self, views: Views, *, spp: int = 16, seed: int = 1) -> np.ndarray:
        """
        Linear radiance on black and coverage, shape (B, H, W, 4).
        """
        operation = self.latent.operation
        out = np.empty((len(views), views.height, views.width, 4), np.float32)
        with dr.suspend_grad():
            base = mi.Float(operation.base.positions.ravel())
            parameters = {name: mi.Float(value) for name, value in operation.parameters.items()}
            for index, part in views.by_shape():
                positions = operation.positions(base, parameters, part)
                self.renderer.move(positions)
                surface = self.latent.evaluate(positions, base, parameters, part)
                frame = self.renderer.render(
                    surface, self.latent.textures, part.under(self.ambient), spp=spp, seed=dr.opaque(mi.UInt32, seed)
                )
                out[index] = frame.images()
        return out
