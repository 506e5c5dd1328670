"""
The ambient term of a model as a texture of its own light; plain NumPy.
"""

from __future__ import annotations

import numpy as np


def emission_of(ambient: np.ndarray, base_color: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """
    What :func:`..latent.ambient.ambient_radiance` is, texel by texel, shape (H, W, 3), linear.

    Parameters
    ----------
    ambient : ndarray, shape (1, 3)
    base_color : ndarray, shape (H, W, 3 or 4)
    metallic : ndarray, shape (H, W)
    """
    return (ambient[0] * base_color[..., :3] * (1 - metallic[..., None])).astype(np.float32)
