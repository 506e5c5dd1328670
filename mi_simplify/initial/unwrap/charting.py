"""
Texture coordinates for a low-poly mesh: charts cut, laid flat and packed; and a check of any layout.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...errors import MeshError
from ...model.mesh import Mesh
from ..manifold import edge_pairs
from .flatten import Flat, border_loops, flatten
from .packing import pack
from .segmentation import Segments, segment
from .splits import creased, split_where_it_pays

_THIN = 4.0
"""Charts narrower than this many texels lose their colour in the first mip levels."""
_STRETCH = 1.05
"""Largest L2 stretch of a chart."""


def unwrap(
    positions: np.ndarray,
    faces: np.ndarray,
    *,
    atlas_size: int = 1024,
    padding: int = 4,
    crease_angle: float = 180.0,
    hard: np.ndarray | None = None,
    split: float = 1.0,
    weights: np.ndarray | None = None,
) -> tuple[Mesh, list[str]]:
    """
    Cut a mesh into charts and pack them into one square texture without overlap.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
        Welded positions.
    faces : ndarray, shape (F, 3)
        Indices into ``positions``.
    atlas_size : int
        Side of the texture [texels].
    padding : int
        Empty texels between charts.
    crease_angle : float
        Edges that turn by more may get two normals [degrees]; 180 has none.
    hard : ndarray, shape (F, 3), bool, optional
        Edges, from corner k to corner k + 1, at which a crease may run inside a chart; elsewhere one runs along the
        borders of charts only, where it costs no vertex. Everywhere if not given.
    split : float
        Vertices a position up to which further ones get two normals, see :func:`.splits.split_where_it_pays`. Only with
        ``hard``.
    weights : ndarray, shape (F,), optional
        How much the normals of a face count there, beside its area.

    Returns
    -------
    mesh : Mesh
        The same faces in the same order; no chart is mirrored.
    notes : list of str
        Warnings of the check.

    Raises
    ------
    MeshError
        The charts do not fit ``atlas_size``.
    """
    if len(faces) == 0:
        raise MeshError("nothing to unwrap: the mesh has no faces")
    positions = np.asarray(positions, np.float64)
    centred = positions - positions.min(0)
    centred /= max(float(centred.max()), 1e-300)
    place, chart_faces, flat, chart = _laid_flat(centred, faces, segment(centred, faces, crease_angle, hard))
    owner = np.zeros(len(place), np.int64)
    owner[chart_faces] = chart[:, None]
    uvs = pack(flat, border_loops(chart_faces), owner, atlas_size, padding)
    uvs[:, 1] = atlas_size - uvs[:, 1]  # the charts were wound for v up
    mesh = Mesh(positions, place, (uvs / atlas_size).astype(np.float32), chart_faces)
    mesh = creased(mesh, crease_angle, hard)
    if hard is not None:
        mesh = split_where_it_pays(mesh, crease_angle, int(split * len(np.unique(faces))), weights)
    return mesh, check(mesh, atlas_size)


def _laid_flat(positions, faces, segments: Segments) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Position of every vertex (V,), faces over vertices (F, 3), places in the plane (V, 2), and the chart of every face.

    A chart that stretches too much or overlaps itself is parted into those that it was merged from.
    """
    chart, corners = segments.chart.copy(), np.zeros((*faces.shape, 2))
    doubtful = np.ones(len(faces), bool)
    while doubtful.any():
        _, of = np.unique(chart[doubtful], return_inverse=True)
        place, local = _cut(faces[doubtful], of)
        flat: Flat = flatten(positions[place], local, of)
        corners[doubtful] = flat.uvs[local]
        bad = (flat.overlaps | (flat.stretch > _STRETCH)) & (np.bincount(of) > 1)
        which = np.flatnonzero(doubtful)
        doubtful[which[~bad[of]]] = False
        chart = segments.parted(chart, doubtful)
    _, chart = np.unique(chart, return_inverse=True)
    place, local = _cut(faces, chart)
    uvs = np.zeros((len(place), 2))
    uvs[local] = corners
    return place, local, uvs, chart


def _cut(faces: np.ndarray, chart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that belong to one chart each: their positions (V,), and the faces over them (F, 3)."""
    n = int(faces.max()) + 1
    place, local = np.unique(chart[:, None] * n + faces, return_inverse=True)
    return place % n, local.reshape(-1, 3)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def check(mesh: Mesh, size: int) -> list[str]:
    """
    Warnings, one line each, where a texture of ``size``² texels serves a mesh badly.
    """
    q = mesh.uvs[mesh.faces].astype(np.float64) * size
    area = np.abs(_cross(q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])) / 2  # texels a triangle
    chart, n_charts = charts(mesh)
    edge = np.linalg.norm(np.roll(q, -1, axis=1) - q, axis=2)  # (F, 3), corner k to k + 1
    _, edge_of, counts = edge_pairs(_places(mesh)[mesh.faces])
    rim = np.bincount(chart, (edge * (counts[edge_of] == 1).T).sum(1), n_charts)
    width = 2 * np.bincount(chart, area, n_charts) / np.maximum(rim, 1e-12)  # exact for a long strip
    thin = float(area[(width < _THIN)[chart]].sum() / max(area.sum(), 1e-12))
    notes = []
    if np.median(area) < 16:
        notes.append(
            f"only {np.median(area):.1f} texels a triangle in a {size}² atlas; use a larger atlas or fewer triangles"
        )
    if thin > 0.05:
        notes.append(f"{thin:.0%} of the surface lies in charts narrower than {_THIN:g} texels; use a larger atlas")
    if area.sum() < 0.3 * size**2:
        notes.append(f"charts cover only {area.sum() / size**2:.0%} of the atlas")
    return notes


def charts(mesh: Mesh) -> tuple[np.ndarray, int]:
    """
    Chart of every face, shape (F,), numbered in the order of the faces, and their number: faces that share places
    in the texture.
    """
    f = _places(mesh)[mesh.faces]
    n = len(mesh.uvs)
    graph = coo_array((np.ones(2 * len(f), bool), (f[:, [0, 0]].ravel(), f[:, 1:].ravel())), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    _, first, chart = np.unique(label[f[:, 0]], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[chart], len(first)


def _places(mesh: Mesh) -> np.ndarray:
    """One number for the vertices that differ in their normals only, shape (V,)."""
    rows = np.column_stack([mesh.position_index, mesh.uvs])
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
