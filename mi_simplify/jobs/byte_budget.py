"""
A file of at most so many bytes: what is given up is what pictures of the model miss least.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config import Config
from ..config.glb import GlbSettings
from ..errors import OutputError
from ..export.own_normals import with_own_normals
from ..formats.gltf.write import glb_bytes
from ..formats.packing import PackedTextures, TexturePacker
from ..judging.texture_loss import TextureLoss
from ..model.model import Model

_QUALITIES = (100, 95, 90, 80, 65, 45, 25, 10)
"""Steps of quality; 100 is lossless in WebP, and from 95 on KTX2 is UASTC."""

_LEAST_SIZE = 16
"""Side down to which a texture is halved."""

_MARGIN = 256
"""What a file may say of itself beside what is known here, and the padding of its parts."""

_SIZES = {"color_size": ("base_color", "specular_color", "emission"), "normal_size": ("normal",), "orm_size": ("orm",)}


@dataclass(frozen=True)
class Packing:
    """
    Settings of a GLB file that were found for a budget.

    Parameters
    ----------
    settings : GlbSettings
    n_bytes : int
        Of the file.
    psnr : float
        Of pictures with its textures beside those with the model's own [dB].
    """

    settings: GlbSettings
    n_bytes: int
    psnr: float

    @property
    def note(self) -> str:
        """What was chosen, for a person."""
        s = self.settings
        sizes = [
            f"{name.split('_')[0]} {value}²"
            for name, value in ((name, getattr(s, name)) for name in _SIZES)
            if value is not None
        ]
        how = s.textures if s.textures == "png" else f"{s.textures} of quality {s.quality}, data {s.data_quality}"
        limit = f"{(s.max_bytes or 0) / 1000:g} kB"
        tangents = "" if s.tangents else ", no tangents"
        return (
            f"{self.n_bytes / 1000:.1f} kB for --max-bytes {limit}: geometry {s.compress}"
            f"{tangents}, textures {how}{''.join(f', {x}' for x in sizes)}; pictures keep {self.psnr:.1f} dB of "
            "the fitted textures"
        )


def within_bytes(
    model: Model, settings: GlbSettings, *, extras: dict[str, Any] | None = None, form: str = "gltf"
) -> Packing:
    """
    Settings with which a GLB file of a model has at most ``settings.max_bytes``.

    Where the file as it is asked for is too large, images become WebP and geometry is compressed, unless something else
    was stated. Then one quality or the size of one kind of image is lowered at a time, each time what costs least
    squared error of rendered pictures for a byte. Where nothing of that is enough, all is lowered and tangents go.

    Parameters
    ----------
    model : Model
        In the units of the file.
    settings : GlbSettings
        What somebody has stated (``model_fields_set``) is kept; ``max_bytes`` is not None.
    extras : dict, optional
        As of ``write_glb``.
    form : {'gltf', 'paper'}
        Mixing of the lobes.

    Raises
    ------
    OutputError
        Not even the least file is so small.
    """
    search = _Search(with_own_normals(model), settings, extras)
    if search.n_bytes(settings) <= search.most:
        return Packing(settings, search.n_bytes(settings), 100.0)
    search.require_room()
    loss = TextureLoss(search.model, form=form)
    now, error = search.start, loss(search.textures(search.start))
    while search.n_bytes(now) > search.most:
        best: tuple[float, GlbSettings, float] | None = None
        for lower in search.lower(now):
            found = loss(search.textures(lower))
            cost = max(found - error, 0.0) / (search.n_bytes(now) - search.n_bytes(lower))
            if best is None or cost < best[0]:
                best = cost, lower, found
        if best is None:
            now = search.least()
            error = loss(search.textures(now))
            break
        _, now, error = best
    return Packing(now, search.n_bytes(now), float(-10 * np.log10(max(error, 1e-10))))


def require_room(model: Model, settings: GlbSettings, extras: dict[str, Any] | None = None) -> None:
    """
    Raise :class:`OutputError` where not even the least file of a model, such as a first guess, has at most
    ``settings.max_bytes``: before anything takes time.
    """
    search = _Search(with_own_normals(model), settings, extras)
    if search.n_bytes(settings) > search.most:
        search.require_room()


def with_packing(config: Config, settings: GlbSettings) -> Config:
    """
    The configuration with other settings of the GLB file.
    """
    return config.model_copy(update={"export": config.export.model_copy(update={"glb": settings})})


class _Search:
    """Files of one model, by their settings."""

    def __init__(self, model: Model, settings: GlbSettings, extras: dict[str, Any] | None):
        assert settings.max_bytes is not None
        self.model, self.asked, self.extras = model, settings, extras
        self.most = settings.max_bytes - _MARGIN
        self.side = max(model.base_color.shape[:2])
        self._packer = TexturePacker(model)
        self._geometry: dict[tuple, int] = {}
        chosen: dict[str, Any] = {"compress": "meshopt", "textures": "webp", "quality": 100, "data_quality": 100}
        self.start = settings.model_copy(update={k: v for k, v in chosen.items() if not self._is_stated(k)})

    def _is_stated(self, name: str) -> bool:
        return name in self.asked.model_fields_set

    def textures(self, settings: GlbSettings) -> PackedTextures:
        """Images and factors."""
        return self._packer.pack(settings)

    def n_bytes(self, settings: GlbSettings) -> int:
        """Of the whole file."""
        textures = self.textures(settings)
        images = sum(len(image.content) for image in textures.images.values())
        key = (settings.compress, settings.tangents)
        if key not in self._geometry:
            content = glb_bytes(self.model, extras=self.extras, settings=settings, textures=textures)
            self._geometry[key] = len(content) - images
        return self._geometry[key] + images

    def lower(self, settings: GlbSettings) -> Iterator[GlbSettings]:
        """The next steps down that save anything: of each quality, and of the size of each kind of image."""
        now = self.n_bytes(settings)
        for name, values in self._steps():
            value = getattr(settings, name) or self.side
            tried = (settings.model_copy(update={name: less}) for less in values if less < value)
            smaller = next((s for s in tried if self.n_bytes(s) < now), None)
            if smaller is not None:
                yield smaller

    def _steps(self) -> Iterator[tuple[str, Sequence[int]]]:
        """Settings that may be lowered, as nobody has stated them and there is such an image, and their values."""
        names = set(self.textures(self.start).images)
        data = names & {"normal", "orm"}
        if self.start.textures != "png":
            for name, present in (("quality", names - data), ("data_quality", data)):
                if present and not self._is_stated(name):
                    yield name, _QUALITIES
        if self.side & (self.side - 1):
            return  # without mip levels there is nothing to go down to
        sizes = [self.side >> k for k in range(1, self.side.bit_length()) if self.side >> k >= _LEAST_SIZE]
        for name, kinds in _SIZES.items():
            if names & set(kinds) and sizes and not self._is_stated(name):
                yield name, sizes

    def least(self) -> GlbSettings:
        """All steps down at once, and without tangents."""
        update: dict[str, Any] = {name: values[-1] for name, values in self._steps()}
        if not self._is_stated("tangents"):
            update["tangents"] = False
        return self.start.model_copy(update=update)

    def require_room(self) -> None:
        """Raise where even that is too large."""
        least = self.n_bytes(self.least()) + _MARGIN
        if least > self.most + _MARGIN:
            raise OutputError(
                f"--max-bytes {self.asked.max_bytes}: the least file of {self.model.n_triangles} triangles has {least} "
                f"bytes; ask for --max-bytes {-(-least // 1000)}kB, for fewer --triangles, or leave out what else is "
                "said of its packing"
            )
