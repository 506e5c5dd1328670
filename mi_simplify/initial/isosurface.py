"""
A detailed mesh of an implicit surface, so that everything that starts from a mesh starts from it, too.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine import memory
from ..machine.upload import upload
from ..model.asset import Asset, Instance, Material, Part
from ..model.marching_cubes import marching_cubes
from ..scenes.implicit.surface import Implicit

#: Points whose distances are computed at once.
_CHUNK = 1 << 22

#: Steps along the gradient that put vertices of marching cubes onto the surface.
_PROJECTIONS = 3


def isosurface(surface: Implicit, resolution: int = 192) -> Asset:
    """
    Marching cubes (scikit-image's, Lewiner et al. 2003), its vertices moved onto the surface.

    Parameters
    ----------
    surface : Implicit
    resolution : int
        Cells along the longest side of its box.

    Returns
    -------
    Asset
        One part with exact normals and vertex colours, in the units of the surface. Roughness and metalness
        are means over the vertices: the material of a part is one.

    Raises
    ------
    AssetError
        Nothing of the surface is that large.
    """
    box = surface.box
    cell = float((box[1] - box[0]).max()) / resolution
    low = box[0] - cell
    counts = np.ceil((box[1] - box[0]) / cell).astype(int) + 3
    memory.require(float(np.prod(counts)) * 24, "the isosurface", "lower implicit.resolution")
    grid = _sampled(surface, low, cell, counts)
    positions, faces = marching_cubes(grid, low, [cell] * 3, surface.name)
    positions, normals = _projected(surface, positions, cell)
    found = surface.surfel(upload(mi.Point3f, positions))
    n = len(positions)
    color = np.broadcast_to(found.base_color.numpy().T, (n, 3))
    scalars = [float(np.mean(x.numpy())) for x in (found.roughness, found.metallic)]
    material = Material(surface.name, np.ones((1, 1, 4), np.float32), np.array([[[0, *scalars]]], np.float32))
    colors = np.concatenate([color, np.ones((n, 1))], axis=1).astype(np.float32)
    part = Part(positions, faces, normals.astype(np.float32), None, colors, material, surface.name)
    return Asset((part,), (Instance(0, name=surface.name),), name=surface.name)


def _sampled(surface: Implicit, low: np.ndarray, cell: float, counts: np.ndarray) -> np.ndarray:
    """Distances on a grid, shape ``counts``; slab by slab."""
    out = np.empty(counts, np.float32)
    slab = max(1, _CHUNK // int(counts[1] * counts[2]))
    rest = np.stack(np.meshgrid(*(np.arange(c) for c in counts[1:]), indexing="ij"), -1).reshape(-1, 2)
    for first in range(0, counts[0], slab):
        rows = np.arange(first, min(first + slab, counts[0]))
        index = np.concatenate([np.repeat(rows, len(rest))[:, None], np.tile(rest, (len(rows), 1))], axis=1)
        out[rows] = surface.at(low + index * cell).reshape(len(rows), *counts[1:])
    return out


def _projected(surface: Implicit, positions: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions after some steps of Newton's method, none of them longer than a cell, and unit normals there."""
    p = upload(mi.Point3f, positions)
    for _ in range(_PROJECTIONS):
        g = surface.gradient(p)
        step = g * (surface.distance(p) / dr.maximum(dr.squared_norm(g), 1e-12))
        p -= step * dr.minimum(1, 0.5 * cell * dr.rsqrt(dr.maximum(dr.squared_norm(step), 1e-20)))
        dr.eval(p)
    g = surface.gradient(p)
    return p.numpy().T.astype(np.float64), (g * dr.rsqrt(dr.maximum(dr.squared_norm(g), 1e-12))).numpy().T
