"""
Normal maps beside those of a reference with the same texture coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..initial.unwrap.atlas import texel_counts
from ..model.asset import Asset, Part
from ..model.mesh import Mesh
from .metrics import normal_dissimilarity

#: How far apart the centres of triangles that are the same may be, in texture coordinates: files round these.
_SAME = 1e-3

#: The figure's name in ``metrics.json`` and ``log.jsonl``.
FIGURE = "normal_dissimilarity"


@dataclass(frozen=True)
class TrueNormals:
    """
    The normal maps of a reference, for models whose parts have the same triangles in texture coordinates.

    Parameters
    ----------
    maps : tuple of (int, ndarray, ndarray)
        Number of a part among :func:`used_parts`, its normal map (H, W, 3), and the texels that it shows (H, W).
    """

    maps: tuple[tuple[int, np.ndarray, np.ndarray], ...]

    @staticmethod
    def of(reference: Asset, model: Asset) -> TrueNormals | None:
        """
        Those that a model can be compared with; None where there are none, or its coordinates are others.
        """
        theirs, ours = used_parts(reference), used_parts(model)
        if len(theirs) != len(ours):
            return None
        maps = []
        for k, (a, b) in enumerate(zip(theirs, ours, strict=True)):
            normal = a.material.normal
            if normal is not None and _same_layout(a, b):
                maps.append((k, normal, _shown(a, normal.shape)))
        found = TrueNormals(tuple(maps))
        return found if np.isfinite(found.dissimilarity([None] * len(ours))) else None

    def dissimilarity(self, normals: Sequence[np.ndarray | None]) -> float:
        """
        :func:`.metrics.normal_dissimilarity` of the maps of all parts, None for flat ones; those that differ in size
        are read at the places of the reference's texels.
        """
        ours, theirs, shown = [], [], []
        for k, reference, mask in self.maps:
            normal = normals[k]
            flat = np.broadcast_to(np.array([0, 0, 1], np.float32), reference.shape)
            ours.append((flat if normal is None else _at(normal, reference.shape)).reshape(-1, 1, 3))
            theirs.append(reference.reshape(-1, 1, 3))
            shown.append(mask.reshape(-1, 1))
        if not ours:
            return float("nan")
        return normal_dissimilarity(*(np.concatenate(x) for x in (ours, theirs, shown)))


def used_parts(asset: Asset) -> list[Part]:
    """Every part that is placed, once, in the order of the instances."""
    return [asset.parts[k] for k in dict.fromkeys(instance.part for instance in asset.instances)]


def normal_figure(reference: Asset, model: Asset) -> dict[str, float]:
    """
    The figure of a model for ``metrics.json``; nothing where its coordinates are not those of the reference.
    """
    truth = TrueNormals.of(reference, model)
    if truth is None:
        return {}
    return {FIGURE: truth.dissimilarity([part.material.normal for part in used_parts(model)])}


def _same_layout(a: Part, b: Part) -> bool:
    if a.uvs is None or b.uvs is None or len(a.faces) != len(b.faces):
        return False
    centres = [part.uvs[part.faces].mean(1) for part in (a, b) if part.uvs is not None]
    return bool((cKDTree(centres[0]).query(centres[1])[0] < _SAME).all())


def _shown(part: Part, shape: tuple[int, ...]) -> np.ndarray:
    """Texels that any triangle of a part holds, shape (H, W)."""
    assert part.uvs is not None
    corners = np.zeros((1, 3))
    mesh = Mesh(corners, np.zeros(len(part.uvs), np.int64), part.uvs.astype(np.float32), part.faces)
    return _at((texel_counts(mesh, max(shape[:2])) > 0)[..., None], shape)[..., 0]


def _at(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """An image at the texel centres of another of this shape; the nearest texels."""
    if image.shape[:2] == shape[:2]:
        return image
    rows, columns = (((np.arange(n) + 0.5) / n * m).astype(int) for n, m in zip(shape, image.shape[:2], strict=False))
    return image[rows[:, None], columns]
