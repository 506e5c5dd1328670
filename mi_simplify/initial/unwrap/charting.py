"""
Texture coordinates for a low-poly mesh: xatlas within a time limit, or the mesh's own, and a check of either.
"""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...errors import MeshError
from ...model.mesh import Mesh
from ...model.topology import area_vectors, normal_groups, vertex_normals
from ..manifold import edge_pairs

_ATTEMPTS = (3, 10)
"""Fewest and most packings that are tried; about 12,000 triangles are unwrapped in all."""
_THIN = 4.0
"""Charts narrower than this many texels lose their colour in the first mip levels."""


def unwrap(
    positions: np.ndarray,
    faces: np.ndarray,
    *,
    atlas_size: int = 1024,
    padding: int = 4,
    time_limit: float = 60.0,
    crease_angle: float = 180.0,
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
    time_limit : float
        Seconds that xatlas may take before every triangle becomes a chart of its own.
    crease_angle : float
        Edges that turn by more get two normals, inside a chart as well [degrees]; 180 has none.

    Returns
    -------
    mesh : Mesh
        The same faces in the same order; no chart is mirrored.
    notes : list of str
        Warnings of the check, and whether the time limit was hit.

    Raises
    ------
    MeshError
        The triangles do not fit ``atlas_size``.
    """
    if len(faces) == 0:
        raise MeshError("nothing to unwrap: the mesh has no faces")
    notes: list[str] = []
    normals = vertex_normals(positions, faces, by_area=True)
    try:
        index, uvs, out_faces = _run_xatlas(positions, faces, normals, atlas_size, padding, time_limit)
    except _Failed as failure:
        notes.append(f"xatlas {failure}; every triangle is a chart of its own, which wastes texels and adds seams")
        index, uvs, out_faces = triangle_charts(positions, faces, atlas_size, padding)
    uvs[:, 1] = atlas_size - uvs[:, 1]  # xatlas winds its charts for v up
    groups = normal_groups(positions, faces, crease_angle)
    pairs = np.stack([out_faces.ravel(), groups.ravel()], 1)  # a vertex has one place in the atlas and one normal
    pairs, vertex = np.unique(pairs, axis=0, return_inverse=True)
    of = pairs[:, 0]
    mesh = Mesh(
        np.asarray(positions, np.float64),
        index[of],
        (uvs / atlas_size).astype(np.float32)[of],
        vertex.reshape(-1, 3),
        pairs[:, 1],
    )
    return mesh, notes + check(mesh, atlas_size)


class _Failed(Exception):
    """xatlas did not deliver; the message completes the sentence "xatlas …"."""


def _run_xatlas(positions, faces, normals, size: int, padding: int, time_limit: float):
    """Vertex origins (V,), UVs (V, 2) in texels, v up, and faces (F, 3), from a process that can be ended."""
    centre = positions.min(0)
    scale = 100 / max(float(np.ptp(positions, axis=0).max()), 1e-30)  # xatlas compares areas with absolute epsilons
    attempts = int(np.clip(12_000 // len(faces), *_ATTEMPTS))
    job = io.BytesIO()
    np.savez(
        job, positions=(positions - centre) * scale, faces=faces, normals=normals, size=size, padding=padding,
        attempts=attempts,
    )  # fmt: skip
    command = [sys.executable, str(Path(__file__).with_name("xatlas_worker.py"))]
    try:
        done = subprocess.run(command, input=job.getvalue(), capture_output=True, timeout=time_limit, check=False)
    except subprocess.TimeoutExpired:
        raise _Failed(f"took longer than {time_limit:g} s") from None
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        raise _Failed(f"failed ({last[0]})")
    out = np.load(io.BytesIO(done.stdout))
    index, uvs, out_faces = out["index"].astype(np.int64), out["uvs"].astype(np.float64), out["faces"].astype(np.int64)
    if out_faces.shape != faces.shape or not np.array_equal(index[out_faces], faces):
        raise _Failed("changed the faces")
    q, p = uvs[out_faces], positions[faces]
    lost = np.abs(_cross(q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])) < 1e-6
    lost &= np.linalg.norm(area_vectors(p), axis=1) * scale**2 > 1e-6
    if lost.any():
        raise _Failed(f"left {int(lost.sum())} triangles without texels")
    return index, uvs, out_faces


def triangle_charts(positions: np.ndarray, faces: np.ndarray, size: int, padding: int):
    """
    Two triangles to a square cell, longest edge along the diagonal; works for any triangle set.

    Returns
    -------
    index : ndarray, shape (3F,)
    uvs : ndarray, shape (3F, 2), float64
        Texels, v up.
    faces : ndarray, shape (F, 3)
    """
    n = len(faces)
    columns = int(np.ceil(np.sqrt((n + 1) // 2)))
    cell = size / columns
    gap = min(padding, cell / 4)
    if cell < 4:
        need = 4 * columns
        raise MeshError(f"{n} triangles do not fit a {size}² atlas; use an atlas size of at least {need}")
    p = positions[faces]
    longest = np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2).argmax(1)  # edge k to k + 1
    order = (longest[:, None] + np.arange(3)) % 3
    k = np.arange(n) // 2
    corner = np.stack([k % columns, k // columns], 1)[:, None] * cell
    a, b = gap / 2, cell - gap / 2
    lower = np.array([[b - gap, a], [a, b - gap], [a, a]])
    upper = np.array([[a + gap, b], [b, a + gap], [b, b]])
    local = np.where((np.arange(n) % 2 == 0)[:, None, None], lower, upper)
    uvs = np.empty((n, 3, 2))
    np.put_along_axis(uvs, order[..., None], corner + local, axis=1)
    return faces.ravel(), uvs.reshape(-1, 2), np.arange(3 * n).reshape(n, 3)


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
