"""
The small picture of a result beside its reference and its mesh, for the page of a batch.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from ...formats.load import load_asset
from ...judging.comparison import load_comparison
from ...judging.pictures import displayed
from ...machine.files import write_atomic
from ...machine.runtime import ensure_variant
from ...report.portrait import portrait_view
from ...report.wireframe import wireframe

THUMBNAIL, SIDE = "thumbnail.jpg", 128


def thumbnail(folder: Path) -> Path:
    """
    Write ``thumbnail.jpg``: the first held-out view of reference and result, and the result's mesh, side by side.
    """
    comparison = load_comparison(folder)
    result = comparison.candidates.get("result", next(iter(comparison.candidates.values())))
    panels = [Image.fromarray(displayed(x[:1])[0]).resize((SIDE, SIDE)) for x in (comparison.reference, result)]
    if (folder / "model.glb").is_file():
        ensure_variant()
        asset = load_asset(folder / "model.glb")
        black = Image.new("RGB", (2 * SIDE, 2 * SIDE))
        panels.append(wireframe(asset, portrait_view(asset.bounds, resolution=2 * SIDE), black).resize((SIDE, SIDE)))
    stream = io.BytesIO()
    sheet = np.concatenate([np.asarray(panel.convert("RGB")) for panel in panels], axis=1)
    Image.fromarray(sheet).save(stream, "JPEG", quality=85)
    return write_atomic(folder / THUMBNAIL, stream.getvalue())
