"""
Views at random film sizes, so that one model learns to be seen from near and far.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scenes.views import Views


def film_sizes(resolution: int, least: int | None) -> list[int]:
    """
    Sides from ``resolution`` down to ``least``, each √2 smaller than the one before, in whole tiles of four pixels.

    A few, since every size is kernels of its own.
    """
    if least is None or least >= resolution:
        return [resolution]
    steps = max(1, round(2 * np.log2(resolution / least)))
    sides = resolution * (least / resolution) ** (np.arange(steps + 1) / steps)
    return sorted({resolution, *(max(4, 4 * round(s / 4)) for s in sides[1:])}, reverse=True)


def at_sizes(draw: Callable, least: int | None, n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
    """
    Random views for images of all sizes, as many pixels of each, together about as many as ``n`` of the largest have.

    Parameters
    ----------
    draw : callable
        ``draw(n, rng, resolution) -> list of Views`` of one size.
    least : int, optional
        Smallest side [pixels]; none: all are of ``resolution``.
    """
    sizes = film_sizes(resolution, least)
    counts = [max(1, round(n / len(sizes) * (resolution / size) ** 2)) for size in sizes]
    if len(sizes) == 1:
        counts = [n]
    return [views for size, count in zip(sizes, counts, strict=True) for views in draw(count, rng, size)]
