"""
Morph targets, applied with fixed weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import AssetError, MeshError
from ...model.asset import Morph
from .file import GltfFile


def morphed(
    file: GltfFile, primitive: dict[str, Any], key: str, values: np.ndarray, weights: Sequence[float] | None
) -> np.ndarray:
    """
    An attribute with the displacements of all targets added, each times its weight (glTF 3.7.2.2).

    Parameters
    ----------
    primitive : dict
    key : str
        'POSITION', 'NORMAL', 'TEXCOORD_0', …
    values : ndarray, shape (V, C)
        The attribute itself.
    weights : sequence of float, optional
        One for each target; missing ones are 0.

    Returns
    -------
    ndarray, shape (V, C)
        ``values`` itself where nothing changes; normals are not of unit length.

    Raises
    ------
    MeshError
        A target has another number of vertices.
    AssetError
        A weight is no finite number.
    """
    out = values
    for k, (target, weight) in enumerate(zip(primitive.get("targets") or (), weights or (), strict=False)):
        if not isinstance(weight, (int, float)) or not np.isfinite(weight):
            raise AssetError(f"{file.name}: a morph weight is no number; export the file again")
        if not weight or key not in target:
            continue
        offset = file.accessor(target[key])
        if offset.shape[0] != len(values) or offset.ndim != values.ndim:
            raise MeshError(f"{file.name}: {key} of morph target {k} has {len(offset)} rows for {len(values)} vertices")
        n = min(offset.shape[1], values.shape[1])  # colours may have an opacity that their offsets lack
        out = out.astype(np.float64) if out is values else out
        out[:, :n] += weight * offset[:, :n]
    return out


def morph_targets(
    file: GltfFile, primitive: dict[str, Any], names: Sequence[str], weights: Sequence[float] | None, n_vertices: int,
    used: np.ndarray,
) -> tuple[Morph, ...]:  # fmt: skip
    """
    The targets that move positions, by name, at some of the vertices; numbered where the file has no names.

    Raises
    ------
    MeshError
        A target has another number of vertices, or is not finite.
    """
    out = []
    for k, target in enumerate(primitive.get("targets") or ()):
        if "POSITION" not in target:
            continue
        offsets = file.accessor(target["POSITION"])
        if offsets.shape != (n_vertices, 3) or not np.isfinite(offsets[used]).all():
            raise MeshError(f"{file.name}: morph target {k} does not fit its {n_vertices} vertices; export it again")
        name = names[k] if k < len(names) else f"target {k}"
        weight = float(weights[k]) if weights is not None and k < len(weights) else 0.0
        out.append(Morph(name, offsets[used].astype(np.float64), weight))
    return tuple(out)
