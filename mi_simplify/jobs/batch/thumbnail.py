"""
The small picture of a result beside its reference, for the page of a batch.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from ...judging.comparison import load_comparison
from ...judging.pictures import displayed
from ...machine.files import write_atomic

THUMBNAIL, SIDE = "thumbnail.jpg", 128


def thumbnail(folder: Path) -> Path:
    """
    Write ``thumbnail.jpg``: reference and result, the first held-out view, side by side.
    """
    comparison = load_comparison(folder)
    result = comparison.candidates.get("result", next(iter(comparison.candidates.values())))
    panels = [Image.fromarray(displayed(x[:1])[0]).resize((SIDE, SIDE)) for x in (comparison.reference, result)]
    stream = io.BytesIO()
    Image.fromarray(np.concatenate([np.asarray(p.convert("RGB")) for p in panels], axis=1)).save(
        stream, "JPEG", quality=85
    )
    return write_atomic(folder / THUMBNAIL, stream.getvalue())
