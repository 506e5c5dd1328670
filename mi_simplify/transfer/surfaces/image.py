"""
Geometry images (Gu et al. 2002): a surface resampled to a grid of n × n vertices, the same ones in every pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from ...errors import MeshError
from ...initial.closest import ClosestPoints, sample_surface
from ...model.topology import area_vectors, vertex_normals
from .disc import Disc, make_disc
from .square import map_to_square, n_flipped, stretch

#: Points of each surface that the distance of the resampled one is measured at, beside the middles of the faces.
N_POINTS = 20_000


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
        out = vertex_normals(positions, used)[self.weld].astype(np.float32)
        n = self.n
        if (self.weld != np.arange(n**2)).any():
            # At the ends of a cut two triangles lie back to back, and at its middle, the other two corners, they are
            # slivers along it; pixels beside them know the direction.
            out[[0, -1]] = out[[1, -2]]
            out[[n - 1, n * (n - 1)]] = out[[n - 2, n * (n - 2)]]
        return out


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
    out[around] = np.minimum(around, np.roll(around[::-1], 1))
    return out


def _distances(positions: np.ndarray, faces: np.ndarray, grid: np.ndarray, cells: np.ndarray) -> tuple[float, float]:
    """Mean and largest distance between two surfaces, both ways, in diagonals; from points of both, spread by area."""
    both = np.concatenate([_to_surface(positions, faces, grid, cells), _to_surface(grid, cells, positions, faces)])
    both /= np.linalg.norm(np.ptp(positions, axis=0))
    return float(both.mean()), float(both.max())


def _to_surface(vertices: np.ndarray, faces: np.ndarray, others: np.ndarray, other_faces: np.ndarray) -> np.ndarray:
    """Distances of points of a surface to another one."""
    corners = vertices[faces]
    points, _ = sample_surface(corners, np.linalg.norm(area_vectors(corners), axis=1), N_POINTS, 0)
    return ClosestPoints(others, other_faces).query(points).distance
