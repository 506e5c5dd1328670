"""
Steps on the ambient light that a model is fitted under.
"""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from ...latent.environment import MapFilter, looked_up
from ...model.light.environment_map import rows_of
from .adam import Adam


class AmbientSteps:
    """
    The ambient light, and its optimiser where it is optimised.

    Parameters
    ----------
    start : ndarray, shape (K, 3), or None
        None where there is no such light; then nothing here does anything. A map is optimised texel by texel, and
        looked at through its filters.
    optimize : bool
    rate : float
    """

    def __init__(self, start: np.ndarray | None, optimize: bool, rate: float):
        self._shape = None if start is None else start.shape
        self._fixed = looked_up(start)
        self._start = start
        rows = 0 if start is None else rows_of(len(start))
        self._filter = MapFilter(rows) if rows and optimize else None
        self._adam = Adam(start.ravel(), rate) if start is not None and optimize else None

    @property
    def value(self) -> mi.Float | None:
        """What renderers look at, flat: coefficients, or the filtered texels of a map."""
        if self._adam is None:
            return self._fixed
        return self._adam.value if self._filter is None else self._filter.filtered(self._adam.value)

    def leaf(self) -> mi.Float | None:
        """
        The light, ready to collect a gradient where it is optimised.
        """
        if self._adam is None:
            return self._fixed
        leaf = mi.Float(self.value)
        dr.enable_grad(leaf)
        return leaf

    def step(self, leaf: mi.Float | None, factor: float) -> None:
        """
        One update from the gradient of a :meth:`leaf`; an ambient colour and a map stay positive.
        """
        if self._adam is not None:
            grad = dr.grad(leaf)
            self._adam.step(grad if self._filter is None else self._filter.gradient(grad), factor)
            if self._shape == (1, 3) or self._filter is not None:
                self._adam.value = dr.maximum(self._adam.value, 0)
                dr.eval(self._adam.value)

    def written(self) -> np.ndarray | None:
        """
        The light in NumPy, shape (K, 3), float32.
        """
        if self._adam is None:
            return self._start
        return self._adam.value.numpy().reshape(self._shape).copy()

    def parameters(self) -> dict[str, np.ndarray]:
        """What is optimised, as copies."""
        return {} if self._adam is None else {"ambient": self._adam.value.numpy().copy()}

    def restart(self, parameters: Mapping[str, np.ndarray]) -> None:
        """Go on from earlier :meth:`parameters`, the moments forgotten."""
        if self._adam is not None:
            self._adam.restart(parameters["ambient"])

    def is_finite(self) -> bool:
        """Whether no NaN or infinity has come in; waits for the device."""
        return self._adam is None or self._adam.is_finite()

    def state(self) -> dict:
        """All that later steps depend on, as copies."""
        return {} if self._adam is None else self._adam.state()

    def restore(self, state: dict) -> None:
        """Inverse of :meth:`state`."""
        if self._adam is not None:
            self._adam.restore(dict(state))
