"""
Steps on vertex positions: uniform Adam in a smoothed parameterisation.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..upload import upload


class VertexSteps:
    """
    Positions v through ``u = (I + λL) v``, optimised by Adam with one second moment for all (Nicolet et al. 2021).

    Gradients spread over the surface, so sparse silhouette gradients move whole regions and do not crumple the mesh.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
        Welded.
    faces : ndarray, shape (F, 3)
    rate : float
        Learning rate [normalised units].
    lambda_ : float
        Diffusion; 0 gives plain uniform Adam.
    """

    def __init__(self, positions: np.ndarray, faces: np.ndarray, rate: float, lambda_: float):
        flat = upload(mi.Float, np.ravel(positions))
        # LargeSteps welds by equal coordinates; our positions are distinct by construction, but need not be.
        keys = np.arange(len(positions) * 3, dtype=np.float32)
        self._diffusion = None
        if lambda_ > 0:
            self._diffusion = mi.ad.LargeSteps(upload(mi.Float, keys), upload(mi.UInt32, faces.ravel()), lambda_)
        start = self._diffusion.to_differential(flat) if self._diffusion else flat
        self._rate = rate
        self._adam = mi.ad.Adam(lr=rate, uniform=True, beta_1=0.9, beta_2=0.999, params={"u": start})

    def positions(self) -> mi.Float:
        """
        Current positions, flat, width P·3, attached to the parameter.
        """
        u = self._adam["u"]
        v = self._diffusion.from_differential(u) if self._diffusion else mi.Float(u)
        dr.eval(v)
        return v

    def step(self, grad_positions: mi.Float, positions: mi.Float, factor: float) -> None:
        """
        One update from the gradient of the positions that :meth:`positions` returned.
        """
        dr.set_grad(positions, grad_positions)
        dr.enqueue(dr.ADMode.Backward, positions)
        dr.traverse(dr.ADMode.Backward)
        self._adam.set_learning_rate({"u": self._rate * factor})
        self._adam.step()
