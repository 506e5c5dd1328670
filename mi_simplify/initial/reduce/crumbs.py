"""
What becomes of components that collapses alone cannot bring into a budget: the least of them go, others become hulls.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from ...model.topology import area_vectors


def components(faces: np.ndarray, n_positions: int) -> np.ndarray:
    """
    Connected component of every position, shape (P,), int64: 0 … C - 1 for those of the faces, then unused positions.
    """
    used = np.unique(faces)
    graph = coo_array(
        (np.ones(2 * len(faces), bool), (faces[:, [0, 0]].ravel(), faces[:, 1:].ravel())), shape=(n_positions,) * 2
    )
    name = connected_components(graph, directed=False)[1]
    found, label = np.unique(name[used], return_inverse=True)
    out = np.full(n_positions, len(found), np.int64)
    out[used] = label
    return out


def without_crumbs(
    p: np.ndarray,
    faces: np.ndarray,
    weights: np.ndarray,
    n_triangles: int,
    label: np.ndarray,
    least: np.ndarray,
    price: float = np.inf,
    slack: float = np.inf,
) -> np.ndarray:
    """
    The faces without the components that cost less than a collapse of ``price``, cheapest first, down to the budget.

    What a component costs is its area times the square of its size, shared among its faces; a collapse removes two.
    Components with triangles set aside in ``least``, shape (C,), stay, and so does the dearest. Without a price, the
    last to go may leave up to ``slack`` triangles of the budget to spare.
    """
    names, cost, size = _costs(p, faces, weights, label)
    order = np.argsort(cost, kind="stable")[:-1]
    order = order[least[names[order]] == 0]
    left = len(faces) - np.cumsum(size[order])
    if np.isinf(price):
        goes = (left + size[order] > n_triangles) & (left >= n_triangles - slack)
    else:
        goes = (2 * cost[order] < price) & (left >= n_triangles)
    return faces[~np.isin(label[faces[:, 0]], names[order[goes]])]


def with_hulls(
    p: np.ndarray,
    faces: np.ndarray,
    weights: np.ndarray,
    n_triangles: int,
    label: np.ndarray,
    least: np.ndarray,
    decimate: Callable[[np.ndarray, np.ndarray, int], tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """
    Positions and faces with components, cheapest first, turned into convex hulls, down to the budget.

    Last resort for what many handles or joints hold together; a hull has at least 4 triangles, and what is set aside.
    A flat component becomes a rectangle. A single component is left alone: its hull would be another shape.
    """
    names, cost, size = _costs(p, faces, weights, label)
    if len(names) == 1:
        return p, faces
    p, excess, gone, new = p.copy(), len(faces) - n_triangles, [], []
    for k in np.argsort(cost, kind="stable"):
        target = max(4, int(least[names[k]]), int(size[k]) - excess)
        if excess <= 0 or target >= size[k]:
            continue
        own = np.unique(faces[label[faces[:, 0]] == names[k]])
        points, hull = _hull(p[own])
        if len(hull) > target:
            points, hull = decimate(points, hull, target)
        if len(hull) >= size[k] or len(points) > len(own):
            continue
        p[own[: len(points)]] = points
        gone.append(names[k])
        new.append(own[hull])
        excess -= int(size[k]) - len(hull)
    return p, np.concatenate([faces[~np.isin(label[faces[:, 0]], gone)], *new])


def _costs(
    p: np.ndarray, faces: np.ndarray, weights: np.ndarray, label: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Components that have faces, what the loss of each costs, and their faces."""
    names, component = np.unique(label[faces[:, 0]], return_inverse=True)
    c = p[faces]
    area = np.linalg.norm(area_vectors(c), axis=1) / 2
    area = np.bincount(component, area * weights[faces].mean(1))
    low, high = np.full((len(names), 3), np.inf), np.full((len(names), 3), -np.inf)
    np.minimum.at(low, component, c.min(1))
    np.maximum.at(high, component, c.max(1))
    size = np.bincount(component)
    return names, area * (((high - low) / 2) ** 2).sum(1) / size, size


def _hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces of the convex hull; of the rectangle around flat points."""
    centre = points.mean(0)
    _, spread, axes = np.linalg.svd(points - centre, full_matrices=False)
    if spread[-1] > 1e-6 * spread[0]:
        try:
            hull = ConvexHull(points)
        except QhullError:
            pass  # too flat for Qhull
        else:
            outwards = np.einsum("fi,fi->f", area_vectors(points[hull.simplices]), hull.equations[:, :3]) > 0
            faces = np.where(outwards[:, None], hull.simplices, hull.simplices[:, ::-1])
            used, faces = np.unique(faces, return_inverse=True)
            return points[used], faces.reshape(-1, 3)
    flat = (points - centre) @ axes[:2].T
    (left, bottom), (right, top) = flat.min(0), flat.max(0)
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    return centre + corners @ axes[:2], np.array([[0, 1, 2], [0, 2, 3]])
