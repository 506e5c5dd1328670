"""
JPEG and WebP files.
"""

from __future__ import annotations

import io

import numpy as np
from PIL import Image


def encode_jpeg(image: np.ndarray, quality: int, *, data: bool) -> bytes:
    """
    An 8-bit image of 1 or 3 channels, shape (H, W) or (H, W, 3), as a progressive JPEG file.

    Parameters
    ----------
    quality : int
        1 to 100; nothing is lossless here.
    data : bool
        The channels are no colours: each keeps its full resolution.
    """
    stream = io.BytesIO()
    _pillow(image).save(
        stream, "JPEG", quality=min(quality, 98), subsampling=0 if data else 2, optimize=True, progressive=True
    )
    return stream.getvalue()


def encode_webp(image: np.ndarray, quality: int) -> bytes:
    """
    An 8-bit image of 1, 3 or 4 channels as a WebP file; opacity is always lossless.

    Parameters
    ----------
    quality : int
        1 to 99; 100 is lossless.
    """
    stream = io.BytesIO()
    picture = _pillow(image)
    if quality == 100:
        picture.save(stream, "WEBP", lossless=True, quality=75, method=4, exact=True)
    else:
        picture.save(stream, "WEBP", quality=quality, method=5)
    return stream.getvalue()


LEAST_ROUNDED = 80
"""Quality from which a normal map is rounded instead of transformed."""


def encode_webp_normals(image: np.ndarray, quality: int) -> bytes:
    """
    A normal map, shape (H, W, 3), uint8, as a WebP file.

    Lossy WebP halves the resolution of what tells the channels apart, which for normals is their direction: 4 degrees
    on a finely carved surface, whatever the quality. From :data:`LEAST_ROUNDED` on components are rounded to multiples
    of a step about the flat normal, and stored losslessly: 1 degree in the same bytes.

    Parameters
    ----------
    quality : int
        As of :func:`encode_webp`.
    """
    if not LEAST_ROUNDED <= quality < 100:
        return encode_webp(image, quality)
    step, flat = 1 + 0.6 * (100 - quality), np.array([128, 128, 255])
    rounded = np.clip(np.rint(flat + np.rint((image - flat) / step) * step), 0, 255)
    return encode_webp(rounded.astype(np.uint8), 100)


def _pillow(image: np.ndarray) -> Image.Image:
    return Image.fromarray(np.ascontiguousarray(image))
