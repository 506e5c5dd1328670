"""
PNG files of few bytes: the row filter that suits the image, and libdeflate, which looks further than zlib in less time.
"""

from __future__ import annotations

import struct
import zlib

import deflate
import numpy as np

#: PNG's colour types by the number of channels.
_COLOR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}

#: Of the five filters of PNG, numbered 0 to 4, the one for the row above; beside them, whichever suits each row.
_UP, _ADAPTIVE = 2, 5

#: Rows of each of the parts that the choice is made by.
_BAND = 24


SMALL, SOON = 10, 6
"""Levels of Deflate for what is sent and kept, and for what is looked at here and now."""


def encode_png(image: np.ndarray, level: int = SMALL) -> bytes:
    """
    An 8-bit image of 1 to 4 channels, shape (H, W) or (H, W, C), as the bytes of a PNG file.

    Each of PNG's five row filters is tried for the whole image, and the one with the smallest differences for each row;
    a Deflate of some rows says which is best.

    Parameters
    ----------
    level : int
        Of Deflate. ``SMALL`` takes about half a second a megapixel, ``SOON`` a tenth of it, and the differences to the
        row above without a trial.
    """
    pixels = np.ascontiguousarray(image if image.ndim == 3 else image[..., None])
    height, width, channels = pixels.shape
    rows = pixels.reshape(height, -1)
    kind = _UP if level == SOON else _best_filter(rows, channels)
    content = bytes(deflate.zlib_compress(_filtered(rows, channels, kind), level))
    header = struct.pack(">2I5B", width, height, 8, _COLOR_TYPES[channels], 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", content), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _best_filter(rows: np.ndarray, channels: int) -> int:
    """The filter after which some bands of the image take the fewest bytes."""
    bands = np.linspace(0, max(len(rows) - _BAND, 0), 4).astype(int)
    sample = [rows[start : start + _BAND] for start in np.unique(bands)]

    def size(kind: int) -> int:
        return sum(len(deflate.zlib_compress(_filtered(band, channels, kind), SOON)) for band in sample)

    return min(range(6), key=size)


def _filtered(rows: np.ndarray, channels: int, kind: int) -> bytes:
    """Rows by one of the filters None, Sub, Up, Average and Paeth, or by whichever suits each, with their numbers."""
    height = len(rows)
    a, b, c = (np.zeros_like(rows, np.int16) for _ in range(3))  # left, above, above left
    a[:, channels:] = rows[:, :-channels]
    b[1:] = rows[:-1]
    c[1:, channels:] = rows[:-1, :-channels]

    def paeth() -> np.ndarray:
        pa, pb, pc = np.abs(b - c), np.abs(a - c), np.abs(a + b - 2 * c)
        return np.where((pa <= pb) & (pa <= pc), a, np.where(pb <= pc, b, c))

    guesses = (lambda: np.zeros_like(a), lambda: a, lambda: b, lambda: (a + b) // 2, paeth)
    chosen = range(5) if kind == _ADAPTIVE else [kind]
    lines = np.stack([(rows - guesses[k]()).astype(np.uint8) for k in chosen])
    # The sum of absolute differences, the bytes being signed (the heuristic of the PNG specification, 12.8).
    cost = np.abs(lines.view(np.int8).astype(np.int16)).sum(axis=2, dtype=np.int64)
    number = cost.argmin(axis=0)
    numbered = np.asarray(chosen, np.uint8)[number][:, None]
    return np.concatenate([numbered, lines[number, np.arange(height)]], axis=1).tobytes()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
