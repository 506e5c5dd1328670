"""
Edges across which the image can jump: the topology, found once in NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

#: Edges whose two faces shade continuously; they matter only as silhouettes.
SMOOTH = 0
#: Hard normals or chart borders: the shading may jump wherever the edge is seen.
CREASE = 1
#: One face, or more than two: the image may jump always.
OPEN = 2


@dataclass
class EdgeTable:
    """
    Distinct edges of a welded mesh.

    Parameters
    ----------
    ends : ndarray, shape (E, 2), int64
        Position indices.
    faces : ndarray, shape (E, 2), int64
        The two faces beside the edge; the first one twice for :data:`OPEN` edges.
    kind : ndarray, shape (E,), int8
    closed : bool
        No edge is :data:`OPEN` and neighbours are wound alike: edges between two back faces are never seen.
    """

    ends: np.ndarray
    faces: np.ndarray
    kind: np.ndarray
    closed: bool


def edge_table(position_faces: np.ndarray, corner_keys: np.ndarray | None = None) -> EdgeTable:
    """
    Find the edges of a triangle mesh.

    Parameters
    ----------
    position_faces : ndarray, shape (F, 3)
        Faces over *welded* positions: a UV seam is no border.
    corner_keys : ndarray, shape (F, 3), optional
        What shading interpolates at each corner, as an index (vertex of UV and normal). Edges whose two
        faces disagree on it become :data:`CREASE`.
    """
    faces = np.asarray(position_faces, np.int64)
    n_faces = len(faces)
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    face = np.repeat(np.arange(n_faces), 3)
    low, high = np.minimum(a, b), np.maximum(a, b)
    keys = faces if corner_keys is None else np.asarray(corner_keys, np.int64)
    key_a, key_b = keys.ravel(), np.roll(keys, -1, axis=1).ravel()
    key_low, key_high = np.where(a < b, key_a, key_b), np.where(a < b, key_b, key_a)

    keep = low != high  # a collapsed face has a corner twice
    low, high, face, key_low, key_high = (x[keep] for x in (low, high, face, key_low, key_high))
    forward = (a < b)[keep]
    order = np.lexsort((face, high, low))
    low, high, face, key_low, key_high, forward = (x[order] for x in (low, high, face, key_low, key_high, forward))
    first = np.flatnonzero(np.r_[True, (low[1:] != low[:-1]) | (high[1:] != high[:-1])])
    count = np.diff(np.r_[first, len(low)])
    second = first + (count > 1)

    kind = np.full(len(first), SMOOTH, np.int8)
    kind[(key_low[first] != key_low[second]) | (key_high[first] != key_high[second])] = CREASE
    kind[count != 2] = OPEN
    alike = forward[first] == forward[second]
    # Two faces wound against each other: which one faces the viewer says nothing about a fold.
    kind[(count == 2) & alike] = OPEN
    return EdgeTable(
        ends=np.stack([low[first], high[first]], axis=1),
        faces=np.stack([face[first], face[second]], axis=1),
        kind=kind,
        closed=bool((count == 2).all() and not alike.any()),
    )


def wound_outwards(positions: np.ndarray, faces: np.ndarray) -> bool:
    """
    Whether every connected part of a closed mesh encloses a positive volume.
    """
    n = len(positions)
    ends = (faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel())
    _, part = connected_components(coo_matrix((np.ones(faces.size), ends), shape=(n, n)), directed=False)
    p = np.asarray(positions, np.float64)[faces]
    volume = np.bincount(part[faces[:, 0]], np.einsum("fi,fi->f", p[:, 0], np.cross(p[:, 1], p[:, 2])))
    return bool((volume[np.unique(part[faces[:, 0]])] > 0).all())
