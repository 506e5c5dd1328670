"""
A step over fixed views of a shape that stays: every stage is computed only where something that it reads has changed.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..integrators.kept import Kept, gradient_of, image_of, keep
from ..latent.surface import Surface
from ..machine.reactive import Reactive
from ..scenes.views import Views
from .losses import frame_loss
from .stages import STAGES


class KeptStep:
    """
    The stages of one batch of views.

    Parameters
    ----------
    fit : .fit.Fit
        Whose shape is not optimised.
    views : Views
    reference : mi.Vector4f, width B·height·width
        Their target images.

    Attributes
    ----------
    stages : Reactive
        Of :data:`.stages.STAGES`, with inputs ``vertices``, ``textures``, ``light``, ``views``, ``samples`` and
        ``targets``.
    """

    def __init__(self, fit: Any, views: Views, reference: mi.Vector4f):
        self.views, self._fit = views, fit
        self.stages = Reactive(
            STAGES,
            {
                "positions": self._positions, "structure": self._structure, "surface": self._surface,
                "hits": self._hits, "image": self._image, "loss": self._loss,
            },
        )  # fmt: skip
        self.stages.set("vertices", fit.shape)
        self.stages.set("views", views)
        self.stages.set("samples", dr.opaque(mi.UInt32, fit.samples.seed(fit.settings.seed)))
        self.stages.set("textures", fit.latent.textures)
        self.stages.set("targets", (reference, mi.Color3f(0)))
        self.stages.set("light", None)

    def run(self, ambient: mi.Float | None, seed: mi.UInt32) -> tuple[mi.Float, mi.Vector4f]:
        """
        Loss of the textures and the light as they are now, over backgrounds of a seed, and its derivative by the image.
        """
        reference = self.stages.get("targets")[0]
        self.stages.changed("textures")  # in place, by Adam
        self.stages.set("light", ambient)
        self.stages.set("targets", (reference, self._fit.background(dr.width(reference), seed)))
        return self.stages.get("loss")

    def gradient(self, ambient: mi.Float | None, grad_image: mi.Vector4f) -> tuple[mi.UInt32, mi.ArrayXf] | None:
        """
        Texels and their derivatives, see :func:`..integrators.kept.gradient_of`.
        """
        fit = self._fit
        channels, form = fit.texels.channels, fit.settings.latent.shading
        return gradient_of(self.stages.get("hits"), fit.latent.textures, channels, ambient, form, grad_image)

    def _positions(self, vertices, views):
        return vertices.still(views)

    def _structure(self, positions):
        self._fit.renderer.move(positions.positions)
        return self._fit.renderer.tracer

    def _surface(self, positions) -> Surface:
        with dr.suspend_grad():
            pose = positions
            surface = self._fit.latent.evaluate(pose.positions, pose.base, pose.parameters, pose.views)
        dr.eval(surface.packets)
        return surface

    def _hits(self, structure, surface, views, samples) -> Kept:
        fit = self._fit
        return keep(
            structure, surface, fit.latent.textures, views, spp=fit.samples.spp, seed=samples, shade=fit.renderer.shade
        )  # fmt: skip

    def _image(self, hits, surface, textures, light) -> mi.Vector4f:
        fit = self._fit
        return image_of(hits, textures, fit.texels.channels, light, fit.settings.latent.shading)

    def _loss(self, image, targets):
        fit = self._fit
        reference, background = targets
        return frame_loss(image, reference, background, fit.loss, fit.coverage)
