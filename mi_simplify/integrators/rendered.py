"""
What the renderer of the fitting loop hands over: an image, and what it takes to differentiate it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ..latent.texel_gradient import TouchedBlocks
from .camera import FilmRays, PixelRays
from .gbuffer import Hits


@dataclass
class RenderedBatch:
    """
    Views that were rendered: their image, and what its derivatives need.

    Parameters
    ----------
    image : mi.Vector4f, width B·height·width
        Premultiplied radiance and coverage of every pixel.
    views : mi.Float
        Packets of the cameras, attached where the views are.
    rays : FilmRays or PixelRays
        Those that are shaded; detached.
    hits : Hits or None
        None where nothing was hit.
    touched : TouchedBlocks or None
        Of the textures; None where nothing was hit, or rendered under ``dr.suspend_grad()``.
    values : mi.Vector4f or None
        Premultiplied radiance and coverage of each hit; with several layers only.
    unpeeled : mi.Float or None
        Coverage that one more layer would add to the pixel of each ray; with several layers only.
    """

    image: mi.Vector4f
    views: mi.Float
    rays: FilmRays | PixelRays
    hits: Hits | None = None
    touched: TouchedBlocks | None = None
    values: mi.Vector4f | None = None
    unpeeled: mi.Float | None = None

    def images(self) -> np.ndarray:
        """
        The image in NumPy, shape (B, height, width, 4), float32.
        """
        cameras = self.rays.cameras
        return self.image.numpy().T.reshape(cameras.n_views, cameras.height, cameras.width, 4)
