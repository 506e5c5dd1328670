"""
What makes a model a character: skinning weights over the joints of a rig, in plain NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .rig import Rig, Skin


@dataclass(frozen=True)
class Rigging:
    """
    Dense skinning weights of a model's welded positions.

    Parameters
    ----------
    weights : ndarray, shape (P, J), float32
        Not negative, of sum 1.
    rig : Rig
        In the frame of the model.
    boxes : ndarray, shape (T + 1, 2, 3), float64
        Where the character is in each frame of the clip, for cameras to follow; last in the bind pose.
    fitted : ndarray, shape (N,), int64
        Frames that the fit sees; -1 is the bind pose.
    reach : float
        Above 0: while it is fitted, weights follow the distance of the moving vertices to the bones, and fall to 1/e
        over this distance; what is optimised comes on top.
    influences : int
        Joints that may pull at a vertex of an exported file, at most.
    rigid : bool
        Each joint carries whole parts: weights are 0 or 1 and stay so.
    """

    weights: np.ndarray
    rig: Rig
    boxes: np.ndarray
    fitted: np.ndarray
    influences: int = 4
    reach: float = 0.0
    rigid: bool = False

    def transformed(self, scale: float, offset: np.ndarray) -> Rigging:
        """
        That of a model with positions ``p * scale + offset``.
        """
        matrix = np.diag([scale, scale, scale, 1.0])
        matrix[:3, 3] = offset
        box = self.boxes * scale + np.asarray(offset)
        return replace(self, rig=self.rig.transformed(matrix), boxes=box, reach=self.reach * scale)

    def skin(self, limit: int | None = None) -> Skin:
        """
        The weights as a list of joints for each position, the strongest first.

        Parameters
        ----------
        limit : int, optional
            Joints that a position keeps at most; the weights of those that stay are scaled to sum 1.
        """
        weights = np.where(self.weights < NEGLIGIBLE, 0, self.weights).astype(np.float64)
        k = max(1, int((weights > 0).sum(1).max()))
        k = k if limit is None else min(limit, k)
        order = np.argsort(-weights, axis=1, kind="stable")[:, :k]
        kept = np.take_along_axis(weights, order, axis=1)
        return Skin(np.where(kept > 0, order, 0), kept / kept.sum(1, keepdims=True))

    def pruned(self) -> Rigging:
        """
        As it is exported: with at most ``influences`` joints a position.
        """
        weights = self.skin(self.influences).matrix(len(self.rig.names)).toarray()
        return replace(self, weights=weights.astype(np.float32))


#: Weights below this are what is left of zero where weights are fitted through their logarithms.
NEGLIGIBLE = 1e-4
