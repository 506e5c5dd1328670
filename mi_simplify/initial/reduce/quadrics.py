"""
Quadrics of squared distances to planes, ten numbers each: A00 A01 A02 A11 A12 A22, b, c of xᵀAx + 2bᵀx + c.
"""

from __future__ import annotations

import numpy as np


def planes(normal: np.ndarray, point: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Quadrics of squared distances to planes, shape (N, 10)."""
    n, d = normal, -np.einsum("ni,ni->n", normal, point)
    terms = [n * n[:, :1], n[:, 1:] * n[:, 1:2], n[:, 2:] * n[:, 2:], n * d[:, None], (d * d)[:, None]]
    return np.concatenate(terms, 1) * weight[:, None]


def evaluate(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values of quadrics (N, 10) at points (N, 3), shape (N,)."""
    x, y, z = x.T
    square = q[:, 0] * x * x + q[:, 3] * y * y + q[:, 5] * z * z
    mixed = q[:, 1] * x * y + q[:, 2] * x * z + q[:, 4] * y * z + q[:, 6] * x + q[:, 7] * y + q[:, 8] * z
    return square + 2 * mixed + q[:, 9]


def minimise(q: np.ndarray, anchor: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """Where quadrics are least, with a weak pull to ``anchor`` (Cramer's rule; the pull keeps it solvable)."""
    a, b, c, d, e, f = q[:, 0] + pull, q[:, 1], q[:, 2], q[:, 3] + pull, q[:, 4], q[:, 5] + pull
    x, y, z = (pull[:, None] * anchor - q[:, 6:9]).T
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    m11, m12, m22 = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * m00 + b * m01 + c * m02
    point = np.stack([m00 * x + m01 * y + m02 * z, m01 * x + m11 * y + m12 * z, m02 * x + m12 * y + m22 * z], 1)
    return np.where(determinant[:, None] > 0, point / np.maximum(determinant, 1e-300)[:, None], anchor)
