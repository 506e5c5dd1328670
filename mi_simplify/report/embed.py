"""
What a page carries inside itself: pictures as data URIs, arrays as base64, scripts with the hash that permits them.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import zlib
from importlib.resources import files

import numpy as np
from PIL import Image


def data_uri(image: np.ndarray, *, lossless: bool = True) -> str:
    """
    An 8-bit image, (H, W) or (H, W, 3), as a WebP data URI.

    Parameters
    ----------
    lossless : bool
        Every value as it is; otherwise about a third of the bytes, with errors of one or two steps.
    """
    stream = io.BytesIO()
    options = {"lossless": True, "quality": 20, "method": 2} if lossless else {"quality": 92}
    Image.fromarray(np.ascontiguousarray(image)).convert("RGB").save(stream, "WEBP", **options)
    return f"data:image/webp;base64,{base64.b64encode(stream.getvalue()).decode()}"


def packed_array(array: np.ndarray) -> str:
    """
    The bytes of an array in C order, little endian, compressed by zlib, as base64.
    """
    content = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
    return base64.b64encode(zlib.compress(content, 6)).decode()


def json_block(name: str, value: object) -> str:
    """
    A value as JSON in a ``<script>`` element that holds data; nothing in it can end the element.
    """
    text = json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{text}</script>\n'


def web_file(name: str) -> str:
    """
    A script or style sheet of the folder ``web`` beside this module.
    """
    return files(__package__).joinpath("web", name).read_text(encoding="utf-8")


def script_hash(text: str) -> str:
    """
    What a Content-Security-Policy calls the one script that it lets run.
    """
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
