"""
Curves of a run as inline SVG: no script, no file, colours from the page that holds them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from .templates import render

WIDTH, HEIGHT = 560, 250
LEFT, RIGHT, TOP, BOTTOM = 58, 14, 12, 40
MOST_POINTS = 400
"""Longer curves are thinned to this many buckets, each drawn as its mean."""


def line_chart(
    x: Sequence[float], y: Sequence[float], *, x_label: str, y_label: str, log: bool = False, css: str = "curve"
) -> Markup:
    """
    One curve with axes, ticks and a tooltip at its last value.

    Parameters
    ----------
    x, y : sequence of float
        Points; those that are not finite (or not positive on a log axis) are left out.
    x_label, y_label : str
        Name and unit of the axes.
    log : bool
        Logarithmic y axis.
    css : str
        Class of the ``<svg>``.

    Returns
    -------
    Markup
        An ``<svg>`` element, or nothing where no point is left.
    """
    points = np.array([np.asarray(x, np.float64), np.asarray(y, np.float64)])
    points = points[:, np.isfinite(points).all(0) & ((points[1] > 0) | (not log))]
    if not points.shape[1]:
        return Markup()
    last = points[1, -1]
    if log:
        points[1] = np.log10(points[1])
    points = _thinned(points)
    (x0, x1), (y0, y1) = _range(points[0]), _range(points[1], margin=0.05)
    x0 = 0.0 if 0 < x0 < 0.1 * x1 else x0  # step 1 of many starts at the origin
    to_x = lambda v: LEFT + (v - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT)  # noqa: E731
    to_y = lambda v: HEIGHT - BOTTOM - (v - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM)  # noqa: E731

    rows = [(to_y(value), text) for value, text in (log_ticks(y0, y1) if log else ticks(y0, y1))]
    columns = [(to_x(value), text) for value, text in ticks(x0, x1)]
    return render(
        "chart.svg", css=css, width=WIDTH, height=HEIGHT, left=LEFT, right=WIDTH - RIGHT, axis=HEIGHT - BOTTOM,
        rows=rows, columns=columns, points=[(to_x(a), to_y(b)) for a, b in points.T], last=f"{last:.6g}",
        x_label=x_label, y_label=y_label,
    )  # fmt: skip


def ticks(low: float, high: float, n: int = 5) -> list[tuple[float, str]]:
    """
    About ``n`` round values in a range, each with its text.
    """
    rough = (high - low) / n
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= rough * (1 - 1e-9))
    values = step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return [(float(v), f"{v + 0.0:g}") for v in np.round(values, 12)]


def log_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """
    Ticks of an axis of decimal logarithms: whole powers, with 2 and 5 (or all digits) between where they are few;
    evenly spaced values where the range is short.
    """
    for digits in ((1,), (1, 2, 5), range(1, 10)):
        powers = range(math.floor(low), math.ceil(high) + 1)
        values = [d * 10.0**p for p in powers for d in digits if low <= math.log10(d) + p <= high]
        if len(values) >= 3:
            return [(math.log10(v), f"{v:g}") for v in values]
    return [(math.log10(v), text) for v, text in ticks(10**low, 10**high)]


def _range(values: np.ndarray, margin: float = 0.0) -> tuple[float, float]:
    """Smallest and largest value, apart even where there is only one."""
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9 * max(1.0, abs(high)):
        low, high = low - 0.5, high + 0.5
    pad = margin * (high - low)
    return low - pad, high + pad


def _thinned(points: np.ndarray) -> np.ndarray:
    """Means over equal runs of points, (2, n) to (2, at most MOST_POINTS); the last point stays."""
    n = points.shape[1]
    if n <= MOST_POINTS:
        return points
    edges = np.linspace(0, n, MOST_POINTS, dtype=np.int64)[:-1]
    counts = np.diff(np.append(edges, n))
    means = np.add.reduceat(points, edges, axis=1) / counts
    return np.concatenate([means, points[:, -1:]], axis=1)
