"""
Views that a fit never sees, by which it is judged while it runs.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config import FitSettings
from ..machine.upload import upload
from ..scenes.references.reference import OwnViews, Reference
from ..scenes.views import Views
from .losses import frame_loss, srgb
from .samples import Samples

#: Views at most: judging must not take longer than the steps between.
_MOST = 8


class HeldOut:
    """
    Held-out views, and what the reference shows of them.

    Parameters
    ----------
    reference : Reference
        Names the views where it has some of its own.
    draw : callable
        ``draw(n, rng, resolution) -> list of Views``, as in :class:`.pool.ViewPool`; for references that show any view.
    settings : FitSettings
    samples : Samples
        Renders the images.

    Attributes
    ----------
    views : Views
    images : ndarray, shape (B, H, W, 4), float32
        Linear radiance on black, and coverage; 0 where the reference does not know.
    """

    def __init__(self, reference: Reference, draw: Callable, settings: FitSettings, samples: Samples):
        judged = settings.evaluation
        resolution, n = min(judged.resolution, max(settings.optimizer.resolution)), min(judged.views, _MOST)
        if isinstance(reference, OwnViews):
            self.views = reference.held_out(n, resolution)
        else:
            rng = np.random.default_rng(settings.seed + 1)
            self.views = Views.concatenate(draw(n, rng, resolution))
        images = samples.held_out(self.views)
        self._unknown = np.isnan(images).any(axis=3)[..., None]
        self.images = np.where(self._unknown, 0, images)

    def measure(
        self, images: np.ndarray, background: mi.Color3f, loss: Callable, coverage: mi.Float
    ) -> tuple[float, float]:
        """
        How far images of the views, shape (B, H, W, 4), are from the reference's.

        Parameters
        ----------
        background, loss, coverage
            As in :func:`.losses.frame_loss`.

        Returns
        -------
        loss : float
        psnr : float
            Of clipped sRGB on black, mean over views [dB].
        """
        images = np.where(self._unknown, 0, images)
        ours, theirs = (upload(mi.Vector4f, x.reshape(-1, 4)) for x in (images, self.images))
        value, _ = frame_loss(ours, theirs, background, loss, coverage)
        a, b = (srgb(dr.clip(x.xyz, 0, 1)).numpy().T.reshape(len(images), -1) for x in (ours, theirs))
        mse = ((a - b) ** 2).mean(1)
        return float(value[0]), float(np.mean(-10 * np.log10(np.maximum(mse, 1e-10))))
