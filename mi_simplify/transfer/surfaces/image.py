"""
Geometry images (Gu et al. 2002): a surface resampled to a grid of n × n vertices, the same ones in every pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from ...errors import MeshError
from ...model.topology import area_vectors, vertex_normals
from .disc import Disc, make_disc
from .square import map_to_square, n_flipped, stretch

#: Points that the distance of the resampled surface is measured at, at most.
MOST_POINTS = 40_000


@dataclass(frozen=True)
class GeometryImage:
    """
    How the pixels of an image follow a surface.

    Parameters
    ----------
    n : int
        Pixels a side.
    sampler : csr_array, shape (n², V)
        Rows of sum 1: which vertices of the surface a pixel lies between; row by row.
    weld : ndarray, shape (n²,), int64
        Pixels with the same number are one point: the two sides of a cut.
    figures : dict
        ``flipped`` triangles of the map, ``stretch`` (1 for an isometry), ``distance`` and ``worst_distance`` of the
        resampled surface [diagonals of the box], mean and maximum over points of both surfaces.
    notes : tuple of str
    """

    n: int
    sampler: csr_array
    weld: np.ndarray
    figures: dict[str, float]
    notes: tuple[str, ...] = ()

    @property
    def faces(self) -> np.ndarray:
        """Two triangles a cell over the pixels, shape (2 (n-1)², 3), counter-clockwise."""
        return grid_faces(self.n)

    def positions(self, vertices: np.ndarray) -> np.ndarray:
        """
        The pixels in poses of the surface.

        Parameters
        ----------
        vertices : ndarray, shape (..., V, 3)

        Returns
        -------
        ndarray, shape (..., n², 3), float32
        """
        vertices = np.asarray(vertices)
        flat = vertices.reshape(-1, *vertices.shape[-2:])
        out = np.stack([self.sampler @ frame.astype(np.float64) for frame in flat]).astype(np.float32)
        return out.reshape(*vertices.shape[:-2], self.n**2, 3)

    def normals(self, positions: np.ndarray) -> np.ndarray:
        """
        Unit normals of the pixels at positions (n², 3) of one pose, across the cut as well; shape (n², 3), float32.
        """
        faces = self.weld[self.faces]
        used = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
        return vertex_normals(positions, used)[self.weld].astype(np.float32)


def grid_faces(n: int) -> np.ndarray:
    """
    Two triangles for each cell of an n × n grid whose rows go up the square.
    """
    k = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return np.concatenate([np.stack([k, k + 1, k + n + 1], 1), np.stack([k, k + n + 1, k + n], 1)])


def geometry_image(
    positions: np.ndarray, faces: np.ndarray, n: int, *, close_holes: bool = False, what: str = "surface"
) -> GeometryImage:
    """
    Parameterise a surface over the square and sample it on a grid.

    Parameters
    ----------
    positions : ndarray, shape (V, 3)
        The pose that lengths and angles are taken from.
    faces : ndarray, shape (F, 3)
        One piece over welded positions, with one border, or closed and of genus 0.
    n : int
        Pixels a side, at least 4.
    close_holes : bool
        Close further borders, see :func:`.disc.make_disc`.
    what : str
        What the messages call it.

    Raises
    ------
    MeshError
        It has no such form; the message has the way out.
    """
    if not np.isfinite(positions).all():
        raise MeshError(f"{what}: finite positions expected, some are NaN or infinite; export it again")
    disc = make_disc(positions, faces, close_holes=close_holes, what=what)
    places = np.asarray(disc.source @ np.asarray(positions, np.float64))
    at = map_to_square(disc, places)
    sampler = csr_array(_sampler(disc, at, n) @ disc.source)
    weld = _weld(n) if disc.seam else np.arange(n * n)
    grid = np.asarray(sampler @ np.asarray(positions, np.float64))
    mean, worst = _distances(places, disc.faces, grid, grid_faces(n))
    figures = {
        "flipped": n_flipped(disc.faces, at), "stretch": stretch(disc.faces, places, at), "distance": mean,
        "worst_distance": worst,
    }  # fmt: skip
    return GeometryImage(n, sampler, weld, figures, disc.notes)


def _sampler(disc: Disc, at: np.ndarray, n: int) -> csr_array:
    """Barycentric weights, (n², V'), of the grid's points in the triangles of the square."""
    q = at[disc.faces] * (n - 1)
    low, high = np.floor(q.min(1) - 1e-6).astype(int), np.ceil(q.max(1) + 1e-6).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, n - 1)
    wide = high - low + 1
    counts = wide[:, 0] * wide[:, 1]
    face = np.repeat(np.arange(len(q)), counts)
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    x, y = low[face, 0] + within % wide[face, 0], low[face, 1] + within // wide[face, 0]
    w = _barycentric(q[face], np.stack([x, y], axis=1).astype(np.float64))
    point = y * n + x
    order = np.lexsort((w.min(1), point))
    last = np.flatnonzero(np.append(np.diff(point[order]) > 0, True))  # the triangle that holds it best
    best = order[last]
    w = np.maximum(w[best], 0)
    w /= w.sum(1, keepdims=True)
    rows = np.repeat(point[best], 3)
    return coo_array((w.ravel(), (rows, disc.faces[face[best]].ravel())), shape=(n * n, len(at))).tocsr()


def _barycentric(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Of points (N, 2) in triangles (N, 3, 2); far outside where a triangle has no area."""
    d1, d2, d = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0], p - q[:, 0]
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    safe = np.where(np.abs(area) > 1e-14, area, 1e-14)
    b = (d[:, 0] * d2[:, 1] - d[:, 1] * d2[:, 0]) / safe
    c = (d1[:, 0] * d[:, 1] - d1[:, 1] * d[:, 0]) / safe
    return np.stack([1 - b - c, b, c], axis=1)


def _weld(n: int) -> np.ndarray:
    """The border of the grid folded onto itself, from the corner at the origin around to it."""
    grid = np.arange(n * n).reshape(n, n)
    around = np.concatenate([grid[0, :-1], grid[:-1, -1], grid[-1, :0:-1], grid[:0:-1, 0]])
    out = np.arange(n * n)
    out[np.roll(around[::-1], 1)] = np.minimum(around, np.roll(around[::-1], 1))
    out[around] = np.minimum(out[around], np.roll(around[::-1], 1))
    return out


def _distances(
    positions: np.ndarray, faces: np.ndarray, grid: np.ndarray, cells: np.ndarray
) -> tuple[float, float]:
    """Mean and largest distance between two surfaces, both ways, in diagonals; from samples of both."""
    a, b = _spread(positions, faces), _spread(grid, cells)
    diagonal = np.linalg.norm(np.ptp(positions, axis=0))
    both = np.concatenate([_to_surface(a, b), _to_surface(b, a)]) / diagonal
    return float(both.mean()), float(both.max())


def _spread(positions: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points by area, and the normals there."""
    rng = np.random.default_rng(0)
    vectors = area_vectors(positions[faces])
    area = np.linalg.norm(vectors, axis=1)
    face = rng.choice(len(faces), MOST_POINTS, p=area / area.sum())
    u, v = rng.random((2, MOST_POINTS, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    p = positions[faces[face]]
    points = p[:, 0] + u * (p[:, 1] - p[:, 0]) + v * (p[:, 2] - p[:, 0])
    return points, vectors[face] / area[face, None]


def _to_surface(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Distances of points to another surface: to the planes through its nearest samples, never more than to these."""
    distance, nearest = cKDTree(b[0]).query(a[0], k=4)
    offset = a[0][:, None] - b[0][nearest]
    plane = np.abs(np.einsum("nki,nki->nk", offset, b[1][nearest]))
    spacing = distance[:, :1]
    return np.where(distance <= 2 * spacing + 1e-300, plane, distance).min(1)
