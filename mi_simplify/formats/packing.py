"""
The textures of a model as a GLB file holds them: as few images as needed, each at a size and in a format of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..config.glb import GlbSettings
from ..errors import OutputError
from ..model.color import linear_to_srgb, srgb_to_linear
from ..model.mips import filtered_levels, halved
from ..model.model import Model
from .pixels.basisu import encode_basis
from .pixels.lossy import encode_jpeg, encode_webp, encode_webp_normals
from .pixels.png import SMALL, encode_png
from .textures import Textures, encode_textures, to_8bit

FLAT = (128, 128, 255)
"""Texel of a normal map without relief."""

#: The extension by which glTF names an image of a kind that it does not know of itself.
_EXTENSIONS = {"image/webp": "EXT_texture_webp", "image/ktx2": "KHR_texture_basisu"}

#: Images that hold no colours; all others are sRGB.
_DATA = ("normal", "orm")

#: Of images of these names: the setting of their largest side.
_SIZES = {"normal": "normal_size", "orm": "orm_size"}

Channels = slice | int
"""Those of an image that are stored; one alone becomes grey."""


@dataclass(frozen=True)
class Image:
    """
    An image file.

    Parameters
    ----------
    content : bytes
    mime : str
    size : tuple of int
        Width and height [texels].
    """

    content: bytes
    mime: str
    size: tuple[int, int]

    @property
    def extension(self) -> str | None:
        """What a glTF texture needs to name it."""
        return _EXTENSIONS.get(self.mime)


@dataclass(frozen=True)
class PackedTextures:
    """
    Images of what varies, and factors that stand for what does not or scale what does.

    Parameters
    ----------
    images : dict of str to Image
        Of ``base_color``, ``orm``, ``normal``, ``specular_color``, ``emission``: those that there are.
    base_color : tuple of float
        Linear RGB and opacity.
    roughness, metallic : float
    specular_color : tuple of float or None
        Linear; None: the model has none.
    emission : tuple of float or None
        Linear, times ``emission_strength``; None: the model has none.
    holds_ambient : bool
        Whether ``emission`` has the ambient term in it.
    has_occlusion : bool
        Whether the red channel of ``orm`` is occlusion.
    """

    images: dict[str, Image] = field(default_factory=dict)
    base_color: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    roughness: float = 1.0
    metallic: float = 1.0
    specular_color: tuple[float, ...] | None = None
    emission: tuple[float, ...] | None = None
    emission_strength: float = 1.0
    holds_ambient: bool = False
    has_occlusion: bool = False


class TexturePacker:
    """
    Encodes the textures of one model, in as many ways as are tried: what was made once is kept.

    Parameters
    ----------
    model : Model
    level : int
        Of PNG files, see :func:`.pixels.png.encode_png`.
    """

    def __init__(self, model: Model, level: int = SMALL):
        self._chain, self._level = _Chain(model), level
        self._found, self._factors = _constants(self._chain.finest)
        self._made: dict[tuple, Image] = {}

    def pack(self, settings: GlbSettings) -> PackedTextures:
        """
        See :func:`pack_textures`.
        """
        images = {name: self._image(name, channels, settings) for name, channels in self._found.items()}
        return replace(self._factors, images=images)

    def _image(self, name: str, channels: Channels, settings: GlbSettings) -> Image:
        key = (name, settings.textures, _limit(settings, name), _quality(settings, name))
        if key not in self._made:
            self._made[key] = _encoded(self._chain.levels(name, channels), settings, name, self._level)
        return self._made[key]


def pack_textures(model: Model, settings: GlbSettings = GlbSettings()) -> PackedTextures:
    """
    Encode the textures of a model.

    What is the same in all texels becomes a factor of the material: a colour, roughness, metalness, opacity; a normal
    map without relief is left out. Where one of roughness and metalness is 0 everywhere, the image of the other is
    grey, which is smaller in every format. Smaller sizes are mip levels as of :func:`..model.mips.filtered_levels`, or
    the model's own.

    Raises
    ------
    OutputError
        A size was asked for that is none of the atlas's mip levels; or the encoder of KTX2 is missing.
    """
    return TexturePacker(model).pack(settings)


def _limit(settings: GlbSettings, name: str) -> int | None:
    """Largest side of an image."""
    return getattr(settings, _SIZES.get(name, "color_size"))


def _quality(settings: GlbSettings, name: str) -> int:
    return settings.data_quality if name in _DATA else settings.quality


def _constants(textures: Textures) -> tuple[dict[str, Channels], PackedTextures]:
    """Which channels of which images vary, and the factors."""
    varying: dict[str, Channels] = {}
    color, opacity = _same(textures.base_color[..., :3]), _same(textures.base_color[..., 3])
    if opacity is None:
        varying["base_color"], color = slice(4), None
    elif color is None:
        varying["base_color"] = slice(3)
    factor = (1.0, 1.0, 1.0) if color is None else _linear(color)
    out = PackedTextures(
        base_color=(*factor, 1.0 if opacity is None else float(opacity[0]) / 255),
        emission_strength=textures.emission_strength,
        holds_ambient=textures.holds_ambient,
        has_occlusion=textures.has_occlusion and bool((textures.orm[..., 0] < 255).any()),
    )
    facts = {"roughness": _same(textures.orm[..., 1]), "metallic": _same(textures.orm[..., 2])}
    same = {name: float(x[0]) / 255 for name, x in facts.items() if x is not None and not out.has_occlusion}
    if len(same) < 2:  # of a grey image the other's texels are multiplied by the factor, which only 0 survives
        same = {name: value for name, value in same.items() if value == 0}
    if len(same) < 2:
        varying["orm"] = slice(3) if not same else 1 if "metallic" in same else 2
    if (textures.normal != FLAT).any():
        varying["normal"] = slice(3)
    out = replace(out, roughness=same.get("roughness", 1.0), metallic=same.get("metallic", 1.0))
    for name in ("specular_color", "emission"):
        image = getattr(textures, name)
        if image is not None:
            value = _same(image)
            changed: dict[str, Any] = {name: (1.0, 1.0, 1.0) if value is None else _linear(value)}
            out = replace(out, **changed)
            if value is None:
                varying[name] = slice(3)
    return varying, out


def _same(image: np.ndarray) -> np.ndarray | None:
    """The one value of all texels, shape (C,); None where they differ."""
    texels = image.reshape(-1, image.shape[2] if image.ndim == 3 else 1)
    return texels[0] if (texels == texels[0]).all() else None


def _linear(texel: np.ndarray) -> tuple[float, ...]:
    return tuple(round(float(x), 6) for x in srgb_to_linear(texel / 255.0))


class _Chain:
    """A model's textures level by level, each made when it is asked for."""

    def __init__(self, model: Model):
        self.model, self.finest = model, encode_textures(model)

    @cached_property
    def _coarser(self) -> list[Textures]:
        model, sides = self.model, self.model.base_color.shape[:2]
        if any(side & (side - 1) for side in sides):
            return []
        levels: Sequence[dict[str, Any]] = model.mips or filtered_levels(model.base_color, model.specular, model.normal)
        model = replace(model, ambient=None, emission=None, mips=())
        out = []
        for images in levels:
            if model.occlusion is not None:
                model = replace(model, occlusion=halved(model.occlusion))
            out.append(encode_textures(replace(model, **images)))
        return out

    def levels(self, name: str, channels: Channels) -> Iterator[np.ndarray]:
        """One image from its finest level on, shape (H, W) or (H, W, C), uint8."""
        image = getattr(self.finest, name)
        yield image[..., channels]
        if name in ("base_color", *_DATA):
            yield from (getattr(textures, name)[..., channels] for textures in self._coarser)
        elif not any(side & (side - 1) for side in image.shape[:2]):  # colours without opacity: plain means
            linear = srgb_to_linear(image / 255.0)
            while max(linear.shape[:2]) > 1:
                linear = halved(linear)
                yield to_8bit(linear_to_srgb(linear))


def _encoded(chain: Iterator[np.ndarray], settings: GlbSettings, name: str, level: int) -> Image:
    """The image at its size, in its format, with its further levels where the format holds any."""
    limit = _limit(settings, name)
    image = next(chain)
    while limit is not None and max(image.shape[:2]) > limit:
        smaller = next(chain, None)
        if smaller is None:
            height, width = image.shape[:2]
            raise OutputError(
                f"textures of {width} x {height} texels have no mip levels, so they cannot be reduced to {limit}: "
                "choose an initial.atlas_size that is a power of two"
            )
        image = smaller
    height, width = image.shape[:2]
    data = name in _DATA
    quality = _quality(settings, name)
    if settings.textures == "ktx2":
        mips = [np.repeat(x[..., None], 3, axis=2) if x.ndim == 2 else x for x in (image, *chain)]
        content, mime = encode_basis(mips, quality, data=data), "image/ktx2"
    elif settings.textures == "webp":
        encode = encode_webp_normals if name == "normal" else encode_webp
        content, mime = encode(image, quality), "image/webp"
    elif settings.textures == "jpeg" and (image.ndim == 2 or image.shape[2] == 3):
        content, mime = encode_jpeg(image, quality, data=data), "image/jpeg"
    else:
        content, mime = encode_png(image, level), "image/png"
    return Image(content, mime, (width, height))
