"""
Mip levels that were fitted by themselves, as images: the model formats hold the finest one alone.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ..formats.textures import encode_textures, png
from ..machine.files import write_atomic
from ..model.model import Model


def write_mips(model: Model, folder: Path) -> list[Path]:
    """
    Write ``base_color_0.png``, ``orm_0.png``, ``normal_0.png`` and so on, 0 the finest level, encoded as in a GLB.

    Parameters
    ----------
    model : Model
    folder : Path
        Which exists.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    paths = []
    levels: list[dict[str, Any]] = [{}, *model.mips]
    for level, images in enumerate(levels):
        textures = encode_textures(replace(model, **images))
        for key in ("base_color", "orm", "normal"):
            paths.append(write_atomic(folder / f"{key}_{level}.png", png(getattr(textures, key))))
    return paths
