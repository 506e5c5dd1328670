"""
Fewer triangles for a welded mesh: edge collapse by quadric errors, many independent edges at a time.

Garland and Heckbert 1997, mostly with the memoryless quadrics of Hoppe 1999: the error of a collapse is measured
against the triangles as they are now, weighted by area. At equal counts the surface is a third closer to the original
than with quadrics accumulated since the beginning; a tenth of those is mixed in, because without any memory thin tips
wear away. Works on any triangle set: open edges and edges of more than two faces carry quadrics of their own, so that
borders and joints stay where they are.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from ...errors import MeshError
from ...model.topology import area_vectors

_LENIENCE = ((0.15, 0.2, 0.02), (0.5, 0.2, 0.02), (1.0, 0.2, 0.02), (1.0, 0.0, 0.0), (1.0, -1.0, 0.0))
"""
Share of the edges, cheapest first, that may collapse in one round, how far a face may turn (cosine), and the least
height of a face over its length; each row is for where nothing could be collapsed by the one before.
"""
_BORDER = 10.0
"""Weight of the planes that hold open and non-manifold edges in place, against a face plane of the same size."""
_LEAST_IMPORTANCE = 0.02
"""What nobody sees still has a shape."""
_MEMORY = 0.1
"""Share of the quadrics accumulated since the beginning."""
_TIP = (0.3, 0.7)
"""From the first to the second share of missing angle a vertex counts as the tip of a spike, which should stay."""
_TIP_PULL = 0.03
"""How much of that weight also pulls the new vertex to the tip; planes that meet in a point should win."""
_ANCHOR = 1e-4
"""Pull towards the middle of the edge where the quadric leaves a direction free, as a share of its trace."""
_LENGTH = 1e-6
"""Cost of collapsing a long edge in a flat region, as a share of what a bent one costs."""


def decimate(
    positions: np.ndarray, faces: np.ndarray, n_triangles: int, importance: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """
    At most ``n_triangles`` triangles that follow a surface.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
        Welded positions, any unit and offset.
    faces : ndarray, shape (F, 3)
        Indices into ``positions``, wound alike; no two over the same three positions.
    n_triangles : int
        Budget, at least 4. A small component goes as a whole where that costs less than the next collapses, and the
        smallest ones where nothing can be collapsed any more.
    importance : ndarray, shape (P,), optional
        How much an error counts around each position, 1 if not given.

    Returns
    -------
    positions : ndarray, shape (Q, 3), float64
    faces : ndarray, shape (G, 3), int64

    Raises
    ------
    MeshError
        The budget is below 4, or less than the components of the mesh need.
    """
    if n_triangles < 4:
        raise MeshError(f"a budget of {n_triangles} triangles is too small; ask for at least 4")
    positions, faces = np.asarray(positions, np.float64), np.asarray(faces, np.int64)
    centre = positions[np.unique(faces)].mean(0)
    scale = 1 / np.ptp(positions[np.unique(faces)], axis=0).max()
    p = (positions - centre) * scale
    weights = np.ones(len(p)) if importance is None else np.maximum(importance, _LEAST_IMPORTANCE)
    past, patience = None, 0
    while len(faces) > n_triangles:
        mesh = _Round(p, faces, weights, past)
        chosen, targets, price = mesh.choose(len(faces) - n_triangles, *_LENIENCE[patience])
        if len(chosen):
            patience = 0
            p, faces, weights, past = mesh.collapse(chosen, targets)
            if len(faces) < 4 * n_triangles:
                faces = _without_crumbs(p, faces, weights, n_triangles, price)
        elif patience + 1 < len(_LENIENCE):
            patience += 1
        else:
            faces = _without_crumbs(p, faces, weights, n_triangles)
    used, faces = np.unique(faces, return_inverse=True)
    return p[used] / scale + centre, faces.reshape(-1, 3)


class _Round:
    """
    The mesh before one round of collapses: edges, adjacency, quadrics.
    """

    def __init__(self, p: np.ndarray, faces: np.ndarray, weights: np.ndarray, past: np.ndarray | None = None):
        self.p, self.faces, self.weights, self.n = p, faces, weights, len(p)
        start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        key = np.minimum(start, end) * self.n + np.maximum(start, end)
        self.key, first, self.counts = np.unique(key, return_index=True, return_counts=True)
        self.edges = np.stack([self.key // self.n, self.key % self.n], 1)  # (E, 2)
        # incidence vertex → faces, and vertex → neighbours, as compressed rows
        self.corner = np.argsort(start, kind="stable")
        self.valence = np.bincount(start, minlength=self.n)
        self.first_corner = np.cumsum(self.valence) - self.valence
        both = np.concatenate([self.edges[:, 0], self.edges[:, 1]])
        order = np.argsort(both, kind="stable")
        self.neighbour = np.concatenate([self.edges[:, 1], self.edges[:, 0]])[order]
        self.degree = np.bincount(both, minlength=self.n)
        self.first_neighbour = np.cumsum(self.degree) - self.degree
        now = self._quadrics(first // 3)
        self.past = now if past is None else past
        self.quadrics = (1 - _MEMORY) * now + _MEMORY * self.past

    def _quadrics(self, a_face: np.ndarray) -> np.ndarray:
        """One quadric a vertex, shape (P, 10): A00 A01 A02 A11 A12 A22, b, c of xᵀAx + 2bᵀx + c."""
        p = self.p[self.faces]
        normal = area_vectors(p)
        length = np.linalg.norm(normal, axis=1)
        normal /= np.maximum(length, 1e-300)[:, None]
        share = length / 6 * self.weights[self.faces].mean(1)  # a third of the area to each corner
        planes = _planes(normal, p[:, 0], share)
        indptr = np.append(self.first_corner, len(self.corner))
        gather = csr_array((np.ones(len(self.corner)), self.corner // 3, indptr), shape=(self.n, len(self.faces)))
        quadrics = gather @ planes
        rim = self.counts != 2
        self.hold = gather @ share * self._pointedness(p, length, rim)
        if rim.any():
            a, b = self.p[self.edges[rim].T]
            along = b - a
            across = np.cross(along, normal[a_face[rim]])
            length2 = np.einsum("ei,ei->e", along, along)
            across /= np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
            planes = _planes(across, a, _BORDER * length2 * self.weights[self.edges[rim]].mean(1))
            for k in range(2):
                np.add.at(quadrics, self.edges[rim, k], planes)
        return quadrics

    def _pointedness(self, corners: np.ndarray, double_area: np.ndarray, rim: np.ndarray) -> np.ndarray:
        """
        0 for a vertex in a surface, 1 for the tip of a spike, by the angle that its corners lack, shape (P,).

        The planes around a tip hold it across, but hardly along its axis, so that spikes would be eaten up from there.
        """
        a, b = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        angle = np.arctan2(np.broadcast_to(double_area[:, None], a.shape[:2]), np.einsum("fci,fci->fc", a, b))
        full = np.full(self.n, 2 * np.pi)
        full[self.edges[rim].ravel()] = np.pi
        lack = 1 - np.bincount(self.faces.ravel(), angle.ravel(), self.n) / full
        t = np.clip((lack - _TIP[0]) / (_TIP[1] - _TIP[0]), 0, 1)
        return t * t * (3 - 2 * t)

    def choose(self, n_remove: int, share: float, turn: float, thin: float) -> tuple[np.ndarray, np.ndarray, float]:
        """
        Edges to collapse together, none next to another, cheapest first; where they go, shape (S, 3); the highest cost.

        No more of them than remove ``n_remove`` faces (the last one may remove one more).
        """
        a, b = self.edges.T
        quadric = self.quadrics[a] + self.quadrics[b]
        middle, along = (self.p[a] + self.p[b]) / 2, self.p[a] - self.p[b]
        weight = quadric[:, 0] + quadric[:, 3] + quadric[:, 5]
        hold = np.stack([self.hold[a], self.hold[b]])
        pulls = np.stack([_ANCHOR * weight + 1e-30, *(_TIP_PULL * hold)])
        anchor = np.einsum("ke,kei->ei", pulls / pulls.sum(0), [middle, self.p[a], self.p[b]])
        target = _minimise(quadric, anchor, pulls.sum(0))
        cost = np.maximum(_evaluate(quadric, target), 0) + _LENGTH * weight * np.einsum("ei,ei->e", along, along)
        for end, w in zip((a, b), hold, strict=True):
            cost += w * ((target - self.p[end]) ** 2).sum(1)

        k = min(len(cost), max(64, int(share * len(cost))))
        left = np.argpartition(cost, k - 1)[:k]
        left = left[np.argsort(cost[left], kind="stable")]  # a place in this list is the rank of an edge
        taken = np.zeros(self.n, bool)
        chosen = []
        checked = False
        for _ in range(4):
            rank = np.arange(len(left))
            best = np.full(self.n, len(left))
            for end in self.edges[left].T:
                np.minimum.at(best, end, rank)
            around = best.copy()
            np.minimum.at(around, a, best[b])
            np.minimum.at(around, b, best[a])
            winner = (around[self.edges[left]] == rank[:, None]).all(1)
            good = left[winner]
            if not checked:
                good = good[self._allowed(good, target[good], turn, thin)]
            chosen.append(good)
            ends = self.edges[good].ravel()
            taken[ends] = True
            taken[self.neighbour[_rows(self.first_neighbour[ends], self.degree[ends])[0]]] = True
            stuck = len(good) < 0.5 * winner.sum()
            left = left[~winner & ~taken[self.edges[left]].any(1)]
            if stuck and len(left):  # edges that must not collapse stand in the way of those that may
                left, checked = left[self._allowed(left, target[left], turn, thin)], True
            if not len(left):
                break
        found = np.concatenate(chosen)
        found = found[np.argsort(cost[found], kind="stable")]
        gone = np.cumsum(self.counts[found])
        found = found[: int(np.searchsorted(gone, n_remove)) + 1]
        return found, target[found], float(cost[found[-1]]) if len(found) else 0.0

    def _allowed(self, edges: np.ndarray, target: np.ndarray, turn: float, thin: float) -> np.ndarray:
        """Which collapses keep the topology, turn no face over and make no needles, shape (S,)."""
        a, b = self.edges[edges].T
        # link condition: the ends share no neighbours but those of their common faces
        index, owner = _rows(self.first_neighbour[a], self.degree[a])
        w, other = self.neighbour[index], b[owner]
        key = np.minimum(w, other) * self.n + np.maximum(w, other)
        place = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        common = np.bincount(owner[self.key[place] == key], minlength=len(edges))
        counts = self.counts[edges]
        ok = common == counts
        on_rim = np.zeros(self.n, bool)
        on_rim[self.edges[self.counts != 2].ravel()] = True
        ok &= ~(on_rim[a] & on_rim[b] & (counts == 2))  # would pinch two borders together
        ok &= self.valence[a] + self.valence[b] - 2 * counts > 2  # a tetrahedron is the end
        for moved, fixed in ((a, b), (b, a)):
            index, owner = _rows(self.first_corner[moved], self.valence[moved])
            face, k = self.corner[index] // 3, self.corner[index] % 3
            stays = ~(self.faces[face] == fixed[owner][:, None]).any(1)
            face, k, owner = face[stays], k[stays], owner[stays]
            p = self.p[self.faces[face]]
            before = area_vectors(p)
            p[np.arange(len(p)), k] = target[owner]
            after = area_vectors(p)
            size, new_size = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
            longest = ((np.roll(p, -1, axis=1) - p) ** 2).sum(2).max(1)
            bad = np.einsum("fi,fi->f", before, after) < turn * size * new_size
            bad |= (new_size < thin * longest) & (new_size < 0.5 * size)  # becomes a needle
            ok &= np.bincount(owner[bad], minlength=len(edges)) == 0
        return ok

    def collapse(self, edges: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Positions, faces, weights and accumulated quadrics after the edges have become their targets."""
        a, b = self.edges[edges].T
        p, weights, past = self.p.copy(), self.weights.copy(), self.past.copy()
        p[a] = target
        weights[a] = (weights[a] + weights[b]) / 2
        past[a] += past[b]
        name = np.arange(self.n)
        name[b] = a
        f = name[self.faces]
        return p, f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])], weights, past


def _rows(first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries ``first[i] … first[i] + count[i] - 1`` of all i in one list, and the i of each."""
    owner = np.repeat(np.arange(len(count)), count)
    return np.arange(len(owner)) - np.repeat(np.cumsum(count) - count - first, count), owner


def _planes(normal: np.ndarray, point: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Quadrics of squared distances to planes, shape (N, 10)."""
    n, d = normal, -np.einsum("ni,ni->n", normal, point)
    rows = [n * n[:, :1], n[:, 1:] * n[:, 1:2], n[:, 2:] * n[:, 2:], n * d[:, None], (d * d)[:, None]]
    return np.concatenate(rows, 1) * weight[:, None]


def _evaluate(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    x, y, z = x.T
    square = q[:, 0] * x * x + q[:, 3] * y * y + q[:, 5] * z * z
    mixed = q[:, 1] * x * y + q[:, 2] * x * z + q[:, 4] * y * z + q[:, 6] * x + q[:, 7] * y + q[:, 8] * z
    return square + 2 * mixed + q[:, 9]


def _minimise(q: np.ndarray, anchor: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """Where quadrics are least, with a weak pull to ``anchor`` (Cramer's rule; the pull keeps it solvable)."""
    a, b, c, d, e, f = q[:, 0] + pull, q[:, 1], q[:, 2], q[:, 3] + pull, q[:, 4], q[:, 5] + pull
    x, y, z = (pull[:, None] * anchor - q[:, 6:9]).T
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    m11, m12, m22 = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * m00 + b * m01 + c * m02
    point = np.stack([m00 * x + m01 * y + m02 * z, m01 * x + m11 * y + m12 * z, m02 * x + m12 * y + m22 * z], 1)
    return np.where(determinant[:, None] > 0, point / np.maximum(determinant, 1e-300)[:, None], anchor)


def _without_crumbs(
    p: np.ndarray, faces: np.ndarray, weights: np.ndarray, n_triangles: int, price: float = np.inf
) -> np.ndarray:
    """
    The faces without the components that cost less than a collapse of ``price``, cheapest first, down to the budget.

    What a component costs is its area times the square of its size, shared among its faces; a collapse removes two.
    """
    graph = coo_array((np.ones(2 * len(faces)), (faces[:, [0, 0]].ravel(), faces[:, 1:].ravel())), shape=(len(p),) * 2)
    _, label = connected_components(graph, directed=False)
    names, component = np.unique(label[faces[:, 0]], return_inverse=True)
    if len(names) == 1:
        if np.isinf(price):
            raise MeshError(f"this surface cannot be reduced below {len(faces)} triangles; ask for at least as many")
        return faces
    c = p[faces]
    area = np.linalg.norm(area_vectors(c), axis=1) / 2
    area = np.bincount(component, area * weights[faces].mean(1))
    low, high = np.full((len(names), 3), np.inf), np.full((len(names), 3), -np.inf)
    np.minimum.at(low, component, c.min(1))
    np.maximum.at(high, component, c.max(1))
    size = np.bincount(component)
    cost = area * (((high - low) / 2) ** 2).sum(1) / size
    order = np.argsort(cost, kind="stable")[:-1]  # the dearest stays in any case
    left = len(faces) - np.cumsum(size[order])
    goes = (2 * cost[order] < price) & (left + (size[order] if np.isinf(price) else 0) >= n_triangles)
    return faces[~np.isin(component, order[goes])]
