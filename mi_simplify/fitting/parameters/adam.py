"""
Adam over one flat array of parameters.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.upload import upload


class Adam:
    """
    Dense Adam (Kingma and Ba 2015); entries without a gradient keep still until they first have one.

    Parameters
    ----------
    value : ndarray
        Start, taken flat.
    rate : float
        Typical step.
    """

    def __init__(self, value: np.ndarray, rate: float, beta1: float = 0.9, beta2: float = 0.99):
        self._rate, self._beta1, self._beta2 = rate, beta1, beta2
        self._steps = 0
        self.value: mi.Float
        self._m: mi.Float
        self._v: mi.Float
        self.restart(value)

    def step(self, grad: mi.Float, factor: float) -> None:
        """
        One update; ``factor`` scales the rate.
        """
        self._steps += 1
        self._m = dr.lerp(grad, self._m, self._beta1)
        self._v = dr.lerp(dr.square(grad), self._v, self._beta2)
        correct = (1 - self._beta2**self._steps) ** 0.5 / (1 - self._beta1**self._steps)
        scale = dr.opaque(mi.Float, self._rate * factor * correct)
        self.value = self.value - self._m * dr.rsqrt(dr.maximum(self._v, 1e-24)) * scale
        dr.eval(self.value, self._m, self._v)

    def is_finite(self) -> bool:
        """
        Whether no NaN or infinity has come in; waits for the device.
        """
        return bool(dr.all(dr.isfinite(self.value) & dr.isfinite(self._v))[0])

    def state(self) -> dict:
        """
        What later steps depend on, as copies.
        """
        arrays = {"value": self.value, "m": self._m, "v": self._v}
        return {"steps": self._steps, **{name: array.numpy().copy() for name, array in arrays.items()}}

    def restore(self, state: dict) -> None:
        """
        Inverse of :meth:`state`.
        """
        self.value, self._m, self._v = (upload(mi.Float, state[name]) for name in ("value", "m", "v"))
        self._steps = state["steps"]

    def restart(self, value: np.ndarray) -> None:
        """
        Go on from an earlier value, the moments forgotten.
        """
        flat = np.ravel(value).astype(np.float32)
        self.restore({"value": flat, "m": np.zeros_like(flat), "v": np.zeros_like(flat), "steps": 0})
