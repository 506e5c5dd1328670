"""
What all readers of USD need: when they look, where they look, and values as NumPy.
"""

from __future__ import annotations

import numpy as np
from pxr import Usd

#: When a stage is looked at.
TIME = Usd.TimeCode.EarliestTime()

#: Which prims are visited: active, defined ones, and those inside instances.
VISITED = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)


def array(value: object, dtype, width: int | None = None) -> np.ndarray:
    """
    A USD array as NumPy, of rows of ``width`` values where that is given; empty where it is not authored.
    """
    out = np.zeros(0) if value is None else np.array(value)
    return out.astype(dtype).reshape(-1) if width is None else out.astype(dtype).reshape(-1, width)


def matrix(value: object) -> np.ndarray:
    """
    USD's row-vector matrix for column vectors, shape (4, 4).
    """
    return np.array(value, np.float64).T
