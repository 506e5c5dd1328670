"""
Coarser levels of a material in closed form: what a pixel that covers many texels shows of them, in plain NumPy.
"""

from __future__ import annotations

import numpy as np


def n_levels(height: int, width: int) -> int:
    """
    Levels of a whole chain, down to one texel.

    Raises
    ------
    ValueError
        A side is not a power of two.
    """
    if height & (height - 1) or width & (width - 1):
        raise ValueError(f"mip levels need sides that are powers of two, got {width} x {height}")
    return max(height, width).bit_length()


def halved(image: np.ndarray) -> np.ndarray:
    """
    The next coarser level of an image (H, W, C): the mean of two by two texels.
    """
    for axis in (0, 1):
        if image.shape[axis] > 1:
            image = image.reshape(*image.shape[:axis], -1, 2, *image.shape[axis + 1 :]).mean(axis + 1)
    return image


def coarser(image: np.ndarray, times: int) -> np.ndarray:
    """
    An image (H, W, C) at the level that is so many times, a power of two, coarser.
    """
    for _ in range(times.bit_length() - 1):
        image = halved(image)
    return image


def filtered_levels(base_color: np.ndarray, specular: np.ndarray, normal: np.ndarray) -> list[dict[str, np.ndarray]]:
    """
    All coarser levels of a material, the spread of its normals turned into roughness.

    Colours are means, weighted by opacity. The normals below a texel are a distribution of its own: their mean is its
    normal, and the length r < 1 of that mean, which says how far they spread, widens the lobe of the microfacets. With
    r as Toksvig (2005) measures it, slopes have the variance (1 - r)/r along either axis, and slope variances add up
    (Olano and Baker 2010), those of a GGX lobe being taken for α²/2:

        α'² = mean of α² + 2 (1 - r)/r        roughness = √α

    Parameters
    ----------
    base_color : ndarray, shape (H, W, 4)
    specular : ndarray, shape (H, W, 3)
        (gamma, roughness, metallic).
    normal : ndarray, shape (H, W, 3)
        Tangent space.

    Returns
    -------
    list of dict
        ``base_color``, ``specular`` and unit ``normal`` of every level but the finest, float32.
    """
    opacity = np.asarray(base_color[..., 3:], np.float64)
    colour = base_color[..., :3] * opacity
    plain = np.asarray(base_color[..., :3], np.float64)
    gamma_metal = np.asarray(specular[..., ::2], np.float64)
    alpha2 = np.asarray(specular[..., 1:2], np.float64) ** 4
    normal = normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-8)
    levels = []
    for _ in range(n_levels(*opacity.shape[:2]) - 1):
        opacity, colour, plain, gamma_metal, alpha2, normal = (
            halved(x) for x in (opacity, colour, plain, gamma_metal, alpha2, normal)
        )
        r = np.clip(np.linalg.norm(normal, axis=2, keepdims=True), 1e-3, 1.0)
        roughness = np.clip(alpha2 + 2 * (1 - r) / r, 0.0, 1.0) ** 0.25
        rgb = np.where(opacity > 1e-3, colour / np.maximum(opacity, 1e-3), plain)
        images = dict(
            base_color=np.concatenate([rgb, opacity], axis=2),
            specular=np.concatenate([gamma_metal[..., :1], roughness, gamma_metal[..., 1:]], axis=2),
            normal=normal / r,
        )
        levels.append({name: image.astype(np.float32) for name, image in images.items()})
    return levels
