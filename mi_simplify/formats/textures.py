"""
Linear float textures to the 8-bit images that files carry.

Base colour is sRGB; occlusion-roughness-metal, normals and opacity are linear. Where the model has
gamma (it scales the specular lobe, ``ks' = (1 - gamma) ks``), a dielectric texel carries it as
KHR_materials_specular's specular colour, a metallic one in its base colour, one between in both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.color import linear_to_srgb
from ..model.light.emission import emission_of
from ..model.model import Model
from .pixels.png import SOON, encode_png

HOLDS_AMBIENT = "emission_holds_ambient"
"""Key by which files of ours say so."""

VISIBLE_GAMMA = 1.0 / 255.0
"""Gamma up to here is 8-bit noise and written as 0."""


@dataclass(frozen=True)
class Textures:
    """
    What one material's files hold.

    Parameters
    ----------
    base_color : ndarray, shape (H, W, 4), uint8
        sRGB and linear opacity, not premultiplied; opacity is 255 in an OPAQUE model.
    orm : ndarray, shape (H, W, 3), uint8
        Red occlusion (255: all light arrives), green roughness, blue metal; gamma is never here, where glTF would read
        it as darkness.
    normal : ndarray, shape (H, W, 3), uint8
        Tangent space, +Y up the image.
    specular_color : ndarray, shape (H, W, 3), uint8, or None
        sRGB, white on metal; None where no dielectric texel has gamma.
    emission : ndarray, shape (H, W, 3), uint8, or None
        sRGB, the model's own light and its ambient term, divided by ``emission_strength``; None where it has neither.
    holds_ambient : bool
        Whether ``emission`` has the ambient term in it.
    has_occlusion : bool
    """

    base_color: np.ndarray
    orm: np.ndarray
    normal: np.ndarray
    specular_color: np.ndarray | None
    emission: np.ndarray | None = None
    emission_strength: float = 1.0
    holds_ambient: bool = False
    has_occlusion: bool = False


def encode_textures(model: Model) -> Textures:
    """
    Quantise a model's textures by rounding to the nearest step, without dither.

    Parameters
    ----------
    model : Model

    Returns
    -------
    Textures

    Raises
    ------
    ValueError
        A texture holds NaN or infinity, or has not the shape that the model promises.
    """
    base = _checked("base_color", model.base_color, 4)
    specular = _checked("specular", model.specular, 3)
    normal = _checked("normal", model.normal, 3)
    opacity = np.ones_like(base[..., 3]) if model.alpha_mode == "OPAQUE" else base[..., 3]
    rgb, metallic, specular_color = fold_gamma(base[..., :3], specular)
    occlusion = np.ones_like(metallic)
    if model.occlusion is not None:
        occlusion = _nearest(_checked("occlusion", model.occlusion, 1), metallic.shape)[..., 0]
    orm = np.stack([occlusion, specular[..., 1], metallic], axis=2)
    emission, strength, radiance = None, 1.0, None
    if model.emission is not None:
        radiance = _nearest(_checked("emission", model.emission, 3), base.shape[:2])
    holds_ambient = model.ambient is not None and len(model.ambient) == 1
    if model.ambient is not None and holds_ambient:
        term = emission_of(model.ambient, base, _nearest(specular[..., 2], base.shape[:2]))
        radiance = term if radiance is None else radiance + term
    if radiance is not None:
        strength = max(float(radiance.max()), 1e-6)
        emission = to_8bit(linear_to_srgb(radiance / strength))
    return Textures(
        base_color=to_8bit(np.concatenate([linear_to_srgb(rgb), opacity[..., None]], axis=2)),
        orm=to_8bit(orm),
        normal=encode_normal(normal),
        specular_color=None if specular_color is None else to_8bit(linear_to_srgb(specular_color)),
        emission=emission,
        emission_strength=strength,
        holds_ambient=holds_ambient,
        has_occlusion=model.occlusion is not None,
    )


def fold_gamma(rgb: np.ndarray, specular: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """
    The glTF material that reflects as one with gamma does.

    With base colour kd and metalness m, diffuse reflectance is ``kd (1-m)``, and F0 is ``(1-γ) kd m`` of the metal and
    ``0.04 (1-γ) (1-m)`` of the dielectric share. glTF has these three values with

        kd' = (1-γm) kd        m' = m (1-γ) / (1-γm)        specular colour = (1-γ) (1-γm)

    and as Schlick's formula is linear in F0, the same specular lobe from every direction. What differs, by 0.04 γ at
    most, is how much light the dielectric lets through to the diffuse part.

    Parameters
    ----------
    rgb : ndarray, shape (H, W, 3)
        Linear base colour.
    specular : ndarray, shape (h, w, 3)
        (gamma, roughness, metallic); the nearest texel counts where the sizes differ.

    Returns
    -------
    rgb : ndarray, shape (H, W, 3)
    metallic : ndarray, shape (h, w)
    specular_color : ndarray, shape (h, w, 3), or None
        Linear, 1 on metal; None where it is 1 everywhere.
    """
    gamma = np.where(specular[..., 0] > VISIBLE_GAMMA, np.clip(specular[..., 0], 0.0, 1.0), 0.0)
    metallic = np.clip(specular[..., 2], 0.0, 1.0)
    if not gamma.any():
        return rgb, metallic, None
    kept = 1.0 - gamma * metallic
    rgb = rgb * _nearest(kept, rgb.shape[:2])[..., None]
    is_metal = metallic >= 1.0 - 0.5 / 255.0  # without a dielectric share
    color = np.where(is_metal, 1.0, (1.0 - gamma) * kept)
    metallic = np.where(is_metal, metallic, metallic * (1.0 - gamma) / np.maximum(kept, 1e-6))
    return rgb, metallic, None if (color == 1.0).all() else np.repeat(color[..., None], 3, axis=2)


def encode_normal(normal: np.ndarray) -> np.ndarray:
    """
    Unit vectors to 8-bit RGB, shape (H, W, 3): renormalised, kept above the surface as glTF asks.
    """
    n = np.array(normal, np.float32)
    n[..., 2] = np.maximum(n[..., 2], 0.0)
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    n = np.where(length > 1e-6, n / np.maximum(length, 1e-6), np.array([0, 0, 1], np.float32))
    return to_8bit(n * 0.5 + 0.5)


def to_8bit(x: np.ndarray) -> np.ndarray:
    """
    Values in [0, 1] to the nearest of 256 steps (halves up).
    """
    return np.floor(np.clip(x, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def png(image: np.ndarray) -> bytes:
    """
    An 8-bit image of 1 (H, W), 2, 3 or 4 channels as the bytes of a PNG file, soon rather than small.
    """
    return encode_png(image, SOON)


def _checked(name: str, texture: np.ndarray, channels: int) -> np.ndarray:
    """The texture as float32, or an error that names it."""
    texture = np.asarray(texture, np.float32)
    if texture.ndim != 3 or texture.shape[2] != channels or not texture.size:
        raise ValueError(f"{name}: expected an image of shape (H, W, {channels}), got {texture.shape}")
    if not np.isfinite(texture).all():
        raise ValueError(f"{name}: {np.count_nonzero(~np.isfinite(texture))} values are not finite")
    return texture


def _nearest(image: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """An image (h, w) at another size, each texel centre taking the nearest one."""
    rows = ((np.arange(shape[0]) + 0.5) * image.shape[0] / shape[0]).astype(int)
    columns = ((np.arange(shape[1]) + 0.5) * image.shape[1] / shape[1]).astype(int)
    return image[rows[:, None], columns]
