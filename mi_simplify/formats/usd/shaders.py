"""
Nodes of a USD material: their inputs, what feeds them, and the images that they name.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Ar, Sdf, UsdShade

from ...errors import AssetError
from ..resources import Resources


def _attributes(shader: UsdShade.Shader, key: str) -> list:
    found = shader.GetInput(key)
    return found.GetValueProducingAttributes() if found else []


def source_of(shader: UsdShade.Shader, key: str) -> tuple[UsdShade.Shader, str] | None:
    """The node and output that feed an input, through any node graphs; None for a plain value."""
    for attribute in _attributes(shader, key):
        if UsdShade.Output.IsOutput(attribute):
            return UsdShade.Shader(attribute.GetPrim()), UsdShade.Output(attribute).GetBaseName()
    return None


def plain(shader: UsdShade.Shader, key: str, default: object) -> Any:
    """The value of an input that no node feeds, or the default."""
    for attribute in _attributes(shader, key):
        if not UsdShade.Output.IsOutput(attribute):
            value = attribute.Get()
            return default if value is None else value
    return default


def image_of(shader: UsdShade.Shader, key: str, material: str, resources: Resources) -> np.ndarray:
    """
    The decoded image of a texture node's ``file``, shape (H, W, C).

    Parameters
    ----------
    key, material : str
        What the messages call it: the input that it feeds, and whose.

    Raises
    ------
    AssetError
        It names no file, or one that does not exist, lies outside the model's folder, or cannot be decoded.
    """
    asset = plain(shader, "file", None)
    model = resources.model.name
    if not isinstance(asset, Sdf.AssetPath) or not asset.path:
        raise AssetError(f"{model}: the texture of '{key}' of material '{material}' names no file")
    if "<UDIM>" in asset.path:
        raise AssetError(f"{model}: texture '{asset.path}' is a set of UDIM tiles; merge them into one image first")
    resolved = asset.resolvedPath
    opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(resolved)) if resolved else None
    if not opened:
        raise AssetError(f"{model}: texture '{asset.path}' does not exist; put it where the file looks for it")
    if not resources.holds(Path(Ar.SplitPackageRelativePathOuter(resolved)[0])):
        raise resources.outside(asset.path, "texture")
    with opened:
        return resources.embedded_image(("usd", resolved), _reader_of(opened), asset.path)


def _reader_of(opened: Any) -> Callable[[], bytes]:
    return lambda: bytes(opened.GetBuffer())
