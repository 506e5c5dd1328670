"""
How a model uses its textures: in how many charts, and how much of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..initial.unwrap.atlas import texel_counts
from ..initial.unwrap.charting import charts
from ..model.asset import Part
from ..model.mesh import Mesh

_SIZE = 512
"""Side of the grid on which the fill is counted."""
_BEYOND = 1e-3
"""Coordinates so far outside the image still count as inside."""


def atlas_use(parts: Sequence[Part]) -> dict[str, float | int | None]:
    """
    Charts and fill of a model for ``metrics.json``.

    Parameters
    ----------
    parts : sequence of Part
        Each once, however often it is placed.

    Returns
    -------
    dict
        ``charts``: sets of faces that hang together in the texture. ``fill``: share of the textures' area, each
        material's once, that shows on the surface. Both are None where nothing has coordinates and a texture; ``fill``
        where textures repeat, which no chart fills.
    """
    materials: dict[int, list[Part]] = {}
    for part in parts:
        images = (part.material.base_color, part.material.specular, part.material.normal)
        if part.uvs is not None and any(x is not None and x[..., 0].size > 1 for x in images):
            materials.setdefault(id(part.material), []).append(part)
    if not materials:
        return {"charts": None, "fill": None}
    meshes = [_joined(own) for own in materials.values()]
    repeats = any(m.uvs.min() < -_BEYOND or m.uvs.max() > 1 + _BEYOND for m in meshes)
    fill = None if repeats else float(np.mean([(texel_counts(m, _SIZE) > 0).mean() for m in meshes]))
    return {"charts": sum(charts(mesh)[1] for mesh in meshes), "fill": fill}


def _joined(parts: Sequence[Part]) -> Mesh:
    """One mesh of all parts of a material; what lies in one place of space and texture is one vertex."""
    start = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + n for part, n in zip(parts, start, strict=False)])
    positions = np.concatenate([part.vertices for part in parts])
    own = np.repeat(np.arange(len(parts)), np.diff(start))  # two parts in one place are two charts
    _, place = np.unique(np.column_stack([own, positions]), axis=0, return_inverse=True)
    uvs = np.concatenate([part.uvs for part in parts if part.uvs is not None])
    return Mesh(positions, place.reshape(-1), uvs.astype(np.float32), faces)
