"""
Charts laid flat: disks of triangles, many at once, brought to the plane with little stretch and without a flip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from ...model.topology import area_vectors, corner_angles

_PAIRS = 2_000_000
"""Pairs of border edges that are looked at in one go; bounds the memory to some hundred megabytes."""
_THINNEST = 1e-3
"""Least height of a triangle over its longest edge; flatter ones are laid out as if they had so much."""


@dataclass(frozen=True)
class Flat:
    """
    Charts in the plane.

    Parameters
    ----------
    uvs : ndarray, shape (V, 2), float64
        In the units of the positions; every chart has the area that it has in space.
    stretch : ndarray, shape (C,)
        L2 stretch (Sander et al. 2001) of every chart; 1 is an isometry, infinite where it could not be laid flat.
    overlaps : ndarray, shape (C,), bool
        Whether the border of a chart crosses itself.
    """

    uvs: np.ndarray
    stretch: np.ndarray
    overlaps: np.ndarray


def flatten(positions: np.ndarray, faces: np.ndarray, chart: np.ndarray, *, iterations: int = 15) -> Flat:
    """
    Lay disks flat: Tutte's embedding on a circle, then scalable locally injective maps (Rabinovich et al. 2017).

    Parameters
    ----------
    positions : ndarray, shape (V, 3)
        Of vertices that belong to one chart each.
    faces : ndarray, shape (F, 3)
        Indices into ``positions``.
    chart : ndarray, shape (F,)
        Chart of every face, from 0; each must be a disk, whose border visits a vertex once.
    iterations : int
        Steps of the symmetric Dirichlet energy.
    """
    rest = _rest_shapes(positions[faces])
    n_charts = int(chart.max()) + 1
    owner = np.zeros(len(positions), np.int64)
    owner[faces] = chart[:, None]
    border = border_loops(faces)
    uvs = _tutte(positions, faces, chart, border, rest, owner, n_charts)
    uvs = _least_stretch(uvs, faces, chart, rest, owner, iterations)
    stretch, scale = _stretches(uvs, faces, chart, rest, n_charts)
    uvs = uvs * scale[owner][:, None]
    return Flat(uvs, stretch, _self_crossings(uvs, border, owner, n_charts))


def border_loops(faces: np.ndarray) -> np.ndarray:
    """
    Half-edges that have no opposite one, shape (B, 2): from a vertex to the next, counter-clockwise.
    """
    n = int(faces.max(initial=-1)) + 1
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    alone = ~np.isin(a * n + b, b * n + a)
    return np.stack([a[alone], b[alone]], 1)


@dataclass(frozen=True)
class _Rest:
    """Triangles in their own plane: gradients of the three hat functions (F, 3, 2) and areas (F,)."""

    gradients: np.ndarray
    area: np.ndarray


def _rest_shapes(p: np.ndarray) -> _Rest:
    """Corner 0 in the origin, corner 1 on the x axis; triangles without height get a little."""
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    longest = np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2).max(1)
    longest = np.maximum(longest, 1e-9 * max(float(longest.max(initial=0)), 1e-30))
    x1 = np.maximum(np.linalg.norm(e1, axis=1), _THINNEST * longest)
    x2 = np.einsum("fi,fi->f", e1, e2) / x1
    y2 = np.maximum(np.linalg.norm(area_vectors(p), axis=1) / x1, _THINNEST * longest)
    inverse = np.zeros((len(p), 2, 2))  # of the matrix whose columns are the two edges
    inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1] = 1 / x1, -x2 / (x1 * y2), 1 / y2
    gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], 1)
    return _Rest(gradients, x1 * y2 / 2)


def _tutte(positions, faces, chart, border, rest, owner, n_charts) -> np.ndarray:
    """Borders on circles, by length; inside by mean value weights (Floater 2003), which are positive."""
    n = len(positions)
    following = np.full(n, -1)
    following[border[:, 0]] = border[:, 1]
    length = np.zeros(n)
    length[border[:, 0]] = np.linalg.norm(positions[border[:, 1]] - positions[border[:, 0]], axis=1) + 1e-12
    start = np.full(n_charts, n)
    np.minimum.at(start, owner[border[:, 0]], border[:, 0])
    total = np.bincount(owner, length, n_charts)
    length += 0.01 * (total / np.maximum(np.bincount(owner[border[:, 0]], minlength=n_charts), 1))[owner]
    total = np.bincount(owner, np.where(following >= 0, length, 0), n_charts)
    arc = np.full(n, np.nan)
    at, sum_ = start.copy(), np.zeros(n_charts)
    going = np.arange(n_charts)
    while len(going):  # a step along every border at once
        arc[at[going]] = sum_[going] / total[going]
        sum_[going] += length[at[going]]
        at[going] = following[at[going]]
        going = going[at[going] != start[going]]
    radius = np.sqrt(np.bincount(chart, rest.area, n_charts) / np.pi)[owner]
    uvs = np.stack([np.cos(2 * np.pi * arc), np.sin(2 * np.pi * arc)], 1) * radius[:, None]
    inner = np.flatnonzero(np.isnan(arc))
    if len(inner):
        half = np.tan(np.clip(corner_angles(positions, faces), 1e-3, np.pi - 1e-3) / 2)
        p = positions[faces]
        ends = np.concatenate([np.stack([faces, np.roll(faces, s, axis=1)], -1).reshape(-1, 2) for s in (-1, 1)])
        long = np.concatenate([np.linalg.norm(np.roll(p, s, axis=1) - p, axis=2).ravel() for s in (-1, 1)])
        weight = np.concatenate([half.ravel(), half.ravel()]) / np.maximum(long, 1e-6 * long.max())
        w = coo_array((weight, (ends[:, 0], ends[:, 1])), shape=(n, n)).tocsr()
        laplacian = coo_array((w.sum(1), (np.arange(n), np.arange(n))), shape=(n, n)).tocsr() - w
        rim = np.flatnonzero(~np.isnan(arc))
        rows = laplacian[inner]
        uvs[inner] = splu(rows[:, inner].tocsc()).solve(-(rows[:, rim] @ uvs[rim]))
    return uvs


def _jacobians(uvs: np.ndarray, faces: np.ndarray, rest: _Rest) -> np.ndarray:
    """Of the map from the rest shapes to the plane, shape (F, 2, 2)."""
    return np.einsum("fkm,fkj->fmj", uvs[faces], rest.gradients)


def _energy(uvs, faces, rest) -> np.ndarray:
    """Symmetric Dirichlet energy of every face, infinite where it is flipped."""
    j = _jacobians(uvs, faces, rest)
    det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
    square = (j**2).sum((1, 2))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(det > 1e-12, rest.area * (square + square / det**2), np.inf)


def _least_stretch(uvs, faces, chart, rest, owner, iterations) -> np.ndarray:
    """Steps of SLIM, each chart with a step length of its own; a chart that begins with a flip stays as it is."""
    n, n_charts = len(uvs), int(chart.max()) + 1
    energy = np.bincount(chart, _energy(uvs, faces, rest), n_charts)
    moving = np.isfinite(energy)
    k = faces[:, :, None] + n * np.arange(2)  # (F, 3, 2): unknown of a corner's coordinate
    rows = np.broadcast_to(k[:, :, :, None, None], (len(faces), 3, 2, 3, 2)).ravel()
    cols = np.broadcast_to(k[:, None, None], (len(faces), 3, 2, 3, 2)).ravel()
    stiffness = np.einsum("fkj,flj->fkl", rest.gradients, rest.gradients) * rest.area[:, None, None]
    diagonal = np.arange(2 * n)
    mean_area = rest.area.mean()
    for _ in range(iterations):
        u, s, vt = np.linalg.svd(np.where(moving[chart][:, None, None], _jacobians(uvs, faces, rest), np.eye(2)))
        s = np.maximum(s, 1e-6)
        near = np.abs(s - 1) < 1e-4
        with np.errstate(divide="ignore", invalid="ignore"):
            w = np.where(near, 4.0, (s - s**-3) / np.where(near, 1, s - 1))
        w = np.minimum(w, 1e8)
        ww = np.einsum("fmi,fi,fni->fmn", u, w, u)  # the square of SLIM's weight
        target = np.einsum("fmn,fnj->fmj", ww, u @ vt)
        blocks = np.einsum("fkl,fmn->fkmln", stiffness, ww)
        damping = 1e-6 * mean_area / max(float(rest.area.sum()), 1e-300)
        a = coo_array((blocks.ravel(), (rows, cols)), shape=(2 * n, 2 * n))
        diag = np.bincount(diagonal, minlength=2 * n) * 0.0 + np.maximum(a.diagonal(), 1e-12) * 1e-6 + damping * 1e-6
        a = (a + coo_array((diag, (diagonal, diagonal)), shape=(2 * n, 2 * n))).tocsc()
        right = np.bincount(
            k.ravel(), np.einsum("fmj,fkj,f->fkm", target, rest.gradients, rest.area).ravel(), minlength=2 * n
        )
        solution = splu(a, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
            right + diag * uvs.T.ravel()
        )
        step = solution.reshape(2, n).T - uvs
        step[~np.isfinite(step).all(1)] = 0
        alpha = np.where(moving, np.minimum(1.0, 0.9 * _first_flip(uvs, step, faces, chart, n_charts)), 0.0)
        for _ in range(8):
            moved = uvs + alpha[owner][:, None] * step
            after = np.bincount(chart, _energy(moved, faces, rest), n_charts)
            worse = (after > energy) & (alpha > 0)
            if not worse.any():
                break
            alpha[worse] /= 2
        alpha[after > energy] = 0
        uvs = uvs + alpha[owner][:, None] * step
        before, energy = energy, np.minimum(after, energy)
        with np.errstate(invalid="ignore"):
            if not (before[moving] - energy[moving] > 1e-4 * before[moving]).any():
                break
    return uvs


def _first_flip(uvs, step, faces, chart, n_charts) -> np.ndarray:
    """Step length at which the first triangle of a chart loses its area (Smith and Schaefer 2015), shape (C,)."""
    q, d = uvs[faces], step[faces]
    q1, q2, d1, d2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0], d[:, 1] - d[:, 0], d[:, 2] - d[:, 0]
    c, a = cross(q1, q2), cross(d1, d2)
    b = cross(q1, d2) + cross(d1, q2)
    inside = b * b - 4 * a * c
    root = np.sqrt(np.maximum(inside, 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        # c > 0: the stable form 2c / (-b ± root) has its least positive value where the denominator is largest
        t = np.where((inside >= 0) & (root - b > 0), 2 * c / (root - b), np.inf)
    out = np.full(n_charts, np.inf)
    np.minimum.at(out, chart, np.where(t > 0, t, np.inf))
    return out


def _stretches(uvs, faces, chart, rest, n_charts) -> tuple[np.ndarray, np.ndarray]:
    """L2 stretch of every chart at the area that it has in space, and the factor that brings it there."""
    j = _jacobians(uvs, faces, rest)
    det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
    area = np.bincount(chart, rest.area, n_charts)
    flat = np.bincount(chart, rest.area * np.maximum(det, 0), n_charts)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.where(det > 1e-12, (j**2).sum((1, 2)) / det**2 / 2, np.inf)
        scale = np.sqrt(area / flat)
        stretch = np.sqrt(np.bincount(chart, rest.area * square, n_charts) / area) / scale
    bad = ~np.isfinite(stretch) | ~np.isfinite(scale)
    return np.where(bad, np.inf, stretch), np.where(bad, 1.0, scale)


def _self_crossings(uvs, border, owner, n_charts) -> np.ndarray:
    """
    Whether the border of a chart crosses itself, shape (C,); a map without flips whose border does not is injective.
    """
    of = owner[border[:, 0]]
    border, of = border[np.argsort(of, kind="stable")], np.sort(of)
    counts = np.bincount(of, minlength=n_charts)
    first = np.cumsum(counts) - counts
    pairs = counts[of]  # every edge with all of its chart
    out = np.zeros(n_charts, bool)
    ends = np.cumsum(pairs)
    start = 0
    while start < len(border):
        before = int(ends[start - 1]) if start else 0
        stop = max(int(np.searchsorted(ends, before + _PAIRS)), start + 1)
        i = np.repeat(np.arange(start, stop), pairs[start:stop])
        j = (
            first[of[i]]
            + np.arange(len(i))
            - np.repeat(ends[start:stop] - pairs[start:stop] - before, pairs[start:stop])
        )
        later = j > i
        i, j = i[later], j[later]
        apart = (border[i][:, :, None] != border[j][:, None]).all((1, 2))  # neighbours share an end
        i, j = i[apart], j[apart]
        a, b, c, d = uvs[border[i, 0]], uvs[border[i, 1]], uvs[border[j, 0]], uvs[border[j, 1]]
        hit = (cross(b - a, c - a) * cross(b - a, d - a) <= 0) & (cross(d - c, a - c) * cross(d - c, b - c) <= 0)
        out[of[i[hit]]] = True
        start = stop
    return out


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """
    Cross product of vectors of the plane, shape (..., 2).
    """
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
