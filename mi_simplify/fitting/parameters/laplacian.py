"""
The paper's mesh regulariser: uniform Laplacian, absolute or relative to the first guess.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.upload import upload


class Laplacian:
    """
    ``L_δ = 1/n Σ |δ_i - δ'_i|²`` with ``δ_i = v_i - mean of its one-ring`` (Hasselgren et al. 2021, Eq. 5).

    Parameters
    ----------
    faces : ndarray, shape (F, 3)
        Over welded positions.
    first_guess : ndarray, shape (P, 3)
    relative : bool
        δ' is that of the first guess; else 0.
    """

    def __init__(self, faces: np.ndarray, first_guess: np.ndarray, relative: bool):
        n = len(first_guess)
        ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        ends = np.unique(np.sort(ends, axis=1), axis=0)
        ends = ends[ends[:, 0] != ends[:, 1]]
        both = np.concatenate([ends, ends[:, ::-1]])
        degree = np.bincount(both[:, 0], minlength=n)
        self._n = n
        self._row, self._column = (upload(mi.UInt32, both[:, k]) for k in (0, 1))
        self._weight = upload(mi.Float, 1 / degree[both[:, 0]])
        self._has_ring = upload(mi.Float, (degree > 0).astype(np.float32))
        positions = upload(mi.Float, np.ravel(first_guess))
        target = self.differentials(positions)
        self.absolute_start = float(dr.sum(dr.squared_norm(target))[0] / n)
        """L_δ of the first guess with δ' = 0, which the default weight is balanced against."""
        self._target = target if relative else mi.Vector3f(0)
        dr.eval(self._target)

    def differentials(self, positions: mi.Float) -> mi.Vector3f:
        """
        δ of every position, width P; zero for a position without neighbours.
        """
        ring = dr.zeros(mi.Float, self._n * 3)
        neighbour = dr.gather(mi.Vector3f, positions, self._column)
        dr.scatter_reduce(dr.ReduceOp.Add, ring, neighbour * self._weight, self._row)
        lane = dr.arange(mi.UInt32, self._n)
        return (dr.gather(mi.Vector3f, positions, lane) - dr.gather(mi.Vector3f, ring, lane)) * self._has_ring

    def loss(self, positions: mi.Float) -> mi.Float:
        """
        L_δ of flat positions, width 1; differentiable.
        """
        return dr.sum(dr.squared_norm(self.differentials(positions) - self._target)) / self._n
