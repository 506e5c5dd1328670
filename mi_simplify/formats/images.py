"""
Images from bytes to linear float32 arrays, and the few operations that turn them into textures.
"""

from __future__ import annotations

import contextlib
import io
import re
import struct
import warnings
from collections.abc import Iterator

import numpy as np
from PIL import Image

from ..errors import AssetError, UserError
from ..machine import memory
from ..model.color import srgb_to_linear
from .pixels import ktx2

#: Images with more pixels than this are refused before they are decoded.
MAX_PIXELS = 16384**2

#: What Pillow may take a file for. It knows more, among them some that it hands to other programs (EPS to Ghostscript).
_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "TGA", "BMP", "GIF", "DDS", "PPM", "PSD", "JPEG2000", "AVIF")

#: Bytes that a pixel takes as it is decoded and made linear: 4 x 8 bits as read, 4 x 32 bits with a copy.
_BYTES_PER_PIXEL = 36

#: Deflate makes nothing smaller than this share of it.
_DEEPEST = 1032


def decode_image(data: bytes, name: str, model: str) -> np.ndarray:
    """
    Decode PNG, JPEG, WebP, AVIF, TIFF, TGA, BMP, EXR, HDR or KTX2 bytes without touching the values.

    Parameters
    ----------
    data : bytes
        The file's content.
    name, model : str
        What the messages call the texture and the model that asks for it.

    Returns
    -------
    ndarray, shape (H, W, C), uint8, uint16 or float32
        C is 1 (grey), 2 (grey, opacity), 3 (RGB) or 4 (RGB, opacity); palettes are expanded.

    Raises
    ------
    AssetError
        The data is no image, is cut off, or declares more than ``MAX_PIXELS`` pixels.
    MemoryLimitError
        It declares more than memory holds.
    """
    check_image(data, name, model)
    with _as_asset_errors(name, model):
        if data.startswith(ktx2.MAGIC):
            return ktx2.decode_ktx2(data, name, model)
        if _is_for_mitsuba(data):
            return _decode_with_mitsuba(data)
        with _opened(data) as image:
            return _pixels_of(image)


def check_image(data: bytes, name: str, model: str) -> tuple[int, int]:
    """
    Width and height that an image declares in its header, checked; parameters and errors as of :func:`decode_image`.
    """
    with _as_asset_errors(name, model):
        if data.startswith(ktx2.MAGIC):
            size, least = ktx2.ktx2_size(data), 1
        elif _is_for_mitsuba(data):
            size, least = _header_size(data), 32
        else:
            with _opened(data) as image:
                size, least = image.size, 1
        _check_size(size, least, data, name, model)
    return size


@contextlib.contextmanager
def _as_asset_errors(name: str, model: str) -> Iterator[None]:
    """One line for what decoders raise, which is whatever they like, Pillow's asserts included."""
    try:
        yield
    except (UserError, MemoryError):
        raise
    except Exception as error:
        reason = "it is no image that can be decoded" if isinstance(error, Image.UnidentifiedImageError) else error
        line = (str(reason).splitlines() or [type(error).__name__])[0]
        raise AssetError(f"{model}: texture '{name}' cannot be read: {line[:200]}") from error


@contextlib.contextmanager
def _opened(data: bytes) -> Iterator[Image.Image]:
    """An image of Pillow, whose own limit of pixels warns and ours stands in for."""
    Image.init()  # builds of Pillow differ in what they know
    before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with warnings.catch_warnings(action="ignore"):
            yield Image.open(io.BytesIO(data), formats=[name for name in _FORMATS if name in Image.OPEN])
    finally:
        Image.MAX_IMAGE_PIXELS = before


def _is_for_mitsuba(data: bytes) -> bool:
    """OpenEXR, Radiance, and what Pillow would cut to 8 bits."""
    return data[:4] == b"\x76\x2f\x31\x01" or data[:2] == b"#?" or _is_deep_color_png(data)


def _header_size(data: bytes) -> tuple[int, int]:
    """Width and height of the formats that do not go through Pillow."""
    if data[:4] == b"\x76\x2f\x31\x01":
        at = data.index(b"dataWindow\0box2i\0") + 21
        x0, y0, x1, y1 = struct.unpack_from("<4i", data, at)
        return x1 - x0 + 1, y1 - y0 + 1
    if data[:2] == b"#?":
        _, _, body = data.partition(b"\n\n")
        # Mitsuba would look for such a line for ever.
        found = re.match(rb"-Y (\d{1,9}) \+X (\d{1,9})\n", body)
        return (int(found[2]), int(found[1])) if found else (0, 0)
    return struct.unpack_from(">2I", data, 16)


def _check_size(size: tuple[int, int], least: int, data: bytes, name: str, model: str) -> None:
    """
    Refuse what its header declares, before anything of that size is allocated.

    Parameters
    ----------
    least : int
        Bits that a pixel of a PNG has at the least.
    """
    width, height = size
    if min(size) <= 0:
        raise ValueError("its header has no size")
    if width * height > MAX_PIXELS:
        raise AssetError(f"{model}: texture '{name}' is larger than 16384 x 16384 pixels; scale it down")
    if data[:4] == b"\x89PNG" and height * (1 + width * least // 8) > _DEEPEST * len(data):
        raise ValueError(f"it is cut off: {len(data)} bytes cannot hold {width} x {height} pixels")
    require_pixels(height, width, f"{model}: texture '{name}'")


def require_pixels(height: int, width: int, what: str, others: int = 0) -> int:
    """
    Bytes that an image takes as it is decoded and made linear, with ``others``; raises where they are not left.
    """
    needed = _BYTES_PER_PIXEL * width * height + others
    memory.require(needed, f"{what} of {width} x {height} pixels", "scale it down")
    return needed


def _is_deep_color_png(data: bytes) -> bool:
    """A PNG of 16 bits a channel and more than one channel, which Pillow would cut to 8 bits."""
    return data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) > 25 and data[24] == 16 and data[25] in (2, 4, 6)


def _decode_with_mitsuba(data: bytes) -> np.ndarray:
    from ..machine import runtime  # only a few files need it, and it sets a variant

    runtime.ensure_variant()
    import mitsuba as mi

    stream = mi.MemoryStream()
    stream.write(data)
    stream.seek(0)
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)  # libpng's warnings would be printed
    try:
        pixels = np.array(mi.Bitmap(stream))
    finally:
        mi.set_log_level(level)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    return _bounded(pixels[..., :4]) if pixels.dtype not in (np.uint8, np.uint16) else pixels[..., :4]


def _bounded(pixels: np.ndarray) -> np.ndarray:
    """Finite float32 values, as half precision could hold them; colours that a material multiplies and squares."""
    return np.clip(np.nan_to_num(pixels), -65504, 65504).astype(np.float32)


def _pixels_of(image: Image.Image) -> np.ndarray:
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)[..., None]
    if image.mode == "I":
        return np.clip(np.asarray(image), 0, 65535).astype(np.uint16)[..., None]
    if image.mode == "F":
        return _bounded(np.asarray(image)[..., None])
    if image.mode in ("P", "PA") or "transparency" in image.info:
        image = image.convert("RGBA" if image.mode == "PA" or "transparency" in image.info else "RGB")
    elif image.mode not in ("L", "LA", "RGB", "RGBA"):
        image = image.convert({"1": "L", "La": "LA", "RGBa": "RGBA"}.get(image.mode, "RGB"))
    pixels = np.asarray(image)
    return pixels[..., None] if pixels.ndim == 2 else pixels


def to_float(pixels: np.ndarray, *, srgb: bool) -> np.ndarray:
    """
    Decoded pixels as float32; with ``srgb`` the colour channels become linear, opacity always is.

    Parameters
    ----------
    pixels : ndarray, shape (H, W, C), uint8, uint16 or float32

    Returns
    -------
    ndarray, shape (H, W, C), float32
        In [0, 1] for integer pixels.
    """
    if pixels.dtype == np.uint8:
        table = np.arange(256, dtype=np.float32) / 255
    elif pixels.dtype == np.uint16:
        table = np.arange(65536, dtype=np.float32) / 65535
    else:
        table = None
    out = table[pixels] if table is not None else pixels.astype(np.float32)
    if srgb:
        n_colors = pixels.shape[2] - (pixels.shape[2] in (2, 4))
        colors = pixels[..., :n_colors]
        out[..., :n_colors] = srgb_to_linear(table)[colors] if table is not None else srgb_to_linear(colors)
    return out


def rgb(pixels: np.ndarray) -> np.ndarray:
    """
    The colour channels of an image of 1 to 4 channels, shape (H, W, 3).
    """
    return np.repeat(pixels[..., :1], 3, axis=2) if pixels.shape[2] < 3 else pixels[..., :3]


def opacity(pixels: np.ndarray) -> np.ndarray | None:
    """
    The opacity channel, shape (H, W, 1), or None where the image has none.
    """
    return pixels[..., -1:] if pixels.shape[2] in (2, 4) else None


def constant(*values: float) -> np.ndarray:
    """
    A texture of one texel, shape (1, 1, C), float32.
    """
    return np.array(values, np.float32).reshape(1, 1, -1)


def join_channels(*images: np.ndarray) -> np.ndarray:
    """
    Stack images of any sizes along the channels, smaller ones enlarged to the largest height and width.
    """
    size = max(i.shape[0] for i in images), max(i.shape[1] for i in images)
    return np.concatenate([_enlarge(i, size) for i in images], axis=2)


def _enlarge(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Bilinear, texel centres at half coordinates, repeating borders."""
    for axis, n in enumerate(size):
        m = image.shape[axis]
        if n == m:
            continue
        if m == 1:
            image = np.repeat(image, n, axis=axis)
            continue
        at = (np.arange(n) + 0.5) * (m / n) - 0.5
        low = np.floor(at).astype(np.int64)
        weight = (at - low).astype(np.float32).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        a, b = image.take(low % m, axis), image.take((low + 1) % m, axis)
        image = a + (b - a) * weight
    return image


def unit_normals(vectors: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """
    Tangent-space unit vectors from decoded vectors in [-1, 1], x and y scaled first.

    Parameters
    ----------
    vectors : ndarray, shape (H, W, 3), float32
    scale : float
        glTF's ``normalTexture.scale``.
    """
    vectors = vectors * np.array([scale, scale, 1], np.float32)
    length = np.linalg.norm(vectors, axis=2, keepdims=True)
    return np.where(length > 1e-6, vectors / np.maximum(length, 1e-6), [0.0, 0.0, 1.0]).astype(np.float32)


def is_normal_map(pixels: np.ndarray) -> bool:
    """
    Whether a decoded image holds tangent-space unit vectors rather than, say, heights.
    """
    if pixels.shape[2] < 3:
        return False
    vectors = to_float(pixels, srgb=False)[..., :3] * 2 - 1
    good = (np.abs(np.linalg.norm(vectors, axis=2) - 1) < 0.15) & (vectors[..., 2] > -0.1)
    return bool(good.mean() > 0.9)
