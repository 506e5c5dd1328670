"""
Which faces lie in one chart: disks of faces, merged pair by pair as long as they can be laid flat with little stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ...model.topology import area_vectors, corner_angles
from ..manifold import manifold_neighbours

_STRETCH = 1.06
"""Largest L2 stretch of the conformal map of a chart, which has more than the map that it gets in the end."""
_RAGGED = 2.5
"""Largest squared length of a chart's border over that of the circle with its area."""
_LARGEST = 0.3
"""Largest share of the surface in one chart, so that charts can be packed."""
_FEW = 12
"""Charts of so many faces may be as large and ragged as they like."""


@dataclass(frozen=True)
class Segments:
    """
    A nested sequence of segmentations, finest first.

    Parameters
    ----------
    labels : list of ndarray, shape (F,)
        Chart of every face, numbered from 0; each is a disk.
    """

    labels: list[np.ndarray]

    @property
    def chart(self) -> np.ndarray:
        """The coarsest one."""
        return self.labels[-1]

    def parted(self, chart: np.ndarray, which: np.ndarray) -> np.ndarray:
        """
        The charts of the faces ``which``, shape (F,), bool, each as those that it was merged from last.
        """
        chart, left = chart.copy(), which.copy()
        fresh = int(chart.max()) + 1
        for label in reversed(self.labels):
            if not left.any():
                break
            n = int(chart[left].max()) + 1
            pairs = np.unique(label[left] * n + chart[left])
            split = np.bincount(pairs % n, minlength=n) > 1
            now = left & split[np.minimum(chart, n - 1)] & (chart < n)
            chart[now] = fresh + label[now]
            fresh += int(label.max()) + 1
            left &= ~now
        return chart


@dataclass(frozen=True)
class _Edges:
    """
    Edges of two faces that are wound alike: the faces i and j, length, and what a seam along it would be worth.
    """

    i: np.ndarray
    j: np.ndarray
    a: np.ndarray
    b: np.ndarray
    length: np.ndarray
    gain: np.ndarray


def segment(
    positions: np.ndarray, faces: np.ndarray, crease_angle: float = 180.0, hard: np.ndarray | None = None
) -> Segments:
    """
    Merge faces into charts, the pairs first that save most of the seams, along sharp edges last.

    Every round merges the pairs of charts that prefer each other, if their union is a disk, compact enough, and its
    conformal map of least area distortion (u = 0 along the border: Springborn et al. 2008, Sect. 3.2) has an L2
    stretch (Sander et al. 2001) below a limit.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
        Over welded positions.
    crease_angle : float
        Edges that turn by more get two normals, so that a seam along them costs nothing [degrees].
    hard : ndarray, shape (F, 3), bool, optional
        The only edges, from corner k to corner k + 1, that do.
    """
    n_faces = len(faces)
    corners = positions[faces]
    normal = area_vectors(corners)
    area = np.linalg.norm(normal, axis=1) / 2
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    edges = _edges(corners, faces, normal, crease_angle, hard)
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    angles = corner_angles(positions, faces)

    label = np.arange(n_faces)
    labels = [label]
    refused = np.zeros(0, np.int64)
    while True:
        n = int(label.max()) + 1
        a, b = label[edges.i], label[edges.j]
        apart = a != b
        low, high = np.minimum(a, b)[apart], np.maximum(a, b)[apart]
        key, pair = np.unique(low * n + high, return_inverse=True)
        if not len(key):
            break
        low, high = key // n, key % n
        shared = np.bincount(pair, edges.length[apart])
        gain = np.bincount(pair, edges.gain[apart])
        rim = np.bincount(label, sides.sum(1), n) - 2 * np.bincount(a[~apart], edges.length[~apart], n)
        size = np.bincount(label, area, n)
        many = np.bincount(label, minlength=n)
        least = np.minimum(rim[low], rim[high])
        score = gain / np.maximum(least, 1e-300)
        ragged = (rim[low] + rim[high] - 2 * shared) ** 2 / np.maximum(4 * np.pi * (size[low] + size[high]), 1e-300)
        fine = (ragged < _RAGGED) & (size[low] + size[high] <= _LARGEST * area.sum())
        fine |= many[low] + many[high] <= _FEW
        fine &= ~np.isin(key, refused)
        fine &= _disks(faces, label, edges, low, high, pair, apart, n)
        score[~fine] = -1
        best = np.full(n, -1.0)
        np.maximum.at(best, low, score)
        np.maximum.at(best, high, score)
        choice = np.full(n, -1)
        for ends in (low, high):
            mine = fine & (score == best[ends])
            np.maximum.at(choice, ends[mine], np.flatnonzero(mine))
        k = np.arange(len(key))
        mutual = np.flatnonzero((choice[low] == k) & (choice[high] == k) & fine)
        if not len(mutual):
            break
        into = np.full(n, -1)
        into[low[mutual]] = into[high[mutual]] = np.arange(len(mutual))
        joint = into[label]
        stretch = conformal_stretch(
            positions, faces[joint >= 0], joint[joint >= 0], angles[joint >= 0], area[joint >= 0]
        )
        good = stretch < _STRETCH
        new = np.arange(n)
        new[high[mutual[good]]] = low[mutual[good]]
        _, renumber = np.unique(new, return_inverse=True)
        bad = mutual[~good]
        kept = np.concatenate([np.stack([refused // n, refused % n], 1), np.stack([low[bad], high[bad]], 1)])
        touched = np.zeros(n, bool)
        touched[low[mutual[good]]] = touched[high[mutual[good]]] = True
        kept = renumber[kept[~touched[kept].any(1)]]
        label = renumber[label]
        refused = kept.min(1) * (int(label.max()) + 1) + kept.max(1) if len(kept) else np.zeros(0, np.int64)
        if good.any():
            labels.append(label)
    return Segments(labels)


def _edges(corners, faces, normal, crease_angle: float, hard: np.ndarray | None) -> _Edges:
    left, right = manifold_neighbours(faces)
    n = len(faces)
    start, end = faces.T.ravel(), np.roll(faces, -1, axis=1).T.ravel()
    alike = start[left] == end[right]
    left, right = left[alike], right[alike]
    i, j = left % n, right % n
    p = corners.transpose(1, 0, 2).reshape(-1, 3)
    q = np.roll(corners, -1, axis=1).transpose(1, 0, 2).reshape(-1, 3)
    length = np.linalg.norm(p[left] - q[left], axis=1)
    cosine = np.einsum("ei,ei->e", normal[i], normal[j])
    # Where faces turn the vertices of a seam have two normals for nothing.
    gain = length * (0.05 + 0.95 * np.clip((1 + cosine) / 2, 0, 1) ** 8)
    crease = cosine < np.cos(np.radians(crease_angle)) - 1e-9
    if hard is not None:
        crease &= hard.T.ravel()[left] | hard.T.ravel()[right]
    return _Edges(i, j, start[left], end[left], length, np.where(crease, 0, gain))


def _disks(faces, label, edges, low, high, pair, apart, n) -> np.ndarray:
    """Whether two disks meet in one path, and nowhere else: it has one vertex more than edges."""
    m = int(faces.max()) + 1
    place = np.unique(label[:, None] * m + faces)  # (chart, position)
    owner, vertex = place // m, place % m
    order = np.argsort(vertex, kind="stable")
    owner, vertex = owner[order], vertex[order]
    counts = np.bincount(vertex)
    counts = counts[counts > 0]
    first = np.repeat(np.cumsum(counts) - counts, counts)
    partners = np.repeat(counts, counts)
    one = np.repeat(np.arange(len(owner)), partners)
    two = first[one] + np.arange(len(one)) - np.repeat(np.cumsum(partners) - partners, partners)
    x, y = owner[one], owner[two]
    less = x < y
    key = x[less] * n + y[less]
    found = np.searchsorted(low * n + high, key)
    wanted = low * n + high
    found = np.minimum(found, len(wanted) - 1)
    hit = wanted[found] == key
    vertices = np.bincount(found[hit], minlength=len(wanted))
    return vertices - np.bincount(pair, minlength=len(wanted)) == 1


def conformal_stretch(positions, faces, chart, angles, area) -> np.ndarray:
    """
    L2 stretch of the conformal map of every chart whose border keeps its lengths, shape (C,); infinite where a part of
    a chart has no border, and so no such map.
    """
    n_charts = int(chart.max()) + 1
    m = int(faces.max()) + 1
    place, f = np.unique(chart[:, None] * m + faces, return_inverse=True)
    f = f.reshape(-1, 3)
    n = len(place)
    owner = place // m
    a, b = f.ravel(), np.roll(f, -1, axis=1).ravel()
    alone = ~np.isin(a * n + b, b * n + a)
    inner = np.ones(n, bool)
    inner[a[alone]] = inner[b[alone]] = False
    u, closed = np.zeros(n), np.zeros(n, bool)
    if inner.any():
        curvature = 2 * np.pi - np.bincount(f.ravel(), angles.ravel(), n)
        cot = 0.5 / np.tan(np.clip(angles, 0.05, np.pi - 0.05))
        opposite = np.roll(cot, 1, axis=1).ravel()  # of the edge k to k + 1: the angle at k + 2
        rows, cols = np.concatenate([a, b]), np.concatenate([b, a])
        w = coo_array((np.tile(opposite, 2), (rows, cols)), shape=(n, n)).tocsr()
        w.data = np.maximum(w.data, 0.01)
        lap = coo_array((np.asarray(w.sum(1)).ravel(), (np.arange(n), np.arange(n))), shape=(n, n)).tocsr() - w
        _, piece = connected_components(w, directed=False)
        closed = ~np.isin(piece, piece[~inner])
        inner &= ~closed
        if inner.any():
            lap = lap[inner][:, inner].tocsc()
            u[inner] = splu(lap, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(curvature[inner])
    mass = np.bincount(f.ravel(), np.repeat(area, 3), n)
    total = np.bincount(owner, mass, n_charts)
    u = np.clip(u, -20, 20)
    grow, shrink = (np.bincount(owner, mass * np.exp(s * 2 * u), n_charts) / np.maximum(total, 1e-300) for s in (1, -1))
    stretch = np.sqrt(grow * shrink)
    stretch[owner[closed]] = np.inf
    return stretch
