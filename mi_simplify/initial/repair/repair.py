"""
A damaged reduction made sound before it is fitted: pieces that came off, vertices pushed through, lost volume.

The fit moves vertices as far as their images say; it neither closes a gap nor finds out what a face that looks the
wrong way was for. Both can be told from the asset itself. A mesh that needs none of this leaves exactly as it came.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from ...model.topology import area_vectors
from ..closest import ClosestPoints, sample_surface
from ..manifold import edge_pairs
from .placement import settle

_TURNED = 0.3
"""A face is off where its normal and the reference's have a smaller cosine."""
_FAR = 0.25
"""A face is off where it is farther from the reference than this share of the median edge, and 3 times the median."""
_GAIN = 0.5
"""The whole surface is moved only if its distance to the reference falls below this share."""
_FIT = 0.4
"""Border vertices fit where they lie closer together than this share of the border's edges."""
_BORDER = 0.5
"""Share of a piece's border that must continue others'."""
_MOST_PIECES = 200
"""A mesh of more open parts than this is made of parts: foliage, hair, feathers."""


def repair(
    positions: np.ndarray, faces: np.ndarray, reference: ClosestPoints
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """
    Put pieces back, draw stray vertices in, bring the surface out to where the reference is.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
        Welded positions.
    faces : ndarray, shape (F, 3)
        Indices into ``positions``.
    reference : ClosestPoints
        The detailed surface, in the same frame, wound the same way.

    Returns
    -------
    positions : ndarray, shape (Q, 3), float64
    index : ndarray, shape (P,), int64
        Which of them each old position has become: pieces that fit are welded on.
    notes : list of str
        What was done, one line each; empty where nothing was.
    """
    p, index, n_pieces = _reattach(np.asarray(positions, np.float64), faces, reference)
    faces = index[faces]
    p, share = _settled(p, faces, reference)
    p, n_strays = _drawn_in(p, faces, reference, n_pieces > 0 or share < 1)
    notes = []
    if n_pieces:
        notes.append(f"{n_pieces} detached pieces put back where their borders fit")
    if n_strays:
        notes.append(f"{n_strays} stray vertices drawn back to the surface")
    if share < 1:
        notes.append(f"surface moved to the reference: its mean distance fell to {share:.0%} of what it was")
    if n_pieces or share < 1:
        p, _ = _settled(p, faces, reference, gain=1.0)
    return p, index, notes


def _settled(
    p: np.ndarray, faces: np.ndarray, reference: ClosestPoints, gain: float = _GAIN
) -> tuple[np.ndarray, float]:
    """The surface moved as close as it comes, and to what share its distance fell; unmoved if not below ``gain``."""
    moved = p
    before = after = _distance(p, faces, reference)
    for _ in range(5):
        trial = settle(moved, faces, reference)
        distance = _distance(trial, faces, reference)
        if distance > 0.9 * after:
            break
        moved, after = trial, distance
    return (moved, after / before) if after < gain * before else (p, 1.0)


def _distance(p: np.ndarray, faces: np.ndarray, reference: ClosestPoints) -> float:
    """Mean distance of vertices and face centres to the reference."""
    return float(reference.query(np.concatenate([p[np.unique(faces)], p[faces].mean(1)]), candidates=4).distance.mean())


def _off(p: np.ndarray, faces: np.ndarray, reference: ClosestPoints) -> tuple[np.ndarray, np.ndarray]:
    """Faces that are turned away from the reference or lie far from it, and the latter alone, shape (F,), bool."""
    c = p[faces]
    normal = area_vectors(c)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    hit = reference.query(c.mean(1))
    edge = np.median(np.linalg.norm(c - np.roll(c, 1, axis=1), axis=2))
    turned = np.einsum("fi,fi->f", normal, reference.normals[hit.face]) < _TURNED
    far = hit.distance > np.maximum(_FAR * edge, 3 * np.median(hit.distance))
    return turned | far, far


def _drawn_in(
    p: np.ndarray, faces: np.ndarray, reference: ClosestPoints, damage: bool, rounds: int = 6
) -> tuple[np.ndarray, int]:
    """Vertices of faces that are off, spread between their neighbours on the reference where it mends half of them."""
    n = len(p)
    a, b = edge_pairs(faces)[0].T
    ring = csr_array((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n))
    degree = ring @ np.ones(n)
    drawn, border = np.zeros(n, bool), np.zeros(n, bool)
    border[_open_edges(faces)] = True
    off, far = _off(p, faces, reference)
    for attempt in range(rounds):
        stray = np.zeros(n, bool)
        stray[faces[off]] = True
        if attempt % 2:  # one ring more leaves more room to unfold
            stray |= ring @ stray > 0
        stray &= ~border
        clusters, cluster = connected_components(ring[stray][:, stray], directed=False)
        held = np.bincount(cluster, ring[stray] @ (~stray).astype(float), clusters) > 0
        stray[np.flatnonzero(stray)[~held[cluster]]] = False  # a part that is off as a whole has nowhere to go
        if not stray.any():
            break
        clusters, cluster = connected_components(ring[stray][:, stray], directed=False)
        of = np.full(n, clusters)
        of[stray] = cluster
        inner = (diags_array(degree[stray] + 1e-9) - ring[stray][:, stray]).tocsc()
        trial = p.copy()
        trial[stray] = reference.query(spsolve(inner, ring[stray][:, ~stray] @ p[~stray]).reshape(-1, 3)).point
        # Every cluster of strays is a question of its own.
        owner = of[faces].min(1)
        before, after = (np.bincount(owner, x, clusters + 1) for x in (off, _off(trial, faces, reference)[0]))
        damaged = (np.bincount(owner, far, clusters + 1) > 0) | damage  # thin parts of a sound mesh may look turned
        better = stray & ((2 * after < before) & damaged)[of]
        p = np.where(better[:, None], trial, p)
        drawn |= better
        off, far = _off(p, faces, reference)
    return p, int(drawn.sum())


def _reattach(p: np.ndarray, faces: np.ndarray, reference: ClosestPoints) -> tuple[np.ndarray, np.ndarray, int]:
    """Pieces moved to where their borders continue others', unless missed where they were, and welded there."""
    n = len(p)
    index = np.arange(n)
    graph = coo_array((np.ones(2 * len(faces)), (faces[:, [0, 0]].ravel(), faces[:, 1:].ravel())), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    pieces, size = np.unique(part[faces[:, 0]], return_counts=True)
    pieces = pieces[np.argsort(size, kind="stable")][:-1]  # the largest one stays
    rim = _open_edges(faces)
    pieces = pieces[np.isin(pieces, part[rim])]
    if not 0 < len(pieces) <= _MOST_PIECES:
        return p, index, 0
    points, _ = sample_surface(reference.corners, reference.double_area, 20_000, seed=1)
    n_samples = min(50_000, 50 * len(faces))
    gaps = ClosestPoints(p, faces, n_samples).query(points, candidates=4).distance
    n_pieces, tried = 0, -1
    while tried != n_pieces:  # a piece may fit where another one has come back
        tried = n_pieces
        for piece in pieces:
            inside = part == piece
            its = inside[rim[:, 0]]
            if not its.any() or its.all():
                continue
            own, others = np.unique(rim[its]), np.unique(rim[~its])
            length = float(np.median(np.linalg.norm(p[rim[its, 0]] - p[rim[its, 1]], axis=1)))
            shift, mine, theirs, gap = _fitting_shift(p[own], p[others])
            close = gap < _FIT * length
            name = np.full(n, -1)
            name[own[mine[close]]] = others[theirs[close]]
            # Neighbours run along their edge in opposite directions; equal parts laid on each other do not.
            back = name[rim[its]][:, ::-1]
            if np.isin(back @ [n, 1], rim[~its] @ [n, 1])[(back >= 0).all(1)].sum() < _BORDER * its.sum():
                continue
            trial = p.copy()
            trial[inside] += shift
            filled = ClosestPoints(trial, index[faces], n_samples).query(points, candidates=4).distance
            hole = max(2 * np.median(gaps), 0.1 * length)
            if (filled > hole).sum() > (gaps > hole).sum():
                continue  # it was right where it was: more of the reference is uncovered without it
            p, gaps = trial, filled
            moved = np.flatnonzero(name >= 0)
            p[name[moved]] = (p[name[moved]] + p[moved]) / 2
            index[moved] = name[moved]
            index = index[index]
            part[inside] = part[name[moved[0]]]
            rim = _open_edges(index[faces])
            n_pieces += 1
    kept, compact = np.unique(index, return_inverse=True)
    return p[kept], compact.reshape(-1), n_pieces


def _open_edges(faces: np.ndarray) -> np.ndarray:
    """Edges of one face, in its direction, shape (E, 2)."""
    _, edge_of, counts = edge_pairs(faces)
    k, f = np.nonzero(counts[edge_of] == 1)
    return np.stack([faces[f, k], faces[f, (k + 1) % 3]], 1)


def _fitting_shift(own: np.ndarray, others: np.ndarray):
    """
    The translation that lays border vertices on others: iterated closest points over mutual pairs.

    Returns
    -------
    shift : ndarray, shape (3,)
    mine, theirs : ndarray, shape (M,)
        Pairs that are each other's closest after it.
    gap : ndarray, shape (M,)
    """
    tree, shift = cKDTree(others), np.zeros(3)
    for _ in range(30):
        moved = own + shift
        _, there = tree.query(moved)
        _, back = cKDTree(moved).query(others)
        mine = np.flatnonzero(back[there] == np.arange(len(own)))
        way = others[there[mine]] - moved[mine]
        step = np.median(way, axis=0)
        shift = shift + step
        if np.abs(step).max() < 1e-9:
            break
    return shift, mine, there[mine], np.linalg.norm(others[there[mine]] - own[mine] - shift, axis=1)
