"""Images: what the decoder makes of each kind, and how textures are put together from them."""

import io
import struct
import zlib

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from support.tiny_models import png

from mi_simplify.errors import AssetError
from mi_simplify.formats.images import (
    decode_image,
    is_normal_map,
    join_channels,
    to_float,
    unit_normals,
)
from mi_simplify.model.color import srgb_to_linear


def encode(image: Image.Image, kind: str, **options) -> bytes:
    out = io.BytesIO()
    image.save(out, kind, **options)
    return out.getvalue()


def test_srgb_known_values():
    np.testing.assert_allclose(srgb_to_linear([0, 0.04045, 0.5, 1]), [0, 0.0031308, 0.2140411, 1], atol=1e-6)


def test_opacity_stays_linear():
    pixels = np.full((1, 1, 4), 128, np.uint8)
    values = to_float(pixels, srgb=True)[0, 0]
    np.testing.assert_allclose(values, [0.2158605] * 3 + [128 / 255], atol=1e-6)


def test_sixteen_bits_are_kept():
    values = np.array([[0, 1, 258, 65535]], np.uint16)
    grey = decode_image(encode(Image.fromarray(values), "PNG"), "grey.png", "model")
    assert grey.dtype == np.uint16
    np.testing.assert_array_equal(grey[..., 0], values)
    rgb = np.stack([values, values[:, ::-1], values // 2], axis=2)
    stream = mi.MemoryStream()
    mi.Bitmap(rgb).write(stream, mi.Bitmap.FileFormat.PNG)
    decoded = decode_image(stream.raw_buffer(), "rgb.png", "model")
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, rgb)


def test_float_images_are_linear_as_they_are():
    values = np.float32([[[0.5, 2.0, 7.0]]])
    stream = mi.MemoryStream()
    mi.Bitmap(values).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    decoded = decode_image(stream.raw_buffer(), "a.exr", "model")
    assert decoded.dtype == np.float32
    np.testing.assert_allclose(decoded, values, rtol=1e-3)


def test_palettes_and_key_colours_are_expanded():
    image = Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 200, 100, 50])
    image.putpixel((1, 0), 1)
    np.testing.assert_array_equal(
        decode_image(encode(image, "PNG"), "p.png", "model")[0], [[10, 20, 30], [200, 100, 50]]
    )
    keyed = decode_image(encode(image, "PNG", transparency=0), "p.png", "model")
    np.testing.assert_array_equal(keyed[0], [[10, 20, 30, 0], [200, 100, 50, 255]])


def test_bomb_is_refused_before_it_is_decoded():
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    for depth in (8, 16):
        header = struct.pack(">2I5B", 20000, 20000, depth, 2, 0, 0, 0)
        data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
        with pytest.raises(AssetError, match="model.obj: texture 'bomb.png' is larger than 16384 x 16384"):
            decode_image(data, "bomb.png", "model.obj")


@pytest.mark.parametrize("cut", [3, 40, -300])
def test_cut_off_image_is_named(cut):
    data = png(np.random.default_rng(0).integers(0, 255, (32, 32, 3), dtype=np.uint8))[:cut]
    with pytest.raises(AssetError, match="model.obj: texture 'broken.png' cannot be read"):
        decode_image(data, "broken.png", "model.obj")


def test_joined_channels_agree_at_any_size():
    # A ramp enlarged about texel centres stays the ramp, away from the repeating border.
    ramp = (np.arange(8, dtype=np.float32) + 0.5).reshape(1, 8, 1) / 8
    joined = join_channels(ramp, np.zeros((2, 32, 1), np.float32))
    assert joined.shape == (2, 32, 2)
    expected = (np.arange(32) + 0.5) / 32
    np.testing.assert_allclose(joined[1, 2:-2, 0], expected[2:-2], atol=1e-6)


def test_normal_maps_are_told_from_heights():
    rng = np.random.default_rng(1)
    n = unit_normals(np.float32(rng.normal(0, 0.3, (16, 16, 3)) * [1, 1, 0] + [0, 0, 1]))
    np.testing.assert_allclose(np.linalg.norm(n, axis=2), 1, atol=1e-6)
    assert is_normal_map(np.uint8(np.round((n * 0.5 + 0.5) * 255)))
    heights = np.repeat(rng.integers(0, 255, (16, 16, 1), dtype=np.uint8), 3, axis=2)
    assert not is_normal_map(heights)
    assert not is_normal_map(heights[..., :1])
