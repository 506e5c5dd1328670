"""
The one sRGB transfer curve (IEC 61966-2-1), in plain NumPy; its differentiable form is :func:`..fitting.losses.srgb`.
"""

from __future__ import annotations

import numpy as np


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """
    Encode linear values, clipped to [0, 1]; float32 stays float32, everything else becomes float64.
    """
    x = np.clip(_floats(x), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """
    Inverse of :func:`linear_to_srgb`.
    """
    x = np.clip(_floats(x), 0.0, 1.0)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def _floats(x: np.ndarray) -> np.ndarray:
    x = np.asarray(x)
    return x if x.dtype == np.float32 else x.astype(np.float64)
