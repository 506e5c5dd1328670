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


def _pillow(image: np.ndarray) -> Image.Image:
    return Image.fromarray(np.ascontiguousarray(image))
