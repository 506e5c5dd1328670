"""
Pictures of a comparison: signed differences, coverage errors, FLIP maps, and the contact sheet of them.

All functions take linear images on black, shape (B, H, W, 4), and give 8-bit sRGB.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import flip_evaluator
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..formats.textures import to_8bit
from .metrics import COVERED, tonemap

RED, BLUE, GREY = np.array([[0.86, 0.15, 0.12], [0.13, 0.35, 0.90], [0.5, 0.5, 0.5]], np.float32)
DIFFERENCE_GAIN = 4.0
"""A difference of a quarter of the sRGB range is shown in full colour."""

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

BACKGROUND, INK, FAINT = (22, 22, 25), (236, 236, 240), (150, 150, 160)


def displayed(images: np.ndarray) -> np.ndarray:
    """
    Linear images as a screen shows them, shape (B, H, W, 3), uint8.
    """
    return to_8bit(tonemap(images))


def signed_difference(reference: np.ndarray, candidate: np.ndarray, *, gain: float = DIFFERENCE_GAIN) -> np.ndarray:
    """
    Where a candidate is too bright (red) or too dim (blue), on neutral grey.

    Parameters
    ----------
    reference, candidate : ndarray, shape (B, H, W, C), C >= 3
        Linear radiance; compared by the luma of their tone-mapped values.
    gain : float
        Full colour at a difference of ``1 / gain``.

    Returns
    -------
    ndarray, shape (B, H, W, 3), uint8
    """
    luma = (tonemap(candidate) - tonemap(reference)) @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    d = np.clip(gain * luma, -1.0, 1.0)[..., None]
    return to_8bit(GREY + np.maximum(d, 0) * (RED - GREY) + np.maximum(-d, 0) * (BLUE - GREY))


def coverage_errors(reference: np.ndarray, candidate: np.ndarray) -> np.ndarray:
    """
    Pixels that only the candidate covers (red) or only the reference (blue); what both cover is grey.

    Parameters
    ----------
    reference, candidate : ndarray, shape (B, H, W, 4)

    Returns
    -------
    ndarray, shape (B, H, W, 3), uint8
    """
    a, b = reference[..., 3] > COVERED, candidate[..., 3] > COVERED
    colors = np.stack([np.array([0.09, 0.09, 0.1], np.float32), BLUE, RED, np.array([0.36, 0.36, 0.38], np.float32)])
    return to_8bit(colors)[a + 2 * b.astype(np.int64)]


def flip_pictures(reference: np.ndarray, candidate: np.ndarray) -> np.ndarray:
    """
    FLIP error in the magma colour map, shape (B, H, W, 3), uint8: black where nothing is seen.
    """
    pairs = zip(tonemap(reference), tonemap(candidate), strict=True)
    maps = [
        flip_evaluator.evaluate(np.ascontiguousarray(a), np.ascontiguousarray(b), "LDR", computeMeanError=False)[0]
        for a, b in pairs
    ]
    return to_8bit(np.stack(maps))


@dataclass(frozen=True)
class Column:
    """
    One kind of picture over all views.

    Parameters
    ----------
    name : str
    images : ndarray, shape (B, H, W, 3), uint8
    captions : tuple of str
        One per view, or none.
    """

    name: str
    images: np.ndarray
    captions: tuple[str, ...] = ()


def comparison_columns(
    reference: np.ndarray, candidates: Mapping[str, np.ndarray], per_view: Mapping[str, Mapping]
) -> list[Column]:
    """
    Reference, every candidate with its PSNR, then the last candidate's errors: difference, coverage, FLIP.

    Parameters
    ----------
    reference : ndarray, shape (B, H, W, 4)
        Linear radiance and coverage.
    candidates : mapping of str to ndarray, shape (B, H, W, 4)
        At least one, by the name that heads the column: ``{"first guess": ..., "result": ...}``.
    per_view : mapping of str to mapping
        Of each candidate, what :func:`.metrics.compare` says under this key.

    Returns
    -------
    list of Column
    """
    columns = [Column("reference", displayed(reference))]
    for name, images in candidates.items():
        columns.append(Column(name, displayed(images), tuple(f"{p:.2f} dB" for p in per_view[name]["psnr"])))
    name, last = list(candidates.items())[-1]
    silhouette, flip = per_view[name]["silhouette_error"], per_view[name]["flip"]
    return [
        *columns,
        Column("difference", signed_difference(reference, last)),
        Column("coverage errors", coverage_errors(reference, last), tuple(f"{100 * x:.2f} %" for x in silhouette)),
        Column("FLIP", flip_pictures(reference, last), tuple(f"{x:.4f}" for x in flip)),
    ]


def contact_sheet(
    reference: np.ndarray, candidates: Mapping[str, np.ndarray], per_view: Mapping[str, Mapping]
) -> Image.Image:
    """
    All views at a glance, one row each: the columns of :func:`comparison_columns` with a legend below.
    """
    columns = comparison_columns(reference, candidates, per_view)
    return _grid(columns, _legend(list(candidates)[-1]))


def _legend(name: str) -> list[tuple[tuple[int, int, int] | None, str]]:
    """Coloured words under the sheet: a colour, or None for plain text."""
    return [
        (None, f"{name}:"),
        (_ink(RED), "too bright, or covers too much"),
        (_ink(BLUE), "too dim, or covers too little"),
        (None, f"difference x {DIFFERENCE_GAIN:g}"),
    ]


def _ink(color: np.ndarray) -> tuple[int, int, int]:
    r, g, b = to_8bit(color).tolist()
    return r, g, b


def _grid(columns: list[Column], legend: list[tuple[tuple[int, int, int] | None, str]]) -> Image.Image:
    """Draw titled columns of pictures, a number before every row, and a legend below."""
    n_rows, height, width = columns[0].images.shape[:3]
    scale = max(1, -(-160 // width))  # small pictures are enlarged, so that the words fit
    cell_w, cell_h = width * scale, height * scale
    size = int(np.clip(cell_w / 16, 12, 24))
    title, caption = ImageFont.load_default(size), ImageFont.load_default(max(11, size - 3))
    gap, head, line, gutter = size // 2, 2 * size, int(1.5 * size), 2 * size
    row_h = cell_h + line
    sheet = Image.new(
        "RGB",
        (gutter + len(columns) * (cell_w + gap) + gap, head + n_rows * row_h + 2 * head),
        BACKGROUND,
    )
    draw = ImageDraw.Draw(sheet)
    for k, column in enumerate(columns):
        x = gutter + k * (cell_w + gap)
        draw.text((x, head / 2), _fitting(draw, column.name, title, cell_w), INK, font=title, anchor="lm")
        for row, image in enumerate(column.images):
            y = head + row * row_h
            picture = Image.fromarray(image).resize((cell_w, cell_h), Image.Resampling.NEAREST)
            sheet.paste(picture, (x, y))
            if column.captions:
                draw.text((x + cell_w, y + cell_h + line / 2), column.captions[row], FAINT, font=caption, anchor="rm")
    for row in range(n_rows):
        draw.text((gutter / 2, head + row * row_h + cell_h / 2), f"{row + 1}", FAINT, font=title, anchor="mm")
    x, y = gutter, head + n_rows * row_h + head
    for color, text in legend:
        if color is not None:
            draw.rectangle((x, y - size // 3, x + size * 2 // 3, y + size // 3), fill=color)
            x += size
        draw.text((x, y), text, FAINT, font=caption, anchor="lm")
        x += int(draw.textlength(text, font=caption)) + size
    return sheet


def _fitting(draw: ImageDraw.ImageDraw, text: str, font: Font, width: int) -> str:
    """The text, cut where it is wider than a column."""
    if draw.textlength(text, font=font) <= width:
        return text
    while text and draw.textlength(text + "...", font=font) > width:
        text = text[:-1]
    return text + "..."
