"""
Where both sides of a step look at their pixels: at the same places if the reference can, else wherever chance has it.
"""

from __future__ import annotations

import numpy as np

from ..config import FitSettings
from ..scenes.references.reference import Reference, is_aligned
from ..scenes.views import Views

#: Of the film positions that all images of a fit share.
_SHARED_SEED = 1


class Samples:
    """
    The reference as a step sees it, and the samples of the latent images beside.

    Two samples a pixel of a textured surface are noisy, but of two surfaces that are nearly the same they are off by
    the same, and the loss is of what is left. Skull at 3,000 triangles, 150 steps, a path tracer's judgement: 43.96 dB
    with two shared samples, 43.86 with two against four of the reference's own, for half the time of a reference image.

    Parameters
    ----------
    reference : Reference
    settings : FitSettings
        ``reference.spp``, where it is stated, holds for a reference with samples of its own.

    Attributes
    ----------
    spp : int
        Samples per pixel of a latent image.
    """

    def __init__(self, reference: Reference, settings: FitSettings):
        self._reference, self.spp = reference, settings.optimizer.spp
        self._aligned = None
        if settings.reference.spp is None and settings.optimizer.shade == "sample" and is_aligned(reference):
            self._aligned = reference

    @property
    def are_shared(self) -> bool:
        """Whether both sides look at the same places."""
        return self._aligned is not None

    def seed(self, own: int) -> int:
        """
        Seed of the film positions of a latent image that would have one of its ``own``.
        """
        return _SHARED_SEED if self.are_shared else own

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`..scenes.references.reference.Reference`.
        """
        if self._aligned is not None:
            return self._aligned.render(views, _SHARED_SEED, self.spp)
        return self._reference.render(views, seed)

    def held_out(self, views: Views) -> np.ndarray:
        """
        Images that are good enough to be judged by.
        """
        if self._aligned is not None:
            return self._aligned.render(views, LOOK_SEED, LOOK_SPP)
        return np.mean([self._reference.render(views, seed=k + 1) for k in range(_RENDERS)], axis=0)


#: Samples per pixel by which a state is judged, and their seed: the same places every time, so that their noise hardly
#: matters.
LOOK_SPP, LOOK_SEED = 8, 1

#: Renderings by the reference that are averaged to judge by, each of ``reference.spp``: their noise must be less than
#: what a step near the optimum gains.
_RENDERS = 4
