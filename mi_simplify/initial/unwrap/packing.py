"""
Charts packed into a square by their outlines: turned 32 ways, set into the lowest place that is free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import MeshError

_TURNS = 32
"""Rotations that are tried."""
_CELLS = 512
"""Most cells along a side of the grid in which charts are placed."""
_AT_ONCE = 12
"""Runs after which a turn is given up if it cannot become the best one."""
_SMALL = 0.01
"""Share of the surface below which a chart is tried in half of the rotations."""
_TRIES = 4
"""Packings of different scale."""


def pack(uvs: np.ndarray, border: np.ndarray, owner: np.ndarray, size: int, padding: int) -> np.ndarray:
    """
    Turn, scale (all alike) and move charts so that they lie apart in a square.

    Parameters
    ----------
    uvs : ndarray, shape (V, 2)
        Charts of the same density, in any place.
    border : ndarray, shape (B, 2)
        Edges of the charts' borders, counter-clockwise.
    owner : ndarray, shape (V,)
        Chart of every vertex.
    size : int
        Side of the square [texels].
    padding : int
        Least distance of two charts, and twice that to the border of the square [texels].

    Returns
    -------
    ndarray, shape (V, 2)
        [texels]; no chart is mirrored.
    """
    inner = size - padding
    n_cells = int(min(inner / (padding / 2), _CELLS))
    cell = inner / n_cells
    n_charts = int(owner.max()) + 1
    uvs = _upright(uvs, border, owner, n_charts)
    ends = uvs[border]  # (B, 2, 2)
    chart = owner[border[:, 0]]
    cross = ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]
    area = np.bincount(chart, cross / 2, n_charts)
    angle = 2 * np.pi / _TURNS * np.arange(_TURNS)
    turned = np.einsum("tij,bkj->tbki", _rotations(angle), ends)
    order = np.argsort(-area, kind="stable")
    far, small = _reach(padding / cell), area < _SMALL * area.sum()

    scale, best, low, high = float(np.sqrt(0.7 * n_cells**2 / area.sum())), None, 0.0, np.inf
    for _ in range(_TRIES):
        shapes = _shapes(turned * scale, chart, n_charts)
        placed = _place(shapes, order, small, n_cells, far)
        if placed.top <= n_cells:
            low = scale
            if best is None or scale > best[0]:
                best = scale, shapes, placed
        else:
            high = scale
        step = scale * np.sqrt(n_cells / placed.top)
        scale = step * (0.997 if step < scale else 1.003)
        if not low < scale < high:
            scale = (low + high) / 2 if np.isfinite(high) else low * 1.01
        if low and high / low < 1.004:
            break
    first = scale
    while best is None:  # a few charts that are larger than expected
        scale *= 0.95
        if scale < 0.2 * first:
            raise MeshError(
                f"{n_charts} charts do not fit a {size}² atlas with {padding} texels between them; use an atlas "
                f"size of at least {2 * size}"
            )
        shapes = _shapes(turned * scale, chart, n_charts)
        placed = _place(shapes, order, small, n_cells, far)
        if placed.top <= n_cells:
            best = scale, shapes, placed
    scale, shapes, placed = best
    which = np.arange(n_charts) * _TURNS + placed.turn
    out = np.einsum("vij,vj->vi", _rotations(angle)[placed.turn[owner]], uvs) * scale
    out += (placed.at - shapes.low[which])[owner]
    return out * cell + padding / 2


def _rotations(angle: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def _upright(uvs, border, owner, n_charts) -> np.ndarray:
    """Charts turned so that the upright box around them is the smallest."""
    angle = np.pi / 2 * np.arange(45) / 45
    rim = border[:, 0]
    rim = rim[np.argsort(owner[rim], kind="stable")]
    starts = np.searchsorted(owner[rim], np.arange(n_charts))
    turned = np.einsum("tij,bj->tbi", _rotations(angle), uvs[rim])
    box = np.maximum.reduceat(turned, starts, axis=1) - np.minimum.reduceat(turned, starts, axis=1)
    return np.einsum("vij,vj->vi", _rotations(angle[box.prod(2).argmin(0)])[owner], uvs)


@dataclass(frozen=True)
class _Shapes:
    """
    Cells that the charts touch, ``_TURNS`` shapes a chart, in runs along x.

    Parameters
    ----------
    low : ndarray, shape (S, 2)
        Where the box of a shape begins, in cells.
    extent : ndarray, shape (S, 2)
        Its width and height in cells.
    first : ndarray, shape (S + 1,)
        First run of each shape.
    y, x, n : ndarray, shape (R,)
        Row, first cell and length of every run, in the box; long ones first, which fit in few places.
    """

    low: np.ndarray
    extent: np.ndarray
    first: np.ndarray
    y: np.ndarray
    x: np.ndarray
    n: np.ndarray


def _shapes(turned: np.ndarray, chart: np.ndarray, n_charts: int) -> _Shapes:
    """Of borders that are turned, shape (T, B, 2, 2), in cells."""
    n_shapes = n_charts * len(turned)
    shape = (chart * len(turned) + np.arange(len(turned))[:, None]).ravel()
    ends = turned.reshape(-1, 2, 2)
    low, high = np.full((n_shapes, 2), np.inf), np.full((n_shapes, 2), -np.inf)
    np.minimum.at(low, shape, ends[:, 0])
    np.maximum.at(high, shape, ends[:, 0])
    low -= 1e-6
    extent = np.floor(high - low).astype(np.int64) + 1
    stride = extent[:, 0] + 1
    base = np.concatenate([[0], np.cumsum(stride * extent[:, 1])])
    ends = ends - low[shape][:, None]

    touched = np.zeros(base[-1], bool)
    cell = np.floor(ends[:, 0]).astype(np.int64)
    touched[base[shape] + cell[:, 1] * stride[shape] + cell[:, 0]] = True
    for axis in (0, 1):  # an edge passes into the next cell where it meets a line of the grid
        k, line, across = _meetings(ends, axis, 0.0)
        side = np.minimum(np.floor(across).astype(np.int64), extent[shape[k], 1 - axis] - 1)
        for step in (-1, 0):
            x, y = (line + step, side) if axis == 0 else (side, line + step)
            touched[base[shape[k]] + y * stride[shape[k]] + x] = True
    winding = np.zeros(base[-1], np.int32)
    k, line, across = _meetings(ends, 1, 0.5)
    up = np.where(ends[k, 1, 1] > ends[k, 0, 1], -1, 1)
    np.add.at(winding, base[shape[k]] + line * stride[shape[k]] + np.ceil(across - 0.5).astype(np.int64), up)
    inside = touched | (np.cumsum(winding) != 0)

    edge = np.flatnonzero(np.diff(inside, prepend=False, append=False))
    start, n = edge[::2], edge[1::2] - edge[::2]
    of = np.searchsorted(base, start, side="right") - 1
    order = np.lexsort([-n, of])
    start, n, of = start[order], n[order], of[order]
    y, x = np.divmod(start - base[of], stride[of])
    return _Shapes(low, extent, np.searchsorted(of, np.arange(n_shapes + 1)), y, x, n)


def _meetings(ends: np.ndarray, axis: int, offset: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edge, line and place along the line where edges meet the lines ``line + offset`` of a grid across an axis."""
    a, b = ends[:, 0, axis] - offset, ends[:, 1, axis] - offset
    first, last = np.ceil(np.minimum(a, b)).astype(np.int64), np.ceil(np.maximum(a, b)).astype(np.int64)  # half open
    n = last - first
    k = np.repeat(np.arange(len(ends)), n)
    line = first[k] + np.arange(len(k)) - np.repeat(np.cumsum(n) - n, n)
    t = (line - a[k]) / (b[k] - a[k])
    return k, line, ends[k, 0, 1 - axis] + t * (ends[k, 1, 1 - axis] - ends[k, 0, 1 - axis])


def _reach(padding: float) -> list[tuple[int, int]]:
    """Steps from one cell to another that leave less than ``padding`` cells between them: rows and half widths."""
    rows = []
    most = int(np.ceil(padding))
    for y in range(-most, most + 1):
        width = [x for x in range(most + 1) if np.hypot(max(x - 1, 0), max(abs(y) - 1, 0)) < padding - 1e-9]
        if width:
            rows.append((y, max(width)))
    return rows


@dataclass(frozen=True)
class _Placed:
    """
    Place and turn of every chart, (C, 2) in cells and (C,), and the rows that are used.
    """

    at: np.ndarray
    turn: np.ndarray
    top: int


def _place(shapes: _Shapes, order: np.ndarray, small: np.ndarray, n_cells: int, far: list[tuple[int, int]]) -> _Placed:
    """
    One chart after the other into the lowest place, and the turn, where it ends lowest.

    The grid is one long integer, a bit a cell, row after row: that a run of cells is free at every place at once takes
    two shifts. A wall to the right keeps charts from going on in the next row.
    """
    margin = max(abs(y) for y, _ in far)
    stride = n_cells + margin + 1
    wall = ((1 << (margin + 1)) - 1) << n_cells
    n_charts = len(order)
    at, turn = np.zeros((n_charts, 2)), np.zeros(n_charts, np.int64)
    taken, top, walled = 0, 0, 0
    runs = list(zip(shapes.y.tolist(), shapes.x.tolist(), shapes.n.tolist(), strict=True))
    first, extent = shapes.first.tolist(), shapes.extent.tolist()
    for c in order.tolist():
        highest = max(h for _, h in extent[c * _TURNS : (c + 1) * _TURNS])
        while walled < top + highest + 1:
            taken |= wall << (walled * stride)
            walled += 1
        free_of = [taken]  # bit p: cells p to p + 2^k - 1 hold something
        best = None
        shapes_of = range(c * _TURNS, (c + 1) * _TURNS, 2 if small[c] else 1)
        for s in sorted(shapes_of, key=lambda s: extent[s][1]):  # low ones tend to be best, and others then end early
            width, height = extent[s]
            if width > n_cells:
                continue
            blocked, score = 0, (0, 0, 0)
            for start in range(first[s], first[s + 1], _AT_ONCE):
                for y, x, n in runs[start : min(start + _AT_ONCE, first[s + 1])]:
                    k = n.bit_length() - 1
                    while len(free_of) <= k:
                        free_of.append(free_of[-1] | free_of[-1] >> (1 << (len(free_of) - 1)))
                    blocked |= free_of[k] >> (y * stride + x)
                    if n > 1 << k:
                        blocked |= free_of[k] >> (y * stride + x + n - (1 << k))
                place = (~blocked & (blocked + 1)).bit_length() - 1  # the lowest bit that is not set
                row, column = divmod(place, stride)
                score = (row + height, row, column)
                if best is not None and score >= best[0]:
                    break
            if best is None or score < best[0]:
                best = score, s - c * _TURNS, place
        if best is None:
            return _Placed(at, turn, 4 * n_cells)
        _, t, place = best
        row, column = divmod(place, stride)
        s = c * _TURNS + t
        own = 0
        for y, x, n in runs[first[s] : first[s + 1]]:
            own |= ((1 << n) - 1) << (y * stride + x)
        wide = [own]  # by so many cells to either side, moved right by as many
        for _ in range(margin):
            wide.append(wide[-1] | wide[-1] << 1 | wide[-1] << 2)
        around = 0
        for y, w in far:
            around |= wide[w] << ((y + margin) * stride + margin - w)
        around <<= place
        taken |= around >> (margin * stride + margin)
        at[c], turn[c] = (column, row), t
        top = max(top, row + extent[s][1])
    return _Placed(at, turn, top)
