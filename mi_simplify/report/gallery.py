"""
The held-out views of a report: two pictures of one with a divider between them, and all of them in a grid.

Every picture is a ``<figure>`` that says which view and column it shows, and is embedded once; the divider
(``web/page.js``) takes its pictures from the grid.
"""

from __future__ import annotations

import html

import numpy as np
from PIL import Image

from ..judging.comparison import Comparison
from ..judging.metrics import COVERED
from ..judging.pictures import Column, coverage_errors, flip_pictures, shown, signed_difference
from .embed import data_uri

MOST_VIEWS = 12
"""So many views are embedded, the first ones."""

MOST_PIXELS = 24_000_000
"""Pixels of all embedded pictures together; larger ones are reduced."""

LOSSLESS_PIXELS = 6_000_000
"""Up to here pictures are embedded as they are, about a byte a pixel; above it with the losses of WebP."""

ERRORS = ("difference", "coverage errors", "FLIP")


def pictures(comparison: Comparison) -> list[Column]:
    """
    Reference, candidates, then every candidate's difference, coverage errors and FLIP, cut to where anything is seen.
    """
    rows, columns = _window([comparison.reference, *comparison.candidates.values()])

    def cut(images: np.ndarray) -> np.ndarray:
        return images[:MOST_VIEWS, rows, columns]

    reference = cut(comparison.reference)
    out = [Column("reference", shown(reference))]
    errors: list[Column] = []
    for name, images in comparison.candidates.items():
        per_view, candidate = comparison.per_view[name], cut(images)
        out.append(Column(name, shown(candidate), _captions("{:.2f} dB", per_view["psnr"])))
        silhouette = [100 * x for x in per_view["silhouette_error"]]
        errors += [
            Column(f"{name}: {ERRORS[0]}", signed_difference(reference, candidate)),
            Column(f"{name}: {ERRORS[1]}", coverage_errors(reference, candidate), _captions("{:.2f} %", silhouette)),
            Column(f"{name}: {ERRORS[2]}", flip_pictures(reference, candidate), _captions("{:.4f}", per_view["flip"])),
        ]
    return _reduced(out + errors)


def divider(columns: list[Column], right: int) -> str:
    """
    Markup of two pictures, the reference and column ``right`` at first, which ``web/page.js`` takes from the grid.
    """
    n_views, height, width = columns[0].images.shape[:3]
    picker = "".join(f'<option value="{k}">{html.escape(column.name)}</option>' for k, column in enumerate(columns))
    thumbs = "".join(f'<button type="button" aria-label="view {k + 1}"></button>' for k in range(n_views))
    return f"""
<div class="compare" id="compare" data-left="0" data-right="{right}" hidden>
<div class="bar"><label>left <select data-side="left">{picker}</select></label>
<label>right <select data-side="right">{picker}</select></label></div>
<div class="stage" id="stage" role="slider" tabindex="0" aria-label="divider between the two pictures"
 aria-valuemin="0" aria-valuemax="100" aria-valuenow="50" style="--ratio: {width / height:.4f}">
<img class="right" alt=""><img class="left" alt=""><div class="divider"><i></i></div>
<span class="tag left"></span><span class="tag right"></span></div>
<div class="thumbs">{thumbs}</div>
</div>"""


def left_out(comparison: Comparison) -> str:
    """
    A sentence on views that are not shown; empty where all are.
    """
    n = len(comparison.reference)
    return f" The first {MOST_VIEWS} of {n} views are shown." if n > MOST_VIEWS else ""


def _captions(pattern: str, values: list[float]) -> tuple[str, ...]:
    return tuple(pattern.format(v) for v in values)


def _window(sets: list[np.ndarray]) -> tuple[slice, slice]:
    """Rows and columns in which anything is covered in any picture, with a margin; at least a third of the picture."""
    covered = np.logical_or.reduce([(images[..., 3] > COVERED).any(0) for images in sets])
    height, width = covered.shape

    def span(hit: np.ndarray) -> slice:
        n, where = len(hit), np.flatnonzero(hit)
        if not len(where):
            return slice(0, n)
        centre = (where[0] + where[-1] + 1) / 2
        half = max((where[-1] + 1 - where[0]) / 2 + n / 32, n / 6)
        return slice(max(0, int(centre - half)), min(n, int(np.ceil(centre + half))))

    return span(covered.any(1)), span(covered.any(0))


def _reduced(columns: list[Column]) -> list[Column]:
    """Pictures small enough to be embedded together."""
    n_views, height, width = columns[0].images.shape[:3]
    scale = (MOST_PIXELS / (len(columns) * n_views * height * width)) ** 0.5
    if scale >= 1:
        return columns
    size = max(1, int(width * scale)), max(1, int(height * scale))
    return [
        Column(
            column.name,
            np.stack([np.asarray(Image.fromarray(x).resize(size, Image.Resampling.BOX)) for x in column.images]),
            column.captions,
        )
        for column in columns
    ]


def grid(columns: list[Column], names: list[str]) -> str:
    """
    Markup of one row a view: reference, candidates by their ``names``, and the errors of one of them, to be chosen.
    """
    lossless = sum(column.images.size for column in columns) <= 3 * LOSSLESS_PIXELS
    small = " pixelated" if columns[0].images.shape[2] < 100 else ""
    n_plain, last = 1 + len(names), names[-1]
    shown_columns = n_plain + len(ERRORS)
    attributes = []  # of each column's cells
    for k, column in enumerate(columns):
        owner = None if k < n_plain else names[(k - n_plain) // len(ERRORS)]
        hidden = "" if owner in (None, last) else " hidden"
        kind = column.name if owner is None else ERRORS[(k - n_plain) % len(ERRORS)]
        of = "" if owner is None else f' data-of="{html.escape(owner)}"'
        attributes.append((kind, f'data-column="{html.escape(kind)}"{of}{hidden}'))
    cells = ['<div class="head"></div>']
    cells += [f'<div class="head" {attribute}>{html.escape(kind)}</div>' for kind, attribute in attributes]
    for view in range(len(columns[0].images)):
        cells.append(f'<div class="row">{view + 1}</div>')
        for k, (column, (_, attribute)) in enumerate(zip(columns, attributes, strict=True)):
            caption = html.escape(column.captions[view]) if column.captions else ""
            cells.append(
                f'<figure data-view="{view}" data-index="{k}" {attribute}>'
                f'<img alt="{html.escape(column.name)}, view {view + 1}" class="zoom{small}" '
                f'src="{data_uri(column.images[view], lossless=lossless)}"><figcaption>{caption}</figcaption></figure>'
            )
    return (
        f'{_choice(names)}<div class="scroll"><div class="views" style="--columns:{shown_columns}">'
        f"{''.join(cells)}</div></div>"
    )


def _choice(names: list[str]) -> str:
    """Whose errors the grid shows; nothing to choose where there is one candidate."""
    if len(names) < 2:
        return ""
    options = "".join(
        f"<option{' selected' if name == names[-1] else ''}>{html.escape(name)}</option>" for name in names
    )
    return f'<div class="bar"><label>errors of <select id="errors-of">{options}</select></label></div>'
