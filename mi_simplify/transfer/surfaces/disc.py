"""
A surface made into a disc: holes closed, closed surfaces cut open, edges split that a square could not show.

A disc keeps every vertex as a weighted mean of the surface's own, so that it follows all deformations of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, vstack
from scipy.sparse.csgraph import connected_components, dijkstra

from ...errors import MeshError
from .borders import border_loops, edge_keys, genus, half_edges, require_surface


@dataclass(frozen=True)
class Disc:
    """
    A surface with one border.

    Parameters
    ----------
    faces : ndarray, shape (F, 3), int64
        Over the disc's own vertices.
    source : csr_array, shape (V', V)
        Rows of sum 1: where its vertices lie between those of the surface.
    border : ndarray, shape (B,), int64
        Vertices along the border, counter-clockwise.
    seam : bool
        The border is a cut: its second half runs back along the first, and ``border[0]`` is one end.
    notes : tuple of str
        What was closed or cut.
    """

    faces: np.ndarray
    source: csr_array
    border: np.ndarray
    seam: bool = False
    notes: tuple[str, ...] = ()


def make_disc(positions: np.ndarray, faces: np.ndarray, *, close_holes: bool = False, what: str = "surface") -> Disc:
    """
    Make a disc of a surface.

    Parameters
    ----------
    positions : ndarray, shape (V, 3)
    faces : ndarray, shape (F, 3)
        Over welded positions.
    close_holes : bool
        Fill all borders but the longest with fans around their middles.
    what : str
        What the messages call it.

    Raises
    ------
    MeshError
        Several pieces, edges with more than two faces, several borders that are not closed, or handles.
    """
    faces = np.asarray(faces, np.int64)
    require_surface(faces, what)
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    source = csr_array(eye_array(len(positions), format="csr"))[used]
    loops = border_loops(faces)
    handles = genus(faces, len(loops))
    if handles:
        raise MeshError(
            f"{what}: a surface without handles expected, it has {handles}; cut it into a disc in a modelling program, "
            f"or name another part"
        )
    notes: list[str] = []
    if len(loops) > 1:
        if not close_holes:
            raise MeshError(
                f"{what}: one border expected, it has {len(loops)}; close its holes with 'close_holes: true', or cut "
                f"it into a disc"
            )
        faces, source = _closed(faces, source, loops[1:])
        notes.append(f"{len(loops) - 1} holes closed with fans around their middles")
    disc = Disc(faces, source, loops[0] if loops else np.array([], np.int64))
    if not loops:
        disc = _cut(disc, source @ positions)
        notes.append(f"closed surface, cut open along {len(disc.border) // 2} edges")
    disc, n_split = _without_chords(disc)
    if n_split:
        notes.append(f"{n_split} edges split that ran from border to border")
    return replace(disc, notes=tuple(notes))


def _closed(faces: np.ndarray, source: csr_array, loops: list[np.ndarray]) -> tuple[np.ndarray, csr_array]:
    """Fans around the middle of each loop."""
    n = source.shape[0]
    fans = [np.stack([np.roll(loop, -1), loop, np.full(len(loop), n + k)], 1) for k, loop in enumerate(loops)]
    rows = np.repeat(np.arange(len(loops)), [len(loop) for loop in loops])
    share = np.concatenate([np.full(len(loop), 1 / len(loop)) for loop in loops])
    middles = coo_array((share, (rows, np.concatenate(loops))), shape=(len(loops), n)).tocsr() @ source
    return np.concatenate([faces, *fans]), csr_array(vstack([source, middles]))


def _cut(disc: Disc, positions: np.ndarray) -> Disc:
    """Cut a closed surface along the shortest path between two vertices that are as far apart as any."""
    n, edges = len(positions), half_edges(disc.faces)
    length = np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)
    graph = coo_array((length, edges.T), shape=(n, n)).tocsr()
    start = int(np.argmax(dijkstra(graph, indices=0)))
    distance, before = dijkstra(graph, indices=start, return_predecessors=True)
    path = [int(np.argmax(distance))]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    if len(path) < 3:
        raise MeshError("a path of at least two edges expected for the cut; the surface is too coarse, subdivide it")
    return replace(opened(disc, np.array(path)), seam=True)


def opened(disc: Disc, path: np.ndarray) -> Disc:
    """
    A closed disc cut along a path of vertices: those between its ends become two.
    """
    faces, n = disc.faces, disc.source.shape[0]
    cut = edge_keys(np.stack([path[:-1], path[1:]], 1), n)
    corner = np.arange(3 * len(faces)).reshape(-1, 3)
    ends = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])  # as half_edges has them
    edges = half_edges(faces)
    key = edge_keys(edges, n)
    order = np.argsort(key, kind="stable")
    a, b = order[0::2], order[1::2]  # the two half edges of every edge, which run against each other
    kept = ~np.isin(key[a], cut)
    pairs = np.concatenate([np.stack([ends[a, 0], ends[b, 1]], 1), np.stack([ends[a, 1], ends[b, 0]], 1)])
    pairs = pairs[np.concatenate([kept, kept])]
    m = corner.size
    _, label = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(m, m)), directed=False)
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    old = faces.ravel()[first]
    faces = label.reshape(-1, 3)
    border = border_loops(faces)[0]
    border = np.roll(border, -int(np.flatnonzero(old[border] == path[0])[0]))
    return replace(disc, faces=faces, source=disc.source[old], border=border)


def _without_chords(disc: Disc) -> tuple[Disc, int]:
    """Split edges inside that join two vertices of the border; else what they cut off may fall onto one side."""
    faces, source, n_split = disc.faces, disc.source, 0
    while True:
        n = source.shape[0]
        on_border = np.zeros(n, bool)
        on_border[disc.border] = True
        along = edge_keys(np.stack([disc.border, np.roll(disc.border, -1)], 1), n)
        edges = half_edges(faces)
        key = edge_keys(edges, n)
        chords = np.unique(key[on_border[edges].all(1) & ~np.isin(key, along)])
        if not len(chords):
            return replace(disc, faces=faces, source=source), n_split
        # One chord a face and round: the smallest of its own, if that is the smallest of both its faces.
        number = np.where(np.isin(key, chords), key, np.iinfo(np.int64).max).reshape(3, -1)
        least = number.min(0)
        chosen = chords[[(least[(number == c).any(0)] == c).all() for c in chords]]
        at = {int(c): n + k for k, c in enumerate(chosen)}
        split = np.isin(least, chosen)
        corner = number[:, split].argmin(0)
        f = np.take_along_axis(faces[split], (corner[:, None] + np.arange(3)) % 3, axis=1)
        middle = np.array([at[int(c)] for c in least[split]])
        halves = [np.stack([f[:, 0], middle, f[:, 2]], 1), np.stack([middle, f[:, 1], f[:, 2]], 1)]
        faces = np.concatenate([faces[~split], *halves])
        ends = np.stack([chosen // n, chosen % n], 1)
        rows = np.repeat(np.arange(len(chosen)), 2)
        halfway = coo_array((np.full(2 * len(chosen), 0.5), (rows, ends.ravel())), shape=(len(chosen), n)).tocsr()
        source = csr_array(vstack([source, halfway @ source]))
        n_split += len(chosen)
