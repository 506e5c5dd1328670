"""
The held-out views of a report: two pictures of one with a divider between them, and all of them in a grid.

Every picture is a ``<figure>`` that says which view and column it shows, and is embedded once; the divider
(``web/page.js``) takes its pictures from the grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

from ..judging.comparison import Comparison
from ..judging.metrics import COVERED
from ..judging.pictures import Column, coverage_errors, displayed, flip_pictures, signed_difference
from .embed import data_uri

MOST_VIEWS = 12
"""So many views are embedded, the first ones."""

MOST_PIXELS = 24_000_000
"""Pixels of all embedded pictures together; larger ones are reduced."""

LOSSLESS_PIXELS = 6_000_000
"""Up to here pictures are embedded as they are, about a byte a pixel; above it with the losses of WebP."""

ERRORS = ("difference", "coverage errors", "FLIP")


@dataclass(frozen=True)
class Strip:
    """
    One column of the grid as it is embedded.

    Parameters
    ----------
    name, kind : str
        Of its pictures, and of its heading: one of :data:`ERRORS` where it shows how far a candidate is off.
    of : str or None
        That candidate.
    hidden : bool
        Until it is chosen.
    uris : list of str
        A picture a view.
    captions : tuple of str
        One a view, or none.
    """

    name: str
    kind: str
    of: str | None
    hidden: bool
    uris: list[str]
    captions: tuple[str, ...]


def pictures(comparison: Comparison) -> list[Column]:
    """
    Reference, candidates, then every candidate's difference, coverage errors and FLIP, cut to where anything is seen.
    """
    rows, columns = _window([comparison.reference, *comparison.candidates.values()])

    def cut(images: np.ndarray) -> np.ndarray:
        return images[:MOST_VIEWS, rows, columns]

    reference = cut(comparison.reference)
    out = [Column("reference", displayed(reference))]
    errors: list[Column] = []
    for name, images in comparison.candidates.items():
        per_view, candidate = comparison.per_view[name], cut(images)
        out.append(Column(name, displayed(candidate), _captions("{:.2f} dB", per_view["psnr"])))
        silhouette = [100 * x for x in per_view["silhouette_error"]]
        errors += [
            Column(f"{name}: {ERRORS[0]}", signed_difference(reference, candidate)),
            Column(f"{name}: {ERRORS[1]}", coverage_errors(reference, candidate), _captions("{:.2f} %", silhouette)),
            Column(f"{name}: {ERRORS[2]}", flip_pictures(reference, candidate), _captions("{:.4f}", per_view["flip"])),
        ]
    return _reduced(out + errors)


def divider(columns: list[Column], right: int) -> dict:
    """
    What ``web/views.html`` needs for two pictures with a divider, the reference and column ``right`` at first;
    ``web/page.js`` takes them from the grid.
    """
    n_views, height, width = columns[0].images.shape[:3]
    return {"names": [c.name for c in columns], "right": right, "ratio": width / height, "n_views": n_views}


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


def grid(columns: list[Column], names: list[str]) -> dict:
    """
    What ``web/views.html`` needs for one row a view: reference, candidates by their ``names``, and the errors of one of
    them, to be chosen.
    """
    lossless = sum(column.images.size for column in columns) <= 3 * LOSSLESS_PIXELS
    n_plain = 1 + len(names)
    strips = []
    for k, column in enumerate(columns):
        candidate, error = divmod(k - n_plain, len(ERRORS))
        of = names[candidate] if k >= n_plain else None
        kind = column.name if of is None else ERRORS[error]
        uris = [data_uri(image, lossless=lossless) for image in column.images]
        strips.append(Strip(column.name, kind, of, of not in (None, names[-1]), uris, column.captions))
    pixelated = columns[0].images.shape[2] < 100
    return {"names": names, "strips": strips, "n_shown": n_plain + len(ERRORS), "pixelated": pixelated}
