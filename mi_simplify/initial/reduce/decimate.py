"""
Fewer triangles for a welded mesh: edge collapse by quadric errors, many independent edges at a time.

Garland and Heckbert 1997, mostly with the memoryless quadrics of Hoppe 1999: the error of a collapse is measured
against the triangles as they are now, weighted by area. At equal counts the surface is a third closer to the original
than with quadrics accumulated since the beginning; a tenth of those is mixed in, because without any memory thin tips
wear away. Works on any triangle set: open edges and edges of more than two faces carry quadrics of their own, so that
borders and joints stay where they are. Components share one budget: the cheapest collapses of all come first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from ...errors import MeshError
from ...model.topology import area_vectors
from .crumbs import components, with_hulls, without_crumbs
from .quadrics import evaluate, minimise, planes

_LENIENCE = ((0.15, 0.2, 0.02), (0.5, 0.2, 0.02), (1.0, 0.2, 0.02), (1.0, 0.0, 0.0), (1.0, -1.0, 0.0))
"""
Share of the edges, cheapest first, that may collapse in one round, how far a face may turn (cosine), and the least
height of a face over its length; each row is for where nothing could be collapsed by the one before.
"""
_TEARING = ((0.15, 0.2, 0.0, True), (1.0, 0.0, 0.0, True), (1.0, -1.0, 0.0, True))
"""The same where parts must not go as a whole and are stuck: borders and handles may close, as they then must."""
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
    faces = np.asarray(faces, np.int64)
    label = components(faces, len(positions))
    reduction = Reduction.of(positions, faces, importance, label)
    return reduction.to(n_triangles, np.zeros(label.max() + 1, np.int64)).result()[:2]


@dataclass(frozen=True)
class Reduction:
    """
    A surface on its way to fewer triangles, from where several ways can be tried.

    Parameters
    ----------
    p : ndarray, shape (P, 3), float64
        Positions at the scale of 1; not all are in use.
    faces : ndarray, shape (F, 3), int64
    weights : ndarray, shape (P,), float64
        Importance of what has become of each position.
    past : ndarray, shape (P, 10), or None
        Quadrics accumulated so far.
    label : ndarray, shape (P,), int64
        Component of each position, as :func:`.crumbs.components` gives it.
    frame : tuple of ndarray, shape (3,), and float
        Centre and scale of the positions.
    """

    p: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    past: np.ndarray | None
    label: np.ndarray
    frame: tuple[np.ndarray, float]

    @staticmethod
    def of(positions: np.ndarray, faces: np.ndarray, importance: np.ndarray | None, label: np.ndarray) -> Reduction:
        """
        The surface as it is; the arguments are those of :func:`decimate` and the component of each position.
        """
        positions, faces = np.asarray(positions, np.float64), np.asarray(faces, np.int64)
        used = positions[np.unique(faces)]
        centre, scale = used.mean(0), float(1 / np.ptp(used, axis=0).max())
        weights = np.ones(len(positions)) if importance is None else np.maximum(importance, _LEAST_IMPORTANCE)
        return Reduction((positions - centre) * scale, faces, weights, None, label, (centre, scale))

    def to(self, n_triangles: int, least: np.ndarray, crumbs: bool = True) -> Reduction:
        """
        At most ``n_triangles`` triangles, at least 4.

        Parameters
        ----------
        least : ndarray, shape (C,), int64
            Triangles that each component keeps, in all not more than the budget; of 0, it may go as a whole. A
            component that cannot be collapsed as far as it must is torn, and becomes its convex hull if that does not
            do.
        crumbs : bool
            Components of 0 may go before nothing can be collapsed any more.

        Raises
        ------
        MeshError
            The budget is below 4, or less than the components of the mesh need.
        """
        if n_triangles < 4:
            raise MeshError(f"a budget of {n_triangles} triangles is too small; ask for at least 4")
        p, faces, weights, past, label = self.p, self.faces, self.weights, self.past, self.label
        rules = [(*row, False) for row in _LENIENCE]
        if least.any():
            rules[3:3] = _TEARING
        patience = 0
        while len(faces) > n_triangles:
            mesh = _Round(p, faces, weights, past)
            room = _room(faces, label, least)
            chosen, targets, price = mesh.choose(len(faces) - n_triangles, label, room, *rules[patience])
            if len(chosen):
                tear = rules[patience][-1]
                p, faces, weights, past = mesh.collapse(chosen, targets, tear)
                patience = patience if tear else 0  # what had to be torn once is stuck without
                if crumbs and len(faces) < 4 * n_triangles:
                    faces = without_crumbs(p, faces, weights, n_triangles, label, least, price)
            elif patience + 1 < len(rules):
                patience += 1
            else:
                p, faces = _unstuck(p, faces, weights, n_triangles, label, least)
        return replace(self, p=p, faces=faces, weights=weights, past=past)

    def result(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Positions (Q, 3), faces (G, 3) and the component of each position (Q,).
        """
        used, faces = np.unique(self.faces, return_inverse=True)
        centre, scale = self.frame
        return self.p[used] / scale + centre, faces.reshape(-1, 3), self.label[used]


def _unstuck(
    p: np.ndarray, faces: np.ndarray, weights: np.ndarray, n_triangles: int, label: np.ndarray, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and fewer faces where nothing can be collapsed."""
    less = without_crumbs(p, faces, weights, n_triangles, label, least, slack=3)
    if len(less) > n_triangles:
        p, less = with_hulls(p, less, weights, n_triangles, label, least, decimate)
    if len(less) == len(faces):
        less = without_crumbs(p, faces, weights, n_triangles, label, least)
    if len(less) == len(faces):
        raise MeshError(f"this surface cannot be reduced below {len(faces)} triangles; ask for at least as many")
    return p, less


def _room(faces: np.ndarray, label: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Faces that each component may still lose to collapses, shape (C,)."""
    size = np.bincount(label[faces[:, 0]], minlength=len(least))
    return np.where(least > 0, size - least, np.iinfo(np.int64).max)


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
        walls = planes(normal, p[:, 0], share)
        indptr = np.append(self.first_corner, len(self.corner))
        gather = csr_array((np.ones(len(self.corner)), self.corner // 3, indptr), shape=(self.n, len(self.faces)))
        quadrics = gather @ walls
        rim = self.counts != 2
        self.hold = gather @ share * self._pointedness(p, length, rim)
        if rim.any():
            a, b = self.p[self.edges[rim].T]
            along = b - a
            across = np.cross(along, normal[a_face[rim]])
            length2 = np.einsum("ei,ei->e", along, along)
            across /= np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
            walls = planes(across, a, _BORDER * length2 * self.weights[self.edges[rim]].mean(1))
            for k in range(2):
                np.add.at(quadrics, self.edges[rim, k], walls)
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

    def choose(
        self, n_remove: int, label: np.ndarray, room: np.ndarray, share: float, turn: float, thin: float, tear: bool
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """
        Edges to collapse together, none next to another, cheapest first; where they go, shape (S, 3); the highest cost.

        No more of them than remove ``n_remove`` faces (the last one may remove one more), and of no component more than
        its ``room``, shape (C,). With ``tear``, borders and handles may close.
        """
        a, b = self.edges.T
        quadric = self.quadrics[a] + self.quadrics[b]
        middle, along = (self.p[a] + self.p[b]) / 2, self.p[a] - self.p[b]
        weight = quadric[:, 0] + quadric[:, 3] + quadric[:, 5]
        hold = np.stack([self.hold[a], self.hold[b]])
        pulls = np.stack([_ANCHOR * weight + 1e-30, *(_TIP_PULL * hold)])
        anchor = np.einsum("ke,kei->ei", pulls / pulls.sum(0), [middle, self.p[a], self.p[b]])
        target = minimise(quadric, anchor, pulls.sum(0))
        cost = np.maximum(evaluate(quadric, target), 0) + _LENGTH * weight * np.einsum("ei,ei->e", along, along)
        for end, w in zip((a, b), hold, strict=True):
            cost += w * ((target - self.p[end]) ** 2).sum(1)

        part = label[a]
        free = np.flatnonzero(self.counts <= room[part])
        if not len(free):
            return free, target[free], 0.0
        k = min(len(free), max(64, int(share * len(free))))
        left = free[np.argpartition(cost[free], k - 1)[:k]]
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
                good = good[self._allowed(good, target[good], turn, thin, tear)]
            chosen.append(good)
            ends = self.edges[good].ravel()
            taken[ends] = True
            taken[self.neighbour[_rows(self.first_neighbour[ends], self.degree[ends])[0]]] = True
            stuck = len(good) < 0.5 * winner.sum()
            left = left[~winner & ~taken[self.edges[left]].any(1)]
            if stuck and len(left):  # edges that must not collapse stand in the way of those that may
                left, checked = left[self._allowed(left, target[left], turn, thin, tear)], True
            if not len(left):
                break
        found = np.concatenate(chosen)
        found = found[np.argsort(cost[found], kind="stable")]
        found = found[_running(part[found], self.counts[found]) <= room[part[found]]]
        gone = np.cumsum(self.counts[found])
        found = found[: int(np.searchsorted(gone, n_remove)) + 1]
        return found, target[found], float(cost[found[-1]]) if len(found) else 0.0

    def _allowed(self, edges: np.ndarray, target: np.ndarray, turn: float, thin: float, tear: bool) -> np.ndarray:
        """Which collapses keep the topology, turn no face over and make no needles, shape (S,)."""
        a, b = self.edges[edges].T
        # link condition: the ends share no neighbours but those of their common faces
        index, owner = _rows(self.first_neighbour[a], self.degree[a])
        w, other = self.neighbour[index], b[owner]
        key = np.minimum(w, other) * self.n + np.maximum(w, other)
        place = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        common = np.bincount(owner[self.key[place] == key], minlength=len(edges))
        counts = self.counts[edges]
        ok = (common == counts) | tear
        on_rim = np.zeros(self.n, bool)
        on_rim[self.edges[self.counts != 2].ravel()] = True
        ok &= ~(on_rim[a] & on_rim[b] & (counts == 2)) | tear  # would pinch two borders together
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

    def collapse(
        self, edges: np.ndarray, target: np.ndarray, tear: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Positions, faces, weights and accumulated quadrics after the edges have become their targets."""
        a, b = self.edges[edges].T
        p, weights, past = self.p.copy(), self.weights.copy(), self.past.copy()
        p[a] = target
        weights[a] = (weights[a] + weights[b]) / 2
        past[a] += past[b]
        name = np.arange(self.n)
        name[b] = a
        f = name[self.faces]
        f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
        if tear:  # what closes leaves two faces on one another
            f = f[np.sort(np.unique(np.sort(f, axis=1), axis=0, return_index=True)[1])]
        return p, f, weights, past


def _rows(first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries ``first[i] … first[i] + count[i] - 1`` of all i in one list, and the i of each."""
    owner = np.repeat(np.arange(len(count)), count)
    return np.arange(len(owner)) - np.repeat(np.cumsum(count) - count - first, count), owner


def _running(group: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Running sums within each group, in the order given, shape (N,)."""
    order = np.argsort(group, kind="stable")
    total = np.cumsum(value[order])
    first = np.diff(group[order], prepend=-1) != 0
    before = (total - value[order])[first]
    out = np.empty_like(total)
    out[order] = total - np.repeat(before, np.diff(np.append(np.flatnonzero(first), len(group))))
    return out
