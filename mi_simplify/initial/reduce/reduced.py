"""
An asset cleaned and decimated to a budget, as one surface or a mesh for each of the nodes that are kept.
"""

from __future__ import annotations

import logging

import numpy as np

from ...errors import MeshError
from ...machine.runtime import ensure_variant
from ...model.asset import Asset
from ..nodes import Kept
from ..soup import merge
from .cleanup import clean
from .crumbs import components

log = logging.getLogger("mi_simplify")

#: Triangles of the smallest closed mesh, and the least budget.
LEAST = 4

#: How often a budget is tried, of which instances take a share that depends on what comes of it.
_TRIES = 6


def reduced(
    asset: Asset, triangles: int, *, keep_hidden: bool = False, resolution: int = 256
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """
    Positions (P, 3) and faces (F, 3) of the cleaned and decimated asset, and what was done and lost.

    Of an asset with a skeleton no part counts as hidden: it may come out in a pose.
    """
    require_budget(asset, triangles)
    surface = _Surface(asset, None, keep_hidden or asset.rig is not None, resolution)
    positions, faces, _, notes, warnings = surface.to(triangles)
    return positions, faces, surface.notes + notes + _warned(warnings)


def reduced_apart(
    asset: Asset, kept: Kept, triangles: int, *, resolution: int = 256
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str]]:
    """
    As :func:`reduced`, of the meshes of kept nodes, which share the budget, those of instances counted each.

    A collapse in a mesh that is shown k times costs k times the error and saves k times the triangles, so that the
    cheapest collapses of all meshes are those of the meshes shown once. Nothing counts as hidden.

    Returns
    -------
    positions, faces, notes
        As of :func:`reduced`; no position belongs to two meshes.
    of_position : ndarray, shape (P,), int64
        The mesh of each position.
    """
    require_budget(asset, triangles)
    surface, times = _Surface(kept.single, kept.mesh, True, resolution), kept.times()
    wanted = max(4, triangles * kept.single.n_triangles // asset.n_triangles)
    best = None
    for _ in range(_TRIES):
        found = surface.to(min(wanted, surface.n_faces))
        shown = int(times[surface.mesh_of[found[2]][found[1][:, 0]]].sum())
        if shown <= triangles and (best is None or shown > best[0]):
            best = shown, found
        if shown <= triangles and (shown >= 0.97 * triangles or wanted >= surface.n_faces):
            break
        step = max(1, abs(triangles - shown) * wanted // max(shown, 1))
        wanted = wanted + step if shown <= triangles else max(4, wanted - step)
    if best is None:
        raise MeshError(f"{triangles} triangles are too few for {int(times.sum())} meshes of kept nodes; ask for more")
    positions, faces, label, notes, warnings = best[1]
    return positions, faces, surface.mesh_of[label], surface.notes + notes + _warned(warnings)


def require_budget(asset: Asset, triangles: int) -> None:
    """
    Raise :class:`MeshError` where more triangles are asked for than an asset has, or it has too few for any budget.
    """
    if asset.n_triangles < LEAST:
        raise MeshError(f"{asset.name} has {asset.n_triangles} triangles, too few to simplify: {LEAST} are the least")
    if triangles > asset.n_triangles:
        raise MeshError(
            f"a budget of {triangles} triangles is above the input's own {asset.n_triangles} "
            f"({len(merge(asset).positions)} vertices); ask for fewer, as with --triangles "
            f"{max(LEAST, asset.n_triangles // 2)}"
        )


class _Surface:
    """A cleaned asset, of which several budgets can be tried."""

    def __init__(self, asset: Asset, mesh: np.ndarray | None, keep_hidden: bool, resolution: int):
        soup, self.notes = clean(merge(asset))
        ensure_variant()
        from .visibility import visibility  # traces rays

        self._opaque = np.array([m.alpha_mode == "OPAQUE" for m in soup.materials])[soup.material_index]
        self._names = np.array(soup.names)[soup.part_index]
        self._keep_hidden, self._resolution = keep_hidden, resolution
        self._positions, self._faces = soup.positions, soup.position_faces
        self._seen = visibility(soup.positions, soup.position_faces, self._opaque)
        of_face = np.zeros(len(self._faces), np.int64)
        if mesh is not None:
            shown = [m for m, i in zip(mesh, asset.instances, strict=True) if len(asset.parts[i.part].faces)]
            of_face = np.array(shown)[soup.part_index]
            self._come_apart(of_face)
        label = components(self._faces, len(self._positions))
        self.mesh_of = np.zeros(int(label.max()) + 1, np.int64)
        """The mesh of each component."""
        self.mesh_of[label[self._faces[:, 0]]] = of_face

    @property
    def n_faces(self) -> int:
        return len(self._faces)

    def _come_apart(self, of_face: np.ndarray) -> None:
        """Positions of their own for every mesh, also where meshes touch."""
        n = len(self._positions)
        place, faces = np.unique(of_face[:, None] * n + self._faces, return_inverse=True)
        self._positions, self._seen = self._positions[place % n], self._seen[place % n]
        self._faces = faces.reshape(-1, 3)

    def to(self, triangles: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str], list[str]]:
        """Positions, faces, the component of each position, notes and warnings."""
        from .parts import reduce_parts  # traces rays

        return reduce_parts(
            self._positions, self._faces, triangles, self._seen, self._opaque, self._names,
            keep_hidden=self._keep_hidden, resolution=self._resolution,
        )  # fmt: skip


def _warned(warnings: list[str]) -> list[str]:
    for line in warnings:
        log.warning("%s", line)
    return warnings
