"""
From an asset as files have them to one clean triangle set: weld, drop, repair, rewind, split.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..errors import MeshError
from ..latent.topology import vertex_normals, weld
from ..scenes.asset import Asset, Material

WELD_TOLERANCE = 1e-6
"""Positions closer than this share of the box's diagonal are one position."""


@dataclass(frozen=True)
class Soup:
    """
    All triangles of an asset in world space, with everything that a baker looks up.

    Parameters
    ----------
    positions : ndarray, shape (P, 3), float64
        Welded positions [world units].
    position_index : ndarray, shape (V,), int64
        Position of each vertex.
    faces : ndarray, shape (F, 3), int64
        Counter-clockwise *vertex* indices.
    uvs : ndarray, shape (V, 2), float32
        Texture coordinates, origin top left; zero where the part has none.
    normals : ndarray, shape (V, 3), float32
        Unit shading normals: the file's, or angle-weighted over welded positions where it has none.
    colors : ndarray, shape (V, 4), float32
        Linear vertex colour and opacity; one where the part has none.
    has_normals : ndarray, shape (V,), bool
        Whether the normal is the file's.
    material_index : ndarray, shape (F,), int64
        Index into ``materials``.
    """

    positions: np.ndarray
    position_index: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    has_normals: np.ndarray
    material_index: np.ndarray
    materials: tuple[Material, ...]

    @property
    def vertices(self) -> np.ndarray:
        """Positions per vertex, shape (V, 3)."""
        return self.positions[self.position_index]

    @property
    def position_faces(self) -> np.ndarray:
        """Faces over welded positions, shape (F, 3)."""
        return self.position_index[self.faces]

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal over referenced positions [world units]."""
        used = self.positions[np.unique(self.position_faces)]
        return float(np.linalg.norm(np.ptp(used, axis=0))) if len(used) else 0.0


def merge(asset: Asset) -> Soup:
    """
    All instances of an asset as one world-space triangle set, equal coordinates welded, nothing dropped.

    Raises
    ------
    MeshError
        The asset has no triangles.
    """
    parts = [p for p in asset.placed() if len(p.faces)]
    if not parts:
        raise MeshError(f"{asset.name}: no triangles to simplify; check that the file holds a mesh")
    materials: list[Material] = []
    uvs, normals, colors, has_normals, faces, vertices, material_index = [], [], [], [], [], [], []
    start = 0
    for part in parts:
        n = len(part.vertices)
        known = [i for i, m in enumerate(materials) if m is part.material]
        if not known:
            materials.append(part.material)
        material_index.append(np.full(len(part.faces), known[0] if known else len(materials) - 1))
        vertices.append(np.asarray(part.vertices, np.float64))
        faces.append(np.asarray(part.faces, np.int64) + start)
        uvs.append(np.zeros((n, 2), np.float32) if part.uvs is None else np.float32(part.uvs))
        colors.append(np.ones((n, 4), np.float32) if part.colors is None else np.float32(part.colors))
        has_normals.append(np.full(n, part.normals is not None))
        if part.normals is None:
            p, index = weld(vertices[-1])
            normals.append(vertex_normals(p, index[part.faces])[index].astype(np.float32))
        else:
            normals.append(np.float32(part.normals))
        start += n
    positions, position_index = weld(np.concatenate(vertices))
    return Soup(
        positions=positions,
        position_index=position_index,
        faces=np.concatenate(faces),
        uvs=np.concatenate(uvs),
        normals=np.concatenate(normals),
        colors=np.concatenate(colors),
        has_normals=np.concatenate(has_normals),
        material_index=np.concatenate(material_index),
        materials=tuple(materials),
    )


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
    return replace(soup, faces=soup.faces[which], material_index=soup.material_index[which])


def _weld_near(soup: Soup, tolerance: float) -> Soup:
    """Merge positions that lie within ``tolerance``, chains of them too; drop the unreferenced ones."""
    used = np.unique(soup.position_faces)
    points = soup.positions[used]
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    n, label = connected_components(graph, directed=False)
    first = np.full(n, len(points))
    np.minimum.at(first, label, np.arange(len(points)))
    index = np.zeros(len(soup.positions), np.int64)
    index[used] = label
    return replace(soup, positions=points[first], position_index=index[soup.position_index])


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


def _manifold_neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Half-edges that meet in an edge of exactly two faces: two arrays of ``corner * F + face``, shape (M,) each.
    """
    _, edge_of, counts = edge_pairs(faces)
    flat = edge_of.ravel()
    order = np.argsort(flat, kind="stable")
    start = np.cumsum(counts) - counts
    two = start[counts == 2]
    return order[two], order[two + 1]


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
        area2 = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        thin = area2 <= tolerance * edge.max(1)
        if not thin.any():
            break
        n_faces = len(soup.faces)
        other = np.full(3 * n_faces, -1)
        left, right = _manifold_neighbours(soup.position_faces)
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
        faces, material = f.copy(), soup.material_index.copy()
        faces[mate] = np.stack([a, tip, d], 1)
        faces[face] = np.stack([tip, b, d], 1)
        material[face] = material[mate]
        soup = replace(soup, faces=faces, material_index=material)
        swapped += len(face)
        if not len(face):
            break
    p = soup.positions[soup.position_faces]
    edge = np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2).max(1)
    thin = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) <= tolerance * edge
    dropped = int(thin.sum())
    return _keep(soup, ~thin), swapped, dropped


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
    left, right = _manifold_neighbours(faces)
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
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
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


def split_nonmanifold(positions: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Cut the surface open along edges of more than two faces, and apart at vertices where fans only touch.

    Corners are joined across edges that have exactly two faces, and nothing else (Guéziec et al. 2001).

    Returns
    -------
    origin : ndarray, shape (Q,)
        The position that each new one is a copy of; the surface is ``positions[origin]``.
    faces : ndarray, shape (F, 3)
        Indices into ``origin``.
    """
    n_faces = len(faces)
    left, right = _manifold_neighbours(faces)
    start = faces.T.ravel()
    end = np.roll(np.arange(3 * n_faces).reshape(3, n_faces), -1, axis=0).ravel()  # half-edge that follows in its face
    same = start[left] == start[right]
    rows = np.concatenate([left, end[left]])
    cols = np.concatenate([np.where(same, right, end[right]), np.where(same, end[right], right)])
    graph = coo_array((np.ones(len(rows), bool), (rows, cols)), shape=(3 * n_faces,) * 2)
    n, label = connected_components(graph, directed=False)
    origin = np.zeros(n, np.int64)
    origin[label] = start
    return origin, label.reshape(3, n_faces).T
