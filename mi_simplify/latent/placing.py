"""
Meshes that stand in several places: optimised once, rendered everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from ..model.mesh import Mesh
from ..model.model import Model
from ..scenes.views import Views
from .operation import register_operation
from .surface import MeshTopology, Surface


@dataclass(frozen=True)
class Placements:
    """
    Further places of some of a model's faces.

    Parameters
    ----------
    faces : tuple of ndarray, shape (f,), int64
        Of every further place, the faces of the mesh that stand there, too.
    to_there : tuple of ndarray, shape (4, 4)
        The affine transforms that bring them there; may mirror.
    """

    faces: tuple[np.ndarray, ...]
    to_there: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class PlacedModel(Model):
    """
    A model some of whose faces stand in several places.
    """

    placements: Placements | None = None

    def transformed(self, scale: float, offset: np.ndarray) -> PlacedModel:
        """See :class:`..model.model.Model`."""
        moved = super().transformed(scale, offset)
        assert isinstance(moved, PlacedModel)
        if self.placements is None:
            return moved
        to_new, to_old = np.eye(4), np.eye(4)
        to_new[:3] = np.column_stack([np.eye(3) * scale, offset])
        to_old[:3] = np.column_stack([np.eye(3) / scale, -np.asarray(offset) / scale])
        there = tuple(to_new @ matrix @ to_old for matrix in self.placements.to_there)
        return replace(moved, placements=Placements(self.placements.faces, there))


class Placed:
    """
    Rendered positions ``A_k v``: affine transforms of the base positions, in all places one behind the other.

    Parameters
    ----------
    model : PlacedModel
        With placements.
    """

    def __init__(self, model: PlacedModel):
        assert model.placements is not None
        base = self.base = model.mesh
        self.parameters: dict[str, np.ndarray] = {}
        position, matrix = [np.arange(len(base.positions))], [np.tile(np.eye(4), (len(base.positions), 1, 1))]
        meshes = [base]
        for faces, to_there in zip(model.placements.faces, model.placements.to_there, strict=True):
            copy, of = _taken(base, faces, to_there)
            meshes.append(copy)
            position.append(of)
            matrix.append(np.tile(to_there, (len(of), 1, 1)))
        self.mesh = _joined(meshes)
        self._source = upload(mi.UInt32, np.concatenate(position))
        rows = np.concatenate(matrix)[:, :3].reshape(-1, 12)
        self._rows = [upload(mi.Vector4f, rows[:, 4 * k : 4 * k + 4]) for k in range(3)]

    def positions(self, base: mi.Float, parameters: dict[str, mi.Float], views: Views) -> mi.Float:
        """See :class:`.operation.MeshOperation`."""
        p = dr.gather(mi.Point3f, base, self._source)
        moved = [dr.fma(r.x, p.x, dr.fma(r.y, p.y, dr.fma(r.z, p.z, r.w))) for r in self._rows]
        return dr.ravel(mi.Point3f(*moved))

    def surface(
        self, topology: MeshTopology, positions: mi.Float, base: mi.Float, parameters: dict[str, mi.Float], views: Views
    ) -> Surface:
        """See :class:`.operation.MeshOperation`."""
        return topology.surface(positions)

    def written(self, model: Model, parameters: dict[str, np.ndarray]) -> Model:
        """See :class:`.operation.MeshOperation`."""
        return model


def _taken(mesh: Mesh, faces: np.ndarray, to_there: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """Some faces of a mesh in another place, and the positions that are theirs."""
    vertex, corner = np.unique(mesh.faces[faces], return_inverse=True)
    position, position_index = np.unique(mesh.position_index[vertex], return_inverse=True)
    group, normal_index = np.unique(mesh.normal_groups[vertex], return_inverse=True)
    corner = corner.reshape(-1, 3)
    linear = to_there[:3, :3]
    mirrored = np.linalg.det(linear) < 0
    normals = None
    if mesh.own_normals is not None:
        cofactors = np.cross(np.roll(linear, -1, axis=0), np.roll(linear, -2, axis=0))
        normals = mesh.own_normals[group] @ cofactors.T * (-1 if mirrored else 1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    placed = Mesh(
        positions=mesh.positions[position] @ linear.T + to_there[:3, 3],
        position_index=position_index.reshape(-1),
        uvs=mesh.uvs[vertex],
        faces=corner[:, ::-1] if mirrored else corner,
        normal_index=normal_index.reshape(-1),
        own_normals=normals,
        cell_index=None if mesh.cell_index is None else mesh.cell_index[faces],
    )
    return placed, position


def _joined(meshes: list[Mesh]) -> Mesh:
    """All of them as one."""

    def shifted(arrays: list[np.ndarray], sizes: list[int]) -> np.ndarray:
        starts = np.cumsum([0, *sizes[:-1]])
        return np.concatenate([array + start for array, start in zip(arrays, starts, strict=True)])

    n_groups = [int(mesh.normal_groups.max()) + 1 for mesh in meshes]
    first = meshes[0]
    return Mesh(
        positions=np.concatenate([mesh.positions for mesh in meshes]),
        position_index=shifted([mesh.position_index for mesh in meshes], [len(mesh.positions) for mesh in meshes]),
        uvs=np.concatenate([mesh.uvs for mesh in meshes]),
        faces=shifted([mesh.faces for mesh in meshes], [len(mesh.uvs) for mesh in meshes]),
        normal_index=shifted([mesh.normal_groups for mesh in meshes], n_groups),
        own_normals=None
        if first.own_normals is None
        else np.concatenate([mesh.own_normals for mesh in meshes if mesh.own_normals is not None]),
        cell_index=None
        if first.cell_index is None
        else np.concatenate([mesh.cell_index for mesh in meshes if mesh.cell_index is not None]),
    )


def _is_placed(model: Model) -> bool:
    return isinstance(model, PlacedModel) and model.placements is not None


def _make(model: Model) -> Placed:
    assert isinstance(model, PlacedModel)
    return Placed(model)


register_operation("placements", _is_placed, _make)
