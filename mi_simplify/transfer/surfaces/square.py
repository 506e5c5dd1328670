"""
A disc mapped to the unit square: the border by arc length, the inside by a discrete harmonic map.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import spsolve

from ...model.topology import corner_angles
from .borders import half_edges
from .disc import Disc

#: Cotangent weights are at least this. Weights that are positive make every vertex a mean of its neighbours, so that no
#: triangle folds over in a convex square (Tutte 1963; Floater 2003).
LEAST_WEIGHT = 0.02

#: Corners of the square, counter-clockwise from the origin.
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def map_to_square(disc: Disc, positions: np.ndarray, rounds: int = 3) -> np.ndarray:
    """
    Where the vertices of a disc lie in the square.

    A harmonic map, then a few rounds in which the weights of each vertex's neighbours are divided by how much the map
    stretches there (Yoshizawa et al. 2004), as long as the stretch falls; the weights stay positive.

    Parameters
    ----------
    disc : Disc
    positions : ndarray, shape (V', 3)
        Of its vertices.
    rounds : int
        At most; 0 for the harmonic map itself.

    Returns
    -------
    ndarray, shape (V', 2), float64
        In [0, 1]; the border lies on the sides, and four of its vertices are the corners.
    """
    fixed = _border_places(positions[disc.border], disc.seam)
    weights = _cotangents(disc.faces, positions)
    out = _solved(weights, disc.border, fixed)
    best = stretch(disc.faces, positions, out)
    for _ in range(rounds):
        at = _vertex_stretch(disc.faces, positions, out)
        weights = weights.tocsr() @ coo_array((1 / at, (np.arange(len(at)),) * 2), shape=weights.shape).tocsr()
        trial = _solved(weights, disc.border, fixed)
        value = stretch(disc.faces, positions, trial)
        if not value < best:
            break
        out, best = trial, value
    return out


def face_stretch(faces: np.ndarray, positions: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    How far each triangle of the square is stretched onto the surface, root mean square over directions (Sander et al.
    2001), infinite where it has no area; and the areas on the surface, both shape (F,).
    """
    p, q = positions[faces], at[faces]
    d1, d2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    area = (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 2
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    safe = np.where(area > 0, 2 * area, np.nan)[:, None]
    s = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) / safe
    t = (e2 * d1[:, :1] - e1 * d2[:, :1]) / safe
    value = np.sqrt(((s**2).sum(1) + (t**2).sum(1)) / 2)
    return np.where(np.isfinite(value), value, np.inf), np.linalg.norm(np.cross(e1, e2), axis=1) / 2


def stretch(faces: np.ndarray, positions: np.ndarray, at: np.ndarray) -> float:
    """
    Stretch of the whole map, 1 for an isometry up to scale; root mean square by area on the surface.
    """
    value, area = face_stretch(faces, positions, at)
    flat = np.abs(_signed_areas(faces, at)).sum()
    return float(np.sqrt((value**2 * area).sum() / area.sum()) * np.sqrt(flat / area.sum()))


def n_flipped(faces: np.ndarray, at: np.ndarray) -> int:
    """
    How many triangles are folded over in the square, or have no area there.
    """
    return int(np.count_nonzero(_signed_areas(faces, at) <= 0))


def _signed_areas(faces: np.ndarray, at: np.ndarray) -> np.ndarray:
    q = at[faces]
    d1, d2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    return (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 2


def _vertex_stretch(faces: np.ndarray, positions: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Mean over the triangles around each vertex, by area, scaled to a mean of 1."""
    value, area = face_stretch(faces, positions, at)
    value = np.minimum(value, 1e3 * np.median(value))
    n = len(at)
    total = sum(np.bincount(faces[:, k], value * area, n) for k in range(3))
    out = total / np.maximum(sum(np.bincount(faces[:, k], area, n) for k in range(3)), 1e-300)
    return np.maximum(out / out.mean(), 1e-3)


def _cotangents(faces: np.ndarray, positions: np.ndarray) -> csr_array:
    """Symmetric weights of the edges, half the sum of the cotangents of the angles opposite, clamped."""
    angles = np.clip(corner_angles(positions, faces), 1e-4, np.pi - 1e-4)
    cot = np.concatenate([(0.5 / np.tan(angles[:, k])) for k in (2, 0, 1)])
    i, j = half_edges(faces).T
    n = len(positions)
    both = coo_array((np.concatenate([cot, cot]), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n))
    both = both.tocsr()
    both.sum_duplicates()
    both.data = np.clip(both.data, LEAST_WEIGHT, 1 / LEAST_WEIGHT)
    return both


def _solved(weights: csr_array, border: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Every inner vertex the weighted mean of its neighbours."""
    n = weights.shape[0]
    inner = np.setdiff1d(np.arange(n), border)
    out = np.zeros((n, 2))
    out[border] = fixed
    weights = weights.tocsr()
    row_sums = np.asarray(weights.sum(axis=1)).ravel()[inner]
    matrix = coo_array((row_sums, (np.arange(len(inner)),) * 2), shape=(len(inner),) * 2) - weights[inner][:, inner]
    right = weights[inner][:, border] @ fixed
    if len(inner):
        out[inner] = np.asarray(spsolve(matrix.tocsc(), right)).reshape(-1, 2)
    return out


def _border_places(points: np.ndarray, seam: bool) -> np.ndarray:
    """
    Places of border vertices (B, 3) on the sides of the square, by arc length within each side.

    The vertices next to the quarters of the whole length become corners; along a cut the same on both of its sides.
    """
    n = len(points)
    arcs = np.concatenate([[0], np.cumsum(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1))])
    whole = arcs[-1]
    quarter = int(np.clip(np.argmin(np.abs(arcs[:-1] - whole / 4)), 1, n - 3))
    if seam:
        corners = [0, quarter, n // 2, n - quarter]
    else:
        half = int(np.clip(np.argmin(np.abs(arcs[:-1] - whole / 2)), quarter + 1, n - 2))
        corners = [0, quarter, half, int(np.clip(np.argmin(np.abs(arcs[:-1] - 3 * whole / 4)), half + 1, n - 1))]
    out = np.empty((n, 2))
    for k, (start, end) in enumerate(zip(corners, [*corners[1:], n], strict=True)):
        share = (arcs[start:end] - arcs[start]) / (arcs[end] - arcs[start])
        out[start:end] = _CORNERS[k] + share[:, None] * (_CORNERS[(k + 1) % 4] - _CORNERS[k])
    return out
