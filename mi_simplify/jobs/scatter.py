"""
Places for thousands of copies: evenly scattered, each turned and sized at random.
"""

from __future__ import annotations

import numpy as np


def scatter(n: int, side: float, least_size: float, rng: np.random.Generator) -> np.ndarray:
    """
    Transforms of copies that stand on a square in the plane y = 0.

    One lies in each cell of a grid, at random, so that neither clumps nor gaps are larger than two cells.

    Parameters
    ----------
    n : int
    side : float
        Of the square, whose middle is the origin.
    least_size : float
        Sizes are between this and 1.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (n, 4, 4), float64
        A rotation about Y, a uniform scale and a translation each.
    """
    columns = int(np.ceil(np.sqrt(n)))
    cell = rng.permutation(columns * columns)[:n]
    place = (np.stack([cell % columns, cell // columns], 1) + rng.random((n, 2))) / columns - 0.5
    angle, size = rng.uniform(0, 2 * np.pi, n), rng.uniform(least_size, 1, n)
    out = np.zeros((n, 4, 4))
    out[:, 0, 0] = out[:, 2, 2] = np.cos(angle) * size
    out[:, 0, 2], out[:, 2, 0] = np.sin(angle) * size, -np.sin(angle) * size
    out[:, 1, 1], out[:, 3, 3] = size, 1
    out[:, 0, 3], out[:, 2, 3] = place.T * side
    return out
