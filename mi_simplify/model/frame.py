"""
The frame that the optimiser works in, and back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .asset import Asset
from .model import Model


@dataclass(frozen=True)
class Frame:
    """
    The normalised frame of an asset: its box has side 2 (the longest) and centre 0.

    Parameters
    ----------
    scale : float
        Normalised length of one unit of the file.
    center : ndarray, shape (3,)
        Centre of the asset's box [units of the file].
    """

    scale: float
    center: np.ndarray

    @staticmethod
    def around(bounds: np.ndarray) -> Frame:
        """
        The frame of a box, shape (2, 3).
        """
        return Frame(2.0 / float((bounds[1] - bounds[0]).max()), bounds.mean(0))

    @property
    def matrix(self) -> np.ndarray:
        """From the units of the file to this frame, shape (4, 4)."""
        to_frame = np.diag([self.scale, self.scale, self.scale, 1.0])
        to_frame[:3, 3] = -self.scale * self.center
        return to_frame

    def normalised(self, asset: Asset) -> Asset:
        """
        The asset in this frame.
        """
        return asset.transformed(self.matrix)

    def restored(self, model: Model) -> Model:
        """
        A model of this frame back in the units of the file.
        """
        return model.transformed(1.0 / self.scale, self.center)
