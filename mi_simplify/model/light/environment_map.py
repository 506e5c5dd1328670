"""
Environments as latitude-longitude maps, and the filters that glossy surfaces look at them through; plain NumPy.

A map has twice as many columns as rows; its top row is +Y, the middle column +Z, as in :mod:`.harmonics`. As the
ambient light of a model it is all its texels, row after row, shape (2·rows², 3).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, vstack

from .harmonics import COUNTS, environment_coefficients, environment_image, harmonics, sphere_directions

#: Rows of a map that there can be.
ROWS = (8, 16, 32, 64, 128)

#: Rows of the coarsest level.
_COARSEST = 4

#: Standard deviation of a level's kernel, in its own texels, and how many of these it reaches.
_SIGMA, _REACH = 0.5, 3.0

#: Degree of the harmonics that diffuse surfaces see of a map.
DIFFUSE_DEGREE = 3


def rows_of(n: int) -> int:
    """
    Rows of the map that has ``n`` texels; 0 where these are coefficients of harmonics.
    """
    return 0 if n in COUNTS else math.isqrt(n // 2)


def n_levels(rows: int) -> int:
    """How many levels a map has, itself the first."""
    return rows.bit_length() - _COARSEST.bit_length() + 1


def n_filtered(rows: int) -> int:
    """Rows of :func:`filters`."""
    return sum(2 * (rows >> level) ** 2 for level in range(n_levels(rows))) + (DIFFUSE_DEGREE + 1) ** 2


def rows_of_filtered(n: int) -> int:
    """
    Inverse of :func:`n_filtered`; 0 where nothing was filtered, which are coefficients of harmonics.
    """
    return 0 if n in COUNTS else next(rows for rows in ROWS if n_filtered(rows) == n)


def filters(rows: int) -> csr_array:
    """
    What is looked up in a map, as a matrix times its texels.

    Level l has ``rows / 2^l`` rows: the map under a Gaussian on the sphere of half a texel of that level, so that it is
    as wide at the poles as elsewhere; level 0 is the map itself. Behind the levels are the map's coefficients in
    spherical harmonics of degree :data:`DIFFUSE_DEGREE`.

    Returns
    -------
    csr_array, shape (n_filtered(rows), 2·rows²), float32
    """
    (x, y, z), solid_angle = sphere_directions(rows, 2 * rows)
    sources, weight = np.stack([x, y, z], axis=2).reshape(-1, 3), solid_angle.ravel()
    parts = [eye_array(len(sources), format="csr")]
    for level in range(1, n_levels(rows)):
        height = rows >> level
        centres = np.stack(sphere_directions(height, 2 * height)[0], axis=2).reshape(-1, 3)
        parts.append(_blur(centres, sources, weight, _SIGMA * np.pi / height))
    basis = np.stack(harmonics(DIFFUSE_DEGREE, x, y, z)).reshape((DIFFUSE_DEGREE + 1) ** 2, -1)
    parts.append(csr_array(basis * weight))
    return vstack(parts, format="csr").astype(np.float32)


def _blur(centres: np.ndarray, sources: np.ndarray, weight: np.ndarray, sigma: float) -> csr_array:
    """Means of the sources around each centre, shape (centres, sources)."""
    rows, columns, values = [], [], []
    for first in range(0, len(centres), 256):
        away = 1 - centres[first : first + 256] @ sources.T  # half the square of the chord
        row, column = np.nonzero(away < 1 - np.cos(min(_REACH * sigma, np.pi)))
        value = np.exp(-away[row, column] / sigma**2) * weight[column]
        total = np.bincount(row, value)
        rows.append(row + first)
        columns.append(column)
        values.append(value / total[row])
    where = np.concatenate(rows), np.concatenate(columns)
    return coo_array((np.concatenate(values), where), shape=(len(centres), len(sources))).tocsr()


def environment_map(ambient: np.ndarray) -> np.ndarray:
    """
    An environment, harmonics or a map, as a latitude-longitude image, shape (rows, 2·rows, 3), float32, linear.
    """
    rows = rows_of(len(ambient))
    return environment_image(ambient) if rows == 0 else np.float32(ambient).reshape(rows, 2 * rows, 3)


def as_map(ambient: np.ndarray, rows: int) -> np.ndarray:
    """
    An environment as the texels of a map, shape (2·rows², 3), float32, not below zero.
    """
    if rows_of(len(ambient)) == 0:
        return environment_image(ambient, rows).reshape(-1, 3)
    return resized(environment_map(ambient), rows).reshape(-1, 3)


def as_harmonics(ambient: np.ndarray) -> np.ndarray:
    """
    Harmonics of an environment, shape (16, 3); those that it has already stay.
    """
    rows = rows_of(len(ambient))
    return np.asarray(ambient, np.float32) if rows == 0 else environment_coefficients(environment_map(ambient))


def resized(image: np.ndarray, rows: int) -> np.ndarray:
    """
    A latitude-longitude image of any size with ``rows`` rows and twice as many columns: means by solid angle; shape
    (rows, 2·rows, 3), float32.
    """
    image = np.asarray(image, np.float64)
    height, width = image.shape[:2]
    down = _overlaps(np.cos(np.pi * np.arange(height + 1) / height), np.cos(np.pi * np.arange(rows + 1) / rows))
    across = _overlaps(np.arange(width + 1) / width, np.arange(2 * rows + 1) / (2 * rows))
    return np.einsum("yh,hwc,xw->yxc", down, image, across, optimize=True).astype(np.float32)


def _overlaps(borders: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Share of every cell between these borders in each wanted one, shape (wanted, cells); rows add up to 1."""
    sign = np.sign(borders[-1] - borders[0])
    borders, wanted = borders * sign, wanted * sign
    low = np.maximum(wanted[:-1, None], borders[None, :-1])
    high = np.minimum(wanted[1:, None], borders[None, 1:])
    return np.maximum(high - low, 0) / np.diff(wanted)[:, None]
