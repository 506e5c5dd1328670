"""
KTX2 images with a Basis Universal payload (ETC1S or UASTC), as KHR_texture_basisu has them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from ... import __version__ as VERSION
from ...errors import AssetError

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


@dataclass(frozen=True)
class Payload:
    """
    A texture as Basis Universal has encoded it, without a container.

    Parameters
    ----------
    is_uastc : bool
        UASTC blocks, else ETC1S.
    has_alpha : bool
    levels : list of (bytes, int)
        Of each mip level, the finest first, what is stored and its length before Zstandard (0: not compressed by it).
    codebooks : bytes
        What all levels of ETC1S share, KTX2's supercompression global data.
    """

    is_uastc: bool
    has_alpha: bool
    levels: list[tuple[bytes, int]]
    codebooks: bytes = b""


def encode_ktx2(payload: Payload, width: int, height: int, *, srgb: bool) -> bytes:
    """
    The container around a payload.

    Parameters
    ----------
    width, height : int
        Of the finest level.
    srgb : bool
        Colours, else linear data.
    """
    n = len(payload.levels)
    scheme = 1 if payload.codebooks else 2 if payload.levels[0][1] else 0
    descriptor = _descriptor(payload, srgb, plain=scheme == 0)
    entries = b"".join(_entry(*pair) for pair in (("KTXorientation", "rd"), ("KTXwriter", f"mi_simplify {VERSION}")))
    at_descriptor = 80 + 24 * n
    at_entries = at_descriptor + len(descriptor)
    at_books = at_entries + len(entries)
    at_books += -at_books % 8 if payload.codebooks else 0
    out = bytearray(at_books) + payload.codebooks
    index: list[tuple[int, int, int]] = []
    for content, length in reversed(payload.levels):  # the smallest first, as KTX2 wants it
        out += bytes(-len(out) % 16 if scheme == 0 else 0)
        index.insert(0, (len(out), len(content), length or (0 if scheme == 1 else len(content))))
        out += content
    books = (at_books, len(payload.codebooks)) if payload.codebooks else (0, 0)
    head = MAGIC + struct.pack("<9I", 0, 1, width, height, 0, 0, 1, n, scheme)
    head += struct.pack("<4I2Q", at_descriptor, len(descriptor), at_entries, len(entries), *books)
    head += b"".join(struct.pack("<3Q", *row) for row in index)
    out[:at_descriptor] = head
    out[at_descriptor : at_entries + len(entries)] = descriptor + entries
    return bytes(out)


def _descriptor(payload: Payload, srgb: bool, plain: bool) -> bytes:
    """KTX2's data format descriptor: which blocks, which channels, which transfer function."""
    channels = [15] if payload.has_alpha and not payload.is_uastc else []  # ETC1S has opacity in blocks of its own
    channels.insert(0, 3 if payload.is_uastc and payload.has_alpha else 0)
    bits = 128 if payload.is_uastc else 64
    samples = [struct.pack("<HBB4x2I", k * bits, bits - 1, kind, 0, 0xFFFFFFFF) for k, kind in enumerate(channels)]
    size = 24 + 16 * len(samples)
    planes = (16 if payload.is_uastc else 0) if plain else 0
    head = struct.pack("<IIHH4B4B8B", 4 + size, 0, 2, size, 166 if payload.is_uastc else 163, 1, 2 if srgb else 1, 0,
                       3, 3, 0, 0, planes, *[0] * 7)  # fmt: skip
    return head + b"".join(samples)


def _entry(key: str, value: str) -> bytes:
    """A key and its value as KTX2 stores them, padded to a multiple of four."""
    text = f"{key}\0{value}\0".encode()
    return struct.pack("<I", len(text)) + text + bytes(-len(text) % 4)
