"""
Which faces of a triangle set are neighbours, and which way they are wound.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..model.topology import area_vectors


def edge_pairs(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Undirected edges of a face list.

    Returns
    -------
    edges : ndarray, shape (E, 2)
        Sorted position indices.
    edge_of : ndarray, shape (3, F)
        Edge from corner k to corner k + 1 of each face.
    counts : ndarray, shape (E,)
        Faces at each edge.
    """
    n = int(faces.max(initial=-1)) + 1
    a, b = faces.T, np.roll(faces, -1, axis=1).T  # (3, F)
    key = np.minimum(a, b) * n + np.maximum(a, b)
    unique, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    return np.stack([unique // max(n, 1), unique % max(n, 1)], 1), inverse.reshape(key.shape), counts


def manifold_neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Half-edges that meet in an edge of exactly two faces: two arrays of ``corner * F + face``, shape (M,) each.
    """
    _, edge_of, counts = edge_pairs(faces)
    flat = edge_of.ravel()
    order = np.argsort(flat, kind="stable")
    start = np.cumsum(counts) - counts
    two = start[counts == 2]
    return order[two], order[two + 1]


def winding_flips(positions: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """
    Which faces to rewind so that neighbours over edges of two faces agree.

    Within a component the larger area keeps its winding. A closed component is turned outwards by its signed
    volume, unless it lies inside another closed one, where facing inwards is right (a hollow).

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
    faces : ndarray, shape (F, 3)
        Indices into ``positions``.

    Returns
    -------
    flip : ndarray, shape (F,), bool
    n_twisted : int
        Components that have no consistent winding; none of their faces is flipped.
    """
    n_faces = len(faces)
    left, right = manifold_neighbours(faces)
    start = faces.T.ravel()  # position at which each half-edge begins
    differ = start[left] == start[right]  # both run the same way along the edge: one must turn
    i, j = left % n_faces, right % n_faces
    # double cover: node f is the face as it is, node F + f the face turned
    rows = np.concatenate([i, i + n_faces])
    cols = np.concatenate([j + n_faces * differ, j + n_faces * ~differ])
    graph = coo_array((np.ones(len(rows), bool), (rows, cols)), shape=(2 * n_faces,) * 2)
    _, label = connected_components(graph, directed=False)
    as_is, turned = label[:n_faces], label[n_faces:]
    twisted = as_is == turned
    sheet = np.minimum(as_is, turned)  # one name per component
    _, sheet = np.unique(sheet, return_inverse=True)
    n_sheets = int(sheet.max()) + 1
    flip = as_is > turned

    corners = positions[faces]
    area = np.linalg.norm(area_vectors(corners), axis=1)
    minority = np.bincount(sheet, area * np.where(flip, 1, -1), n_sheets) > 0
    flip ^= minority[sheet]
    flip &= ~twisted

    _, edge_of, counts = edge_pairs(faces)
    open_sheet = np.zeros(n_sheets, bool)
    open_sheet[sheet[(counts[edge_of] != 2).any(0)]] = True
    open_sheet[sheet[twisted]] = True
    turn = np.where(flip, -1.0, 1.0)
    centre = positions[np.unique(faces)].mean(0)
    volume6 = np.einsum("fi,fi->f", corners[:, 0] - centre, np.cross(corners[:, 1] - centre, corners[:, 2] - centre))
    volume = np.bincount(sheet, volume6 * turn, n_sheets)
    for s in np.flatnonzero(~open_sheet & (volume < 0)):  # few: only components that face inwards
        inside = _enclosed(corners, sheet, ~open_sheet, int(s))
        if not inside:
            flip[sheet == s] ^= True
    return flip, len(np.unique(sheet[twisted]))


def _enclosed(corners: np.ndarray, sheet: np.ndarray, closed: np.ndarray, s: int) -> bool:
    """Whether component ``s`` lies inside an odd number of the other closed ones (solid angles, van Oosterom 1983)."""
    point = corners[sheet == s][0, 0]
    others = closed[sheet] & (sheet != s)
    r = corners[others] - point
    length = np.linalg.norm(r, axis=2)
    numerator = np.einsum("fi,fi->f", r[:, 0], np.cross(r[:, 1], r[:, 2]))
    a, b, c = r.transpose(1, 0, 2)
    la, lb, lc = length.T
    dot = np.einsum
    denominator = la * lb * lc + dot("fi,fi->f", a, b) * lc + dot("fi,fi->f", b, c) * la + dot("fi,fi->f", c, a) * lb
    angle = 2 * np.arctan2(numerator, denominator)
    turns = np.abs(np.bincount(sheet[others], angle, len(closed))) / (4 * np.pi)
    return bool(np.round(turns).astype(int).sum() % 2)
