"""
Light for transfer coefficients: environments as spherical harmonics, and turned about +Y.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..model.light.harmonics import degree_of, environment_coefficients, environment_image, harmonics


def rotation(order: int, turn: np.ndarray) -> np.ndarray:
    """
    What a rotation does to coefficients: those of ``f(R⁻¹ω)`` are this matrix times those of ``f``.

    Parameters
    ----------
    order : int
        Highest band.
    turn : ndarray, shape (3, 3)
        Rotation R.

    Returns
    -------
    ndarray, shape ((order + 1)², (order + 1)²), float64
        Exact but for rounding: the basis is closed under rotations, so its values at any directions that determine the
        coefficients determine the matrix.
    """
    directions = spiral(64)
    basis = np.stack(np.broadcast_arrays(*harmonics(order, *directions.T)), axis=1)
    turned = np.stack(np.broadcast_arrays(*harmonics(order, *(directions @ turn).T)), axis=1)  # rows: R⁻¹ω
    return np.linalg.lstsq(basis, turned, rcond=None)[0]


def turned(light: np.ndarray, degrees: float) -> np.ndarray:
    """
    An environment, coefficients of shape (K, 3), turned about +Y by an angle that takes +Z towards +X.
    """
    a = np.radians(degrees)
    about = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return (rotation(degree_of(len(light)), about) @ light).astype(np.float32)


def turning_series(light: np.ndarray) -> np.ndarray:
    """
    The turned environment as a Fourier series of its angle a, which a viewer sums up in no time.

    Returns
    -------
    ndarray, shape (2·order + 1, K, 3), float32
        Terms of 1, cos a, sin a, cos 2a, sin 2a, …; see :func:`turned` for the sense of the angle.
    """
    n = 2 * degree_of(len(light)) + 1
    samples = np.stack([turned(light, 360 * k / n) for k in range(n)]).astype(np.float64)
    angles = 2 * np.pi * np.arange(n) / n
    terms = [np.ones(n)] + [f(k * angles) for k in range(1, n // 2 + 1) for f in (np.cos, np.sin)]
    return np.einsum("ta,akc->tkc", np.linalg.inv(np.stack(terms, axis=1)), samples).astype(np.float32)


def shade(transfer: np.ndarray, light: np.ndarray) -> np.ndarray:
    """
    Radiance, shape (..., 3), linear and not below zero, from coefficients of transfer (..., K) and light (K, 3).
    """
    return np.maximum(np.asarray(transfer, np.float32) @ np.asarray(light, np.float32), 0)


def spiral(n: int) -> np.ndarray:
    """
    ``n`` unit vectors spread evenly over the sphere, shape (n, 3).
    """
    k = np.arange(n) + 0.5
    y, a = 1 - 2 * k / n, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(a), y, r * np.sin(a)], axis=1)


def sky(name: str, order: int = 3) -> np.ndarray:
    """
    Coefficients, shape ((order + 1)², 3), of one of :data:`SKIES`, scaled so that a white plane that lies open to it
    facing up has radiance 1.
    """
    height = 64
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    theta, phi = np.pi * v, 2 * np.pi * u
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=2)
    return exposed(environment_coefficients(np.maximum(SKIES[name](d), 0), order))


def exposed(light: np.ndarray) -> np.ndarray:
    """
    An environment, coefficients (K, 3), scaled so that the brightest channel of a white plane facing up has radiance 1.
    """
    from .cast import unshadowed

    up = shade(unshadowed(np.array([0.0, 1.0, 0.0]), degree_of(len(light)), 1.0), light)
    return (light / max(float(up.max()), 1e-6)).astype(np.float32)


def environment(light: np.ndarray, height: int = 128) -> np.ndarray:
    """
    An environment as a latitude-longitude image, shape (height, 2·height, 3), clipped at zero.
    """
    return environment_image(light, height)


def _lamp(d: np.ndarray, towards: tuple[float, float, float], sharpness: float) -> np.ndarray:
    axis = np.array(towards) / np.linalg.norm(towards)
    return np.exp(sharpness * (d @ axis - 1))[..., None]


def _evening(d: np.ndarray) -> np.ndarray:
    """A low warm sun and a blue dome."""
    dome = np.clip(d[..., 1:2] + 0.2, 0, 1) * np.array([0.25, 0.4, 0.8])
    return dome + 6 * _lamp(d, (0.9, 0.35, 0.4), 12) * np.array([1.0, 0.6, 0.3])


def _window(d: np.ndarray) -> np.ndarray:
    """A dark room with one window."""
    return 0.05 + 8 * _lamp(d, (-0.6, 0.5, 0.7), 20) * np.array([0.9, 0.95, 1.0])


def _studio(d: np.ndarray) -> np.ndarray:
    """Three lamps of different colours."""
    key = 5 * _lamp(d, (0.3, 0.8, 0.7), 8) * np.array([1.0, 0.95, 0.9])
    fill = 1.5 * _lamp(d, (-0.9, 0.2, 0.4), 6) * np.array([0.4, 0.6, 1.0])
    return key + fill + 4 * _lamp(d, (0.2, 0.3, -1.0), 15) * np.array([1.0, 0.7, 0.5])


SKIES: dict[str, Callable[[np.ndarray], np.ndarray]] = {"evening": _evening, "window": _window, "studio": _studio}
"""Three environments as functions of unit vectors (..., 3); no network is trained on any light."""
