"""
What a judgement leaves: images and figures, as files and back.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OutputError
from ..formats.textures import png
from ..machine.files import make_folder, write_atomic
from ..model.color import srgb_to_linear
from .pictures import contact_sheet, displayed

VIEWS = "views.npz"
"""The images of a comparison as a screen shows them, with coverage: what its report is built from."""


@dataclass(frozen=True)
class Comparison:
    """
    Images of a reference and its candidates, and what they measure.

    Parameters
    ----------
    reference : ndarray, shape (B, H, W, 4), float32
        Linear radiance on black, and coverage.
    candidates : dict of str to ndarray, shape (B, H, W, 4), float32
    figures : dict
        What ``metrics.json`` holds: ``settings``, ``reference`` and, by name, ``candidates`` with
        ``triangles``, ``psnr`` [dB], ``flip``, ``silhouette_error`` and ``per_view`` lists.
    """

    reference: np.ndarray
    candidates: dict[str, np.ndarray]
    figures: dict

    @property
    def per_view(self) -> dict[str, dict]:
        """Of every candidate the figures of each view."""
        return {name: self.figures["candidates"][name]["per_view"] for name in self.candidates}


def save_comparison(comparison: Comparison, out: str | Path) -> dict[str, Path]:
    """
    Write ``metrics.json``, ``contact_sheet.png`` and ``views.npz`` into a folder, which is made where it is missing.

    Returns
    -------
    dict
        ``metrics``, ``contact_sheet`` and ``views``: the paths.

    Raises
    ------
    OutputError
        The folder cannot be written.
    """
    out = make_folder(out)
    sheet = contact_sheet(comparison.reference, comparison.candidates, comparison.per_view)
    text = json.dumps(comparison.figures, indent=2, allow_nan=False) + "\n"
    images = {"reference": comparison.reference}
    images |= {f"candidate_{k}": x for k, x in enumerate(comparison.candidates.values())}
    packed: dict[str, Any] = {
        name: np.concatenate([displayed(x), _levels(x[..., 3:])], axis=3) for name, x in images.items()
    }
    stream = io.BytesIO()
    np.savez_compressed(stream, **packed)
    return {
        "contact_sheet": write_atomic(out / "contact_sheet.png", png(np.asarray(sheet))),
        "views": write_atomic(out / VIEWS, stream.getvalue()),
        "metrics": write_atomic(out / "metrics.json", text),
    }


def _levels(coverage: np.ndarray) -> np.ndarray:
    """Coverage in 254 steps, so that one half is a level of its own."""
    return np.rint(np.clip(coverage, 0, 1) * 254).astype(np.uint8)


def load_comparison(folder: str | Path) -> Comparison:
    """
    What :func:`save_comparison` wrote, with images as precise as a screen shows them.

    Raises
    ------
    OutputError
        The folder holds no comparison, or a damaged one.
    """
    folder = Path(folder)
    metrics, views = folder / "metrics.json", folder / VIEWS
    if not metrics.is_file():
        raise OutputError(f"{folder} holds no finished run; name a folder that simplify, run or compare has written")
    if not views.is_file():
        raise OutputError(f"{folder} has no {VIEWS}, the pictures of its held-out views; run or compare again")
    try:
        figures = json.loads(metrics.read_text(encoding="utf-8"))
        reference, candidates = figures["reference"], figures["candidates"]
        _ = reference["name"] + "", reference["triangles"] + 0, figures["settings"]["spp"]
        lengths = [len(c["per_view"][key]) for c in candidates.values() for key in ("psnr", "flip", "silhouette_error")]
        _ = [c[key] + 0.0 for c in candidates.values() for key in ("triangles", "psnr", "flip", "silhouette_error")]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        raise OutputError(f"{metrics} is damaged; run or compare again") from None
    names = ["reference", *(f"candidate_{k}" for k in range(len(candidates)))]
    try:
        with np.load(io.BytesIO(views.read_bytes()), allow_pickle=False) as archive:
            images = [_linear(archive[name]) for name in names]
    except (OSError, EOFError, ValueError, LookupError, MemoryError, zipfile.BadZipFile, zlib.error):
        raise OutputError(f"{views} is damaged; run or compare again") from None
    if not candidates or {x.shape for x in images} != {images[0].shape} or {len(images[0])} != set(lengths):
        raise OutputError(f"{views} does not belong to {metrics}; run or compare again")
    return Comparison(images[0], dict(zip(candidates, images[1:], strict=True)), figures)


def _linear(packed: np.ndarray) -> np.ndarray:
    """Inverse of what :func:`save_comparison` does to images."""
    if packed.dtype != np.uint8 or packed.ndim != 4 or packed.shape[3] != 4 or not packed.size:
        raise ValueError("not a set of views")
    color, coverage = srgb_to_linear(packed[..., :3] / 255.0), packed[..., 3:] / 254.0
    return np.concatenate([color, coverage], axis=3).astype(np.float32)
