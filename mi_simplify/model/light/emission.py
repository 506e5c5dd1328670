"""
The light that surfaces give off by themselves, and the ambient term of a model, which files carry as such; plain NumPy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..asset import Asset, Material
from .harmonics import COUNTS

#: Emission up to this share of the largest is what 8 bits leave of zero.
_NOISE = 2.0 / 255


def emission_of(ambient: np.ndarray, base_color: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """
    What :func:`...latent.ambient.ambient_radiance` is, texel by texel, shape (H, W, 3), linear.

    Parameters
    ----------
    ambient : ndarray, shape (1, 3)
    base_color : ndarray, shape (H, W, 3 or 4)
    metallic : ndarray, shape (H, W)
    """
    return (ambient[0] * base_color[..., :3] * (1 - metallic[..., None])).astype(np.float32)


def ambient_of(text: object) -> np.ndarray | None:
    """
    The ambient light of a model as files of ours tell it, numbers with blanks between, shape (K, 3); None for nonsense.
    """
    try:
        ambient = np.array(str(text).split(), np.float32).reshape(-1, 3)
    except ValueError:
        return None
    return ambient if len(ambient) in COUNTS and np.isfinite(ambient).all() else None


def without_ambient(asset: Asset, ambient: np.ndarray | None) -> Asset:
    """
    An asset read from a file of ours whose emission holds the ambient term, with what is left of that as emission.

    Parameters
    ----------
    ambient : ndarray, shape (K, 3), or None
        Files carry that of one colour alone in this way.
    """
    if ambient is None or len(ambient) != 1:
        return asset
    mended = {id(part.material): own_emission(part.material, ambient) for part in asset.parts}
    return replace(asset, parts=tuple(replace(part, material=mended[id(part.material)]) for part in asset.parts))


def own_emission(material: Material, ambient: np.ndarray) -> Material:
    """
    A material without the ambient term, of one colour (1, 3), that its emission holds.
    """
    if material.emission is None:
        return material
    images = (material.emission, material.base_color, material.specular)  # files hold each at a size of its own
    height, width = (max(image.shape[axis] for image in images) for axis in (0, 1))
    emission, base, specular = (_nearest(image, height, width) for image in images)
    left = emission - emission_of(ambient, base, specular[..., 2])
    left = np.where(left > _NOISE * material.emission.max(), left, 0).astype(np.float32)
    return replace(material, emission=left if left.any() else None)


def _nearest(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """An image at another size, each texel that whose place it is in."""
    rows, columns = (np.arange(n) * m // n for n, m in zip((height, width), image.shape[:2], strict=True))
    return image[rows[:, None], columns]
