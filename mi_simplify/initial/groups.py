"""
Which group of the asset's materials every face of a low-poly mesh belongs to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..model.asset import Asset, Part
from ..model.groups import Group, Groups, group_of
from ..model.mesh import Mesh
from .closest import ClosestPoints, sample_surface
from .soup import Soup, merge

#: How far from a surface a layer still lies on it [diagonals of the asset]; modellers lift decals by half of it.
NEAR = 2e-3

#: Weights of the corners at the points of a face that vote.
_VOTES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])

#: Share of the area of a group that may be seen from the wrong side before its back is shown as well.
_TURNED = 0.01

#: Points by which that is measured.
_POINTS = 20_000


@dataclass(frozen=True)
class Grouping:
    """
    Parameters
    ----------
    groups : Groups
        Of the low-poly mesh.
    of_material : ndarray, shape (M,), int64
        Index into its kinds of each of the asset's materials, as :func:`.soup.merge` numbers them; -1 for one whose
        group has no face.
    """

    groups: Groups
    of_material: np.ndarray

    def split(self, times: int) -> Grouping:
        """Of a mesh whose faces are split in four so often."""
        return replace(self, groups=self.groups.split(times))


def kinds_of(asset: Asset, soup: Soup) -> tuple[tuple[Group, ...], np.ndarray]:
    """
    The groups of an asset.

    Returns
    -------
    kinds : tuple of Group
        Distinct.
    of_material : ndarray, shape (M,), int64
        Group of each of the soup's materials.
    """
    parts: dict[int, list[Part]] = {}
    for instance in asset.instances:
        part = asset.parts[instance.part]
        parts.setdefault(id(part.material), []).append(part)
    kinds: list[Group] = []
    of_material = []
    for material in soup.materials:
        found = group_of(parts[id(material)])
        k = next((k for k, kind in enumerate(kinds) if kind.like(found)), len(kinds))
        kinds += [found] if k == len(kinds) else []
        of_material.append(k)
    return tuple(kinds), np.array(of_material, np.int64)


def grouped(asset: Asset, mesh: Mesh) -> Grouping:
    """
    The group of each face of a low-poly mesh: that of most of the asset's surface around it that faces alike.

    A group whose back is not to be seen is shown from both sides all the same where the low-poly mesh has lost one of
    the sides, or turned it.
    """
    soup = merge(asset)
    kinds, of_material = kinds_of(asset, soup)
    reference = ClosestPoints(soup.vertices, soup.faces)
    group = of_material[soup.material_index]
    if len(kinds) == 1:
        of_face = np.zeros(len(mesh.faces), np.int64)
    else:
        of_face = _voted(mesh, reference, soup, kinds, group)
    if any(not kind.double_sided for kind in kinds):
        kinds = _sides(kinds, of_face, mesh, reference, group)
    used, of_face = np.unique(of_face, return_inverse=True)
    new = np.full(len(kinds), -1)
    new[used] = np.arange(len(used))
    return Grouping(Groups(tuple(kinds[k] for k in used), of_face.reshape(-1)), new[of_material])


def _voted(mesh: Mesh, reference: ClosestPoints, soup: Soup, kinds: tuple[Group, ...], group: np.ndarray) -> np.ndarray:
    """
    Index of the group with most of the points of each face, shape (F,).

    Where a point is on a layer that blends, such as a decal, and an opaque surface lies right below, that has the vote:
    the bake shows both as one.
    """
    blended = np.array([kind.alpha_mode == "BLEND" for kind in kinds])[group]
    opaque = np.flatnonzero(np.array([kind.alpha_mode == "OPAQUE" for kind in kinds])[group])
    below = ClosestPoints(soup.vertices, soup.faces[opaque]) if blended.any() and len(opaque) else None
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    votes = np.zeros((len(corners), len(kinds)))
    rows = np.arange(len(corners))
    for weights in _VOTES:
        found = reference.query(np.einsum("c,fci->fi", weights, corners), normals, candidates=8)
        voted = group[found.face]
        layer = np.flatnonzero(blended[found.face])
        if below is not None and len(layer):
            base = below.query(found.point[layer], reference.normals[found.face[layer]], candidates=8)
            lies_on = base.distance <= NEAR * soup.diagonal
            voted[layer[lies_on]] = group[opaque[base.face[lies_on]]]
        votes[rows, voted] += 1
    return votes.argmax(1)


def _sides(
    kinds: tuple[Group, ...], of_face: np.ndarray, mesh: Mesh, reference: ClosestPoints, group: np.ndarray
) -> tuple[Group, ...]:
    """The groups, those with both sides shown that need it: measured at points of the asset."""
    own = ClosestPoints(mesh.vertices, mesh.faces)
    points, face = sample_surface(reference.corners, reference.double_area, _POINTS, seed=3)
    if len(points) > 2 * _POINTS:
        points, face = points[-_POINTS:], face[-_POINTS:]
    found = own.query(points, reference.normals[face], candidates=8)
    away = np.einsum("ni,ni->n", own.normals[found.face], reference.normals[face]) <= 0
    weight = reference.double_area[face] / np.bincount(face, minlength=len(group))[face]
    lost = np.bincount(group[face], weight * away, len(kinds)) / np.maximum(np.bincount(group[face], weight), 1e-300)
    return tuple(
        kind if kind.double_sided or lost[k] <= _TURNED else replace(kind, double_sided=True)
        for k, kind in enumerate(kinds)
    )
