"""
Steps on vertex positions: Adam with one rate for a vertex's three coordinates, in a smoothed parameterisation.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.upload import upload


class VertexSteps:
    """
    Positions v through ``u = (I + λL) v`` (Nicolet et al. 2021), optimised by a rotation-invariant Adam.

    Gradients spread over the surface, so sparse silhouette gradients move whole regions and do not crumple the mesh.
    The second moment of a vertex is that of its gradient's length (VectorAdam, Ling et al. 2022), averaged with the
    mean over all vertices: steps do not depend on the axes, vertices that the images say little about move little, and
    no single noisy vertex slows down the others, as it does where all are divided by the largest (UniformAdam).

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
        Welded.
    faces : ndarray, shape (F, 3)
    rate : float
        Typical step [normalised units].
    lambda_ : float
        Diffusion; 0 for none.
    """

    def __init__(self, positions: np.ndarray, faces: np.ndarray, rate: float, lambda_: float, beta1=0.9, beta2=0.99):
        flat = upload(mi.Float, np.ravel(positions))
        self._diffusion = None
        if lambda_ > 0:
            # LargeSteps welds by equal coordinates; our positions are welded already, and may coincide.
            keys = upload(mi.Float, np.arange(positions.size, dtype=np.float32))
            self._diffusion = mi.ad.LargeSteps(keys, upload(mi.UInt32, faces.ravel()), lambda_)
        self._u = self._diffusion.to_differential(flat) if self._diffusion else flat
        self._rate, self._beta1, self._beta2 = rate, beta1, beta2
        self._m = dr.zeros(mi.Vector3f, len(positions))
        self._v = dr.zeros(mi.Float, len(positions))
        self._steps = 0
        dr.enable_grad(self._u)

    def positions(self) -> mi.Float:
        """
        Current positions, flat, width P·3, attached to the parameter.
        """
        v = self._diffusion.from_differential(self._u) if self._diffusion else mi.Float(self._u)
        dr.eval(v)
        return v

    def step(self, grad_positions: mi.Float, positions: mi.Float, factor: float) -> None:
        """
        One update from the gradient of the positions that :meth:`positions` returned.
        """
        dr.set_grad(positions, grad_positions)
        dr.enqueue(dr.ADMode.Backward, positions)
        dr.traverse(dr.ADMode.Backward)
        grad = dr.unravel(mi.Vector3f, dr.grad(self._u))
        self._steps += 1
        self._m = dr.lerp(grad, self._m, self._beta1)
        self._v = dr.lerp(dr.squared_norm(grad), self._v, self._beta2)
        correct = (1 - self._beta2**self._steps) ** 0.5 / (1 - self._beta1**self._steps)
        scale = dr.opaque(mi.Float, self._rate * factor * correct)
        dr.eval(self._m, self._v)
        step = self._m * dr.rsqrt(dr.maximum(0.5 * (self._v + dr.mean(self._v)), 1e-24)) * scale
        self._u = dr.detach(self._u) - dr.ravel(step)
        dr.enable_grad(self._u)
        dr.eval(self._u)

    def is_finite(self) -> bool:
        """
        Whether no NaN or infinity has come in; waits for the device.
        """
        return bool(dr.all(dr.isfinite(dr.detach(self._u)))[0] and dr.all(dr.isfinite(self._v))[0])

    def state(self) -> dict:
        """
        What later steps depend on: copies of u, flat, and of the moments m (P, 3) and v (P,).
        """
        arrays = {"u": dr.detach(self._u), "m": self._m, "v": self._v}
        return {"steps": self._steps, **{name: array.numpy().T.copy() for name, array in arrays.items()}}

    def restore(self, state: dict) -> None:
        """
        Inverse of :meth:`state`.
        """
        self._u, self._m = upload(mi.Float, state["u"]), upload(mi.Vector3f, state["m"])
        self._v, self._steps = upload(mi.Float, state["v"]), state["steps"]
        dr.enable_grad(self._u)

    def restart(self, u: np.ndarray) -> None:
        """
        Go on from the ``u`` of an earlier state, the moments forgotten.
        """
        n = len(u) // 3
        self.restore({"u": u, "m": np.zeros((n, 3)), "v": np.zeros(n), "steps": 0})
