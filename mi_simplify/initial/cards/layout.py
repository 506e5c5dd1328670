"""
Where cards lie in their atlas.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import MeshError
from .clusters import Clusters

#: How far a quad reaches beyond what it shows, and from there to the next card [texels].
_MARGIN, _GAP = 0.5, 0.5


@dataclass(frozen=True)
class Layout:
    """
    Where the cards lie in the atlas.

    Parameters
    ----------
    low, high : ndarray, shape (C, 2)
        Corners of the cards on their planes, from the clusters' centres [world units].
    corner, cells : ndarray, shape (C, 2), int64
        First column and row of the cards' cells, and how many they have [texels].
    density : float
        Texels per world unit.
    """

    low: np.ndarray
    high: np.ndarray
    corner: np.ndarray
    cells: np.ndarray
    density: float

    def texel(self, card: np.ndarray, local: np.ndarray) -> np.ndarray:
        """
        Column and row [texels] of points on the planes of some cards, shape (..., 2); up the image is the second axis.
        """
        x = (local[..., 0] - self.low[card, 0]) * self.density + _GAP
        y = (self.high[card, 1] - local[..., 1]) * self.density + _GAP
        return self.corner[card] + np.stack([x, y], -1)

    def texels(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Every texel of every cell: its place in the flat atlas, its card, and where its centre lies on that, shape
        (N, 2), from -1 to 1 between the card's sides.
        """
        n = self.cells.prod(1)
        card = np.repeat(np.arange(len(n)), n)
        k = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
        column, row = k % self.cells[card, 0], k // self.cells[card, 0]
        half = (self.high - self.low)[card] * (self.density / 2)
        middle = np.stack([column + 0.5 - _GAP - half[:, 0], half[:, 1] - (row + 0.5 - _GAP)], 1)
        return (self.corner[card, 1] + row) * size + self.corner[card, 0] + column, card, middle / half


def lay_out(clusters: Clusters, corners: np.ndarray, atlas_size: int) -> Layout:
    """
    Rectangles on the planes, and their places in the atlas: in rows of falling height, as many texels as fit.

    Parameters
    ----------
    corners : ndarray, shape (F, 3, 3)

    Raises
    ------
    MeshError
        Not even the smallest cells fit.
    """
    used = clusters.label >= 0
    label = clusters.label[used]
    local = np.einsum("fki,fai->fka", corners[used] - clusters.centre[label, None], clusters.axes[label][:, :2])
    order = np.argsort(label, kind="stable")
    start = np.searchsorted(label[order], np.arange(len(clusters)))
    low = np.minimum.reduceat(local.min(1)[order], start)
    high = np.maximum.reduceat(local.max(1)[order], start)
    size = np.maximum(high - low, 1e-6 * (high - low).max())
    least, most = 0.0, 4 * atlas_size / size.max()
    for _ in range(24):
        density = (least + most) / 2
        least, most = (least, density) if _pack(size, density, atlas_size) is None else (density, most)
    corner = _pack(size, least, atlas_size)
    if corner is None or least == 0:
        need = int(np.ceil(4 * np.sqrt(len(clusters))))
        raise MeshError(f"{len(clusters)} cards do not fit a {atlas_size}² atlas; use an atlas size of at least {need}")
    margin = _MARGIN / least
    return Layout(low - margin, low + size + margin, corner, _cells(size, least), least)


def _cells(size: np.ndarray, density: float) -> np.ndarray:
    """Columns and rows of the cards' cells, shape (C, 2), int64."""
    return np.ceil(size * density + 2 * (_MARGIN + _GAP)).astype(np.int64)


def _pack(size: np.ndarray, density: float, atlas_size: int) -> np.ndarray | None:
    """First column and row of every cell, shape (C, 2), rows filled one after the other; None where they do not fit."""
    cells = _cells(size, density)
    if cells.max() > atlas_size or cells.prod(1).sum() > atlas_size**2:
        return None
    order = np.argsort(-cells[:, 1], kind="stable")
    corner = np.empty_like(cells)
    x = y = height = 0
    for k, (w, h) in zip(order.tolist(), cells[order].tolist(), strict=True):
        if x + w > atlas_size:
            x, y, height = 0, y + height, 0
        if y + h > atlas_size:
            return None
        corner[k] = x, y
        x, height = x + w, max(height, h)
    return corner
