"""
Buffer views compressed by meshoptimizer (EXT_meshopt_compression, KHR_meshopt_compression).
"""

from __future__ import annotations

from typing import Any

import meshopt
import numpy as np

from ...errors import AssetError
from ...machine import memory

_NAMES = ("EXT_meshopt_compression", "KHR_meshopt_compression")


def compression(view: dict[str, Any]) -> dict[str, Any] | None:
    """
    What stands for the plain bytes of a buffer view, None where they are there.
    """
    extensions = view.get("extensions") or {}
    return next((extensions[name] for name in _NAMES if extensions.get(name) is not None), None)


def decompressed(packed: dict[str, Any], data: memoryview, index: int, model: str) -> bytes:
    """
    The plain bytes of a buffer view: ``count`` elements of ``byteStride`` bytes.

    Parameters
    ----------
    packed : dict
        The view's extension.
    data : memoryview
        What it names.
    index : int
        Number of the view.

    Raises
    ------
    AssetError
        The data is broken.
    MemoryLimitError
        There is no room for it.
    """
    count, stride = int(packed["count"]), int(packed["byteStride"])
    memory.require(count * stride, f"{model}: bufferViews[{index}]", "simplify the file first")
    try:
        if count <= 0:
            raise ValueError(f"it has {count} elements")
        rows = meshopt.decode_gltf_buffer(bytes(data), count, stride, packed["mode"], packed.get("filter", "NONE"))
    except (ValueError, RuntimeError) as error:
        raise AssetError(
            f"{model}: bufferViews[{index}], compressed with meshopt, is broken ({error}); export it again"
        ) from error
    return np.ascontiguousarray(rows).tobytes()
