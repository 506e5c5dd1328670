"""
One clean triangle set: weld, drop, swap slivers away, rewind.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ...errors import MeshError
from ...model.topology import area_vectors, vertex_normals
from ..manifold import edge_pairs, manifold_neighbours, winding_flips
from ..soup import Soup

WELD_TOLERANCE = 1e-6
"""Positions closer than this share of the box's diagonal are one position."""


def clean(soup: Soup) -> tuple[Soup, list[str]]:
    """
    Weld, drop degenerate and duplicate faces, swap away slivers, unify the winding.

    Returns
    -------
    soup : Soup
        Same materials; faces with three distinct positions, no two over the same three, neighbours wound alike.
    notes : list of str
        What was done, one line each; empty for a clean mesh.

    Raises
    ------
    MeshError
        Nothing is left: no face has an area.
    """
    notes: list[str] = []

    def note(count: int, what: str) -> None:
        if count:
            notes.append(f"{count} {what}")

    bad = ~np.isfinite(soup.positions).all(1)[soup.position_faces].all(1)
    note(int(bad.sum()), "faces with non-finite positions dropped")
    soup = _keep(soup, ~bad)

    before = len(soup.positions)
    soup = _weld_near(soup, WELD_TOLERANCE * soup.diagonal)
    note(before - len(soup.positions), "nearly equal positions welded")

    f = soup.position_faces
    flat = (f[:, 0] == f[:, 1]) | (f[:, 1] == f[:, 2]) | (f[:, 2] == f[:, 0])
    note(int(flat.sum()), "degenerate faces dropped")
    soup = _keep(soup, ~flat)

    soup, n_swapped, n_slivers = _swap_slivers(soup)
    note(n_swapped, "faces without area swapped away along their long edge")
    note(n_slivers, "faces without area dropped")

    _, first = np.unique(np.sort(soup.position_faces, axis=1), axis=0, return_index=True)
    note(len(soup.faces) - len(first), "duplicate faces dropped")
    soup = _keep(soup, np.sort(first))
    if not len(soup.faces):
        raise MeshError("no face of this mesh has an area; check the file in a viewer")

    flip, n_twisted = winding_flips(soup.positions, soup.position_faces)
    note(int(flip.sum()), "faces rewound")
    note(n_twisted, "one-sided components (Möbius) left as they are")
    if flip.any():
        soup = replace(soup, faces=np.where(flip[:, None], soup.faces[:, ::-1], soup.faces))
    if notes and not soup.has_normals.all():
        smooth = vertex_normals(soup.positions, soup.position_faces)[soup.position_index].astype(np.float32)
        soup = replace(soup, normals=np.where(soup.has_normals[:, None], soup.normals, smooth))

    counts = edge_pairs(soup.position_faces)[2]
    note(int((counts > 2).sum()), "edges with more than two faces")
    note(int((counts == 1).sum()), "open edges")
    return soup, notes


def _keep(soup: Soup, which: np.ndarray) -> Soup:
    """The soup with some of its faces."""
    return replace(
        soup,
        faces=soup.faces[which],
        material_index=soup.material_index[which],
        part_index=soup.part_index[which],
    )


def _weld_near(soup: Soup, tolerance: float) -> Soup:
    """
    Merge positions that lie within ``tolerance``, chains of them too; drop the unreferenced ones.

    All positions in a cell of a grid whose cells are that large across are one, and the first stands for them when
    cells are compared: the pairs of a cloud that is smaller than the tolerance would fill the memory.
    """
    used = np.unique(soup.position_faces)
    points = soup.positions[used]
    side = tolerance / 3**0.5 or 1.0  # without extent, there is one cell
    cell = ((points - points.min(0, initial=np.inf)) / side).astype(np.int64)
    _, representative, in_cell = np.unique(cell @ (1 << np.array([0, 21, 42])), return_index=True, return_inverse=True)
    pairs = cKDTree(points[representative]).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(representative),) * 2)
    cluster = connected_components(graph, directed=False)[1][in_cell]
    _, first, label = np.unique(cluster, return_index=True, return_inverse=True)
    order = np.argsort(first)  # of the first of each
    first, label = first[order], np.argsort(order)[label]
    index = np.zeros(len(soup.positions), np.int64)
    index[used] = label
    return replace(soup, positions=points[first], position_index=index[soup.position_index])


def _swap_slivers(soup: Soup, rounds: int = 8) -> tuple[Soup, int, int]:
    """
    Replace faces of (almost) no area by swapping their long edge with the neighbour; drop those that have none.

    Dropping them all would tear the surface open: the neighbours of a collinear a-b-c do not share an edge.
    """
    swapped = dropped = 0
    tolerance = WELD_TOLERANCE * soup.diagonal
    for _ in range(rounds):
        p = soup.positions[soup.position_faces]
        edge = np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2)  # (F, 3), corner k to k + 1
        area2 = np.linalg.norm(area_vectors(p), axis=1)
        thin = area2 <= tolerance * edge.max(1)
        if not thin.any():
            break
        n_faces = len(soup.faces)
        other = np.full(3 * n_faces, -1)
        left, right = manifold_neighbours(soup.position_faces)
        other[left], other[right] = right, left
        face = np.flatnonzero(thin)
        k = edge[face].argmax(1)
        twin = other[k * n_faces + face]
        usable = (twin >= 0) & ~thin[twin % n_faces]
        face, k, twin = face[usable], k[usable], twin[usable]
        # one swap per face and round: the first sliver that asks for a neighbour gets it
        _, first = np.unique(twin % n_faces, return_index=True)
        face, k, twin = face[first], k[first], twin[first]
        if not len(face):
            break
        mate, km = twin % n_faces, twin // n_faces
        fp, f = soup.position_faces, soup.faces
        tip, tip_p = f[face, (k + 2) % 3], fp[face, (k + 2) % 3]
        a, b, d = f[mate, km], f[mate, (km + 1) % 3], f[mate, (km + 2) % 3]
        fine = tip_p != fp[mate, (km + 2) % 3]
        face, mate, tip, a, b, d = (x[fine] for x in (face, mate, tip, a, b, d))
        faces, material, part = f.copy(), soup.material_index.copy(), soup.part_index.copy()
        faces[mate] = np.stack([a, tip, d], 1)
        faces[face] = np.stack([tip, b, d], 1)
        material[face], part[face] = material[mate], part[mate]
        soup = replace(soup, faces=faces, material_index=material, part_index=part)
        swapped += len(face)
        if not len(face):
            break
    p = soup.positions[soup.position_faces]
    edge = np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2).max(1)
    thin = np.linalg.norm(area_vectors(p), axis=1) <= tolerance * edge
    dropped = int(thin.sum())
    return _keep(soup, ~thin), swapped, dropped
