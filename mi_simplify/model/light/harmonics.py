"""
Real spherical harmonics up to degree 3, for NumPy and Dr.Jit alike, and environments made of them.
"""

from __future__ import annotations

import numpy as np

MAX_DEGREE = 3

#: Numbers of coefficients of an ambient light: one colour, or an environment of degree 1 and up.
COUNTS = (1, 4, 9, 16)


def degree_of(n: int) -> int:
    """
    The degree that has ``n`` coefficients.
    """
    return round(n**0.5) - 1


def harmonics(degree: int, x, y, z) -> list:
    """
    The (degree + 1)² basis functions at a unit direction, band by band; orthonormal over the sphere (Sloan 2008).
    """
    out = [0.282094792 + 0 * x]
    if degree >= 1:
        out += [0.488602512 * y, 0.488602512 * z, 0.488602512 * x]
    if degree >= 2:
        out += [
            1.092548431 * x * y, 1.092548431 * y * z, 0.315391565 * (3 * z * z - 1), 1.092548431 * x * z,
            0.546274215 * (x * x - y * y),
        ]  # fmt: skip
    if degree >= 3:
        out += [
            0.590043590 * y * (3 * x * x - y * y), 2.890611443 * x * y * z, 0.457045799 * y * (5 * z * z - 1),
            0.373176333 * z * (5 * z * z - 3), 0.457045799 * x * (5 * z * z - 1), 1.445305721 * z * (x * x - y * y),
            0.590043590 * x * (x * x - 3 * y * y),
        ]  # fmt: skip
    return out


def constant_environment(color, degree: int = MAX_DEGREE) -> np.ndarray:
    """
    Coefficients, shape ((degree + 1)², 3), float32, of the same radiance (3,) from everywhere.
    """
    out = np.zeros(((degree + 1) ** 2, 3), np.float32)
    out[0] = np.asarray(color, np.float64) / 0.282094792
    return out


def environment_coefficients(image: np.ndarray, degree: int = MAX_DEGREE) -> np.ndarray:
    """
    The projection of a latitude-longitude image, shape (H, W, 3), as :func:`environment_image` lays it out;
    shape ((degree + 1)², 3), float32.
    """
    height, width = image.shape[:2]
    direction, weight = sphere_directions(height, width)
    basis = np.stack(harmonics(degree, *direction), axis=2) * weight[..., None]
    return np.einsum("hwk,hwc->kc", basis, np.asarray(image, np.float64)).astype(np.float32)


def sphere_directions(height: int, width: int) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """
    Unit vectors (x, y, z) of the pixels of a latitude-longitude image, and the solid angles of these, shape (H, W)
    each.
    """
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    theta, phi = np.pi * v, 2 * np.pi * u
    direction = (np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi))
    return direction, np.sin(theta) * (2 * np.pi / width) * (np.pi / height)


def environment_image(coefficients: np.ndarray, height: int = 64) -> np.ndarray:
    """
    An environment as a latitude-longitude image, shape (height, 2·height, 3), float32, not below zero.

    The top row is +Y, the middle column +Z: how Mitsuba and glTF viewers hold such images.
    """
    direction, _ = sphere_directions(height, 2 * height)
    basis = np.stack(harmonics(degree_of(len(coefficients)), *direction), axis=2)
    return np.maximum(basis @ np.asarray(coefficients, np.float64), 0).astype(np.float32)
