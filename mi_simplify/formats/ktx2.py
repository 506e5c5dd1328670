"""
KTX2 images with a Basis Universal payload (ETC1S or UASTC), as KHR_texture_basisu has them.
"""

from __future__ import annotations

import struct

import numpy as np

from ..errors import AssetError

MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"

_CONVERTERS = "convert the textures to PNG, for instance with 'gltf-transform ktxdecompress' or 'ktx extract'"


def ktx2_size(data: bytes) -> tuple[int, int]:
    """
    Width and height that the header declares.
    """
    width, height = struct.unpack_from("<2I", data, 20)
    return width, height


def decode_ktx2(data: bytes, name: str, model: str) -> np.ndarray:
    """
    The finest level, shape (H, W, 3 or 4), uint8, values as stored.

    Raises
    ------
    AssetError
        The package opengl-basisu is not installed, or the file holds something else than Basis Universal.
    """
    try:
        import opengl_basisu
    except ImportError:
        raise AssetError(
            f"{model}: texture '{name}' is KTX2; pip install 'mi-simplify[ktx2]' reads it, or {_CONVERTERS}"
        ) from None
    try:
        texture = opengl_basisu.open(data)
        pixels = np.asarray(texture.transcode(opengl_basisu.Target.RGBA8).data)
        has_alpha = texture.has_alpha
    except (opengl_basisu.BasisuError, ValueError) as error:
        raise AssetError(f"{model}: KTX2 texture '{name}' cannot be read ({error}); {_CONVERTERS}") from error
    return pixels if has_alpha else pixels[..., :3]
