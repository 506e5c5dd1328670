"""
The zero set of a grid as triangles.
"""

from __future__ import annotations

import numpy as np

from ..errors import AssetError, RuntimeUnavailable


def marching_cubes(grid: np.ndarray, low: np.ndarray, cell, name: str) -> tuple[np.ndarray, np.ndarray]:
    """
    Positions (P, 3), float64, and faces (F, 3), counter-clockwise from outside, of the zero set of a grid.

    Parameters
    ----------
    grid : ndarray, shape (X, Y, Z)
        Negative inside.
    low : ndarray, shape (3,)
        Where ``grid[0, 0, 0]`` is.
    cell : (3,)
        Distance of the grid's points along each axis.
    """
    try:
        from skimage.measure import marching_cubes as lewiner
    except ImportError as error:
        raise RuntimeUnavailable(f"isosurfaces need scikit-image: pip install scikit-image ({error})") from error
    if not (grid.min() < 0 < grid.max()):
        raise AssetError(f"{name}: nothing of it is as large as a cell of the grid; raise the resolution")
    vertices, faces, _, _ = lewiner(grid, 0.0, spacing=tuple(cell), gradient_direction="descent")
    return np.asarray(vertices, np.float64) + low, np.asarray(faces, np.int64)
