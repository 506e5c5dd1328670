"""
Faces grouped into clusters that lie near a plane each: what a textured card can stand for.

As in billboard clouds (Décoret et al. 2003) the faces are covered by few planes with little error; the planes are found
from the top down, by halving the worst cluster until the budget is spent. What hangs together, such as a leaf, is
divided only where it is alone in its cluster, and clusters never reach over the nodes that they start from.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...model.topology import area_vectors

#: Columns of moments: area, ∫p (3), ∫ppᵀ (6), ∫nnᵀ (6).
_N = 16
_PAIRS = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
_FULL = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])

#: What a square unit's distance to the middle of its cluster costs, beside its distance to the plane: cards that reach
#: far are mostly empty, and their texels large.
_SPREAD = 0.04


@dataclass(frozen=True)
class Clusters:
    """
    A plane for every face.

    Parameters
    ----------
    label : ndarray, shape (F,), int64
        Cluster of each face, from 0; -1 for faces without area.
    centre : ndarray, shape (C, 3)
        Centroids.
    axes : ndarray, shape (C, 3, 3)
        Rows: the long and the short direction in the plane and its normal, right-handed.
    growth : ndarray, shape (C,)
        By how much the mean projected area of the faces, over all directions, exceeds that of their image on the
        plane: Cauchy's formula, A / ∫|n·N|.
    """

    label: np.ndarray
    centre: np.ndarray
    axes: np.ndarray
    growth: np.ndarray

    def __len__(self) -> int:
        return len(self.centre)


def pieces(position_faces: np.ndarray, node: np.ndarray) -> np.ndarray:
    """
    Number of the connected piece of every face, shape (F,): faces that share positions and a node.

    Parameters
    ----------
    position_faces : ndarray, shape (F, 3)
        Over welded positions.
    node : ndarray, shape (F,), int64
        Placement or node that a face belongs to.
    """
    # A position that two nodes share is one of each.
    keys, corner = np.unique(
        position_faces.ravel() * np.int64(node.max() + 1) + np.repeat(node, 3), return_inverse=True
    )
    corner = corner.reshape(-1, 3)
    n = len(keys)
    graph = coo_array(
        (np.ones(2 * len(corner), bool), (corner[:, [0, 0]].ravel(), corner[:, 1:].ravel())), shape=(n, n)
    )
    _, label = connected_components(graph, directed=False)
    return np.unique(label[corner[:, 0]], return_inverse=True)[1]


def cluster_faces(triangles: np.ndarray, piece: np.ndarray, group: np.ndarray, n_clusters: int) -> Clusters:
    """
    Cover triangles by planes.

    Parameters
    ----------
    triangles : ndarray, shape (F, 3, 3)
        Corners in world space.
    piece : ndarray, shape (F,), int64
        What each belongs to, see :func:`pieces`.
    group : ndarray, shape (F,), int64
        Numbers from 0 of the nodes to start from; a piece lies in one.
    n_clusters : int
        At most so many.

    Returns
    -------
    Clusters
    """
    moments = _moments(triangles)
    piece_moments = np.stack([np.bincount(piece, column) for column in moments.T], 1)
    order = np.argsort(piece, kind="stable")
    bounds = np.searchsorted(piece[order], np.arange(len(piece_moments) + 1))
    first = np.full(len(piece_moments), -1)
    first[piece] = group
    has_area = piece_moments[:, 0] > 0
    scale2 = moments[:, 0].sum() / max(n_clusters, 1) / 4  # of a card's half side: what a turned face costs

    heap: list[tuple[float, int, bool, np.ndarray]] = []

    def push(members: np.ndarray, of_faces: bool) -> None:
        rows = moments if of_faces else piece_moments
        heapq.heappush(heap, (-float(_errors(rows[members].sum(0), scale2)), len(seen), of_faces, members))
        seen.append(None)

    seen: list[None] = []  # tells clusters of one error apart
    by_group = np.argsort(first, kind="stable")
    by_group = by_group[has_area[by_group]]
    for members in np.split(by_group, np.flatnonzero(np.diff(first[by_group])) + 1):
        push(members, False)
    done: list[tuple[float, int, bool, np.ndarray]] = []
    while heap and len(heap) + len(done) < n_clusters:
        entry = heapq.heappop(heap)
        _, _, of_faces, members = entry
        if not of_faces and len(members) == 1:
            of_faces, members = True, order[bounds[members[0]] : bounds[members[0] + 1]]
        halves = _halves(members, moments if of_faces else piece_moments, scale2)
        if halves is None:
            done.append(entry)
            continue
        for half in halves:
            push(half, of_faces)
    label = np.full(len(triangles), -1)
    total = np.empty((len(heap) + len(done), _N))
    of_piece = np.full(len(piece_moments), -1)
    for k, (_, _, of_faces, members) in enumerate(heap + done):
        total[k] = (moments if of_faces else piece_moments)[members].sum(0)
        if of_faces:
            label[members] = k
        else:
            of_piece[members] = k
    label = np.where(label < 0, of_piece[piece], label)
    label[moments[:, 0] <= 0] = -1
    return _planes(label, total, moments, triangles, scale2)


def _moments(triangles: np.ndarray) -> np.ndarray:
    """Of every triangle, shape (F, 16), exact."""
    total = triangles.sum(1)
    normal = area_vectors(triangles) / 2
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-300)[:, None]
    out = np.empty((len(triangles), _N))
    out[:, 0], out[:, 1:4] = area, total * (area / 3)[:, None]
    for k, (i, j) in enumerate(_PAIRS):
        out[:, 4 + k] = area / 12 * ((triangles[..., i] * triangles[..., j]).sum(1) + total[:, i] * total[:, j])
        out[:, 10 + k] = area * normal[:, i] * normal[:, j]
    return out


def _forms(m: np.ndarray, scale2: float) -> tuple[np.ndarray, np.ndarray]:
    """Covariance C and quadratic form C - s² ∫nnᵀ, whose least eigenvector is the normal of the best plane."""
    mean = m[..., 1:4] / np.maximum(m[..., :1], 1e-300)
    spread = m[..., 4:10][..., _FULL] - m[..., 1:4, None] * mean[..., None, :]
    return spread, spread - scale2 * m[..., 10:16][..., _FULL]


def _errors(m: np.ndarray, scale2: float) -> np.ndarray:
    """
    ``min over N of ∫ (N·d)² + s² (1 - (N·n)²)`` plus a share of ``∫ |d|²``, shape (...,): distance to the plane, area
    that the plane does not show, and extent.
    """
    spread, form = _forms(m, scale2)
    return np.linalg.eigvalsh(form)[..., 0] + scale2 * m[..., 0] + _SPREAD * np.trace(spread, axis1=-2, axis2=-1)


def _halves(members: np.ndarray, rows: np.ndarray, scale2: float) -> tuple[np.ndarray, np.ndarray] | None:
    """The best of a few ways to cut a cluster in two: across its axes, or by how its parts face."""
    if len(members) < 2:
        return None
    m = rows[members]
    total = m.sum(0)
    spread, form = _forms(total, scale2)
    mean = total[1:4] / total[0]
    _, axes = np.linalg.eigh(spread)
    _, planes = np.linalg.eigh(form)
    area = np.maximum(m[:, 0], 1e-300)
    where = (m[:, 1:4] / area[:, None] - mean) @ axes  # (n, 3)
    facing = np.einsum("nij,ik,jk->nk", m[:, 10:16][:, _FULL], planes, planes) / area[:, None]
    keys = np.concatenate([where, facing], 1)  # (n, 6)
    orders = np.argsort(keys, axis=0, kind="stable")
    best, halves = np.inf, None
    for order in orders.T:
        sums = np.cumsum(m[order], 0)
        cuts = np.unique(np.clip(np.searchsorted(sums[:, 0], total[0] * _CUTS), 0, len(members) - 2))
        errors = _errors(sums[cuts], scale2) + _errors(total - sums[cuts], scale2)
        k = int(errors.argmin())
        if errors[k] < best:
            best, halves = errors[k], (members[order[: cuts[k] + 1]], members[order[cuts[k] + 1 :]])
    return halves


#: Shares of the area at which a cluster may be cut.
_CUTS = np.array([0.2, 0.35, 0.5, 0.65, 0.8])


def _planes(
    label: np.ndarray, total: np.ndarray, moments: np.ndarray, triangles: np.ndarray, scale2: float
) -> Clusters:
    spread, form = _forms(total, scale2)
    normal = np.linalg.eigh(form)[1][..., 0]
    # The long direction within the plane: of the covariance without its normal part.
    flat = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    long = np.linalg.eigh(flat @ spread @ flat)[1][..., 2]
    long -= normal * np.einsum("ci,ci->c", long, normal)[:, None]
    long /= np.maximum(np.linalg.norm(long, axis=1, keepdims=True), 1e-300)
    lost = np.linalg.norm(long, axis=1) < 0.5  # a single straight sliver
    long[lost] = np.cross(normal[lost], np.eye(3)[np.abs(normal[lost]).argmin(1)])
    long[lost] /= np.linalg.norm(long[lost], axis=1, keepdims=True)
    axes = np.stack([long, np.cross(normal, long), normal], 1)
    used = label >= 0
    p = triangles[used]
    n = area_vectors(p) / 2
    shown = np.bincount(label[used], np.abs(np.einsum("fi,fi->f", n, normal[label[used]])), len(total))
    return Clusters(label, total[:, 1:4] / total[:, :1], axes, total[:, 0] / np.maximum(shown, 1e-12 * total[:, 0]))
