"""
A model with nodes taken apart into their meshes, and put together again with all instances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..groups import Groups
from ..mesh import Mesh
from ..model import Model, Morphs

#: How far three axes may be from orthogonal and of one length before normals have to be told apart from the faces'.
_SIMILAR = 1e-6


def submodels(model: Model) -> list[Model | None]:
    """
    The mesh of each of a model's nodes where its first node stands, with the textures of the whole, without nodes and
    skin; None for one of which no face is left.
    """
    nodes = model.nodes
    assert nodes is not None
    of_face = nodes.of_position[model.mesh.position_faces[:, 0]]
    return [_part(model, of_face == m) if (of_face == m).any() else None for m in range(len(nodes.placed))]


def _part(model: Model, chosen: np.ndarray) -> Model:
    mesh = model.mesh
    used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
    place, position_index = np.unique(mesh.position_index[used], return_inverse=True)
    group, normal_index = np.unique(mesh.normal_groups[used], return_inverse=True)
    own = None if mesh.own_normals is None else mesh.own_normals[group]
    part = Mesh(mesh.positions[place], position_index, mesh.uvs[used], faces.reshape(-1, 3), normal_index, own)
    morphs, groups = model.morphs, model.groups
    if morphs is not None:
        morphs = replace(morphs, offsets=morphs.offsets[:, place])
        morphs = morphs if morphs.offsets.any() else None
    if groups is not None:
        groups = Groups(groups.kinds, groups.of_face[chosen])
    return replace(model, mesh=part, morphs=morphs, groups=groups, nodes=None, skin=None)


def moved(model: Model, matrix: np.ndarray) -> Model:
    """
    A model after an affine transform, shape (4, 4), with the normals of its surface; what mirrors turns its faces.
    """
    mesh, linear = model.mesh, matrix[:3, :3]
    if np.array_equal(matrix, np.eye(4)):
        return model
    faces = mesh.faces[:, ::-1] if np.linalg.det(linear) < 0 else mesh.faces
    out = replace(mesh, positions=mesh.positions @ linear.T + matrix[:3, 3], faces=faces)
    product = linear.T @ linear
    if mesh.own_normals is not None or np.ptp(product - np.eye(3) * product[0, 0]) > _SIMILAR * product[0, 0]:
        normals = mesh.normals() @ np.linalg.inv(linear)
        out = replace(out, own_normals=normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))
    morphs = model.morphs
    if morphs is not None:
        morphs = replace(morphs, offsets=morphs.offsets @ linear.T)
    return replace(model, mesh=out, morphs=morphs)


def expanded(model: Model) -> Model:
    """
    A model with nodes as one mesh that shows every instance, which is what formats without nodes hold.

    Its positions are those of the model where nothing is an instance of another. Joints carry whole parts.
    """
    nodes = model.nodes
    if nodes is None:
        return model
    if all(len(placed) == 1 for placed in nodes.placed):
        return replace(model, nodes=None)
    copies, joints = [], []
    for m, part in enumerate(submodels(model)):
        if part is None:
            continue
        back = np.linalg.inv(nodes.world(nodes.placed[m][0]))
        for k, node in enumerate(nodes.placed[m]):
            copies.append(moved(part, nodes.world(node) @ back) if k else part)
            joints.append(nodes.joints[m][k] if nodes.joints else -1)
    skin = model.skin
    if skin is not None:
        rows = np.repeat(joints, [len(copy.mesh.positions) for copy in copies])
        skin = replace(skin, weights=np.eye(skin.weights.shape[1], dtype=np.float32)[rows])
    groups = model.groups
    if groups is not None:
        groups = Groups(groups.kinds, np.concatenate([copy.face_groups.of_face for copy in copies]))
    return replace(
        model, mesh=_joined([copy.mesh for copy in copies]), groups=groups, morphs=_morphs(model, copies), skin=skin,
        nodes=None,
    )  # fmt: skip


def _joined(meshes: list[Mesh]) -> Mesh:
    """Meshes side by side."""

    def numbered(numbers: Callable[[Mesh], np.ndarray], size: Callable[[Mesh], int]) -> np.ndarray:
        start = np.cumsum([0, *(size(mesh) for mesh in meshes)])
        return np.concatenate([numbers(mesh) + n for mesh, n in zip(meshes, start, strict=False)])

    own = None
    if any(mesh.own_normals is not None for mesh in meshes):
        own = np.concatenate([mesh.normals() for mesh in meshes])
    return Mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        numbered(lambda mesh: mesh.position_index, lambda mesh: len(mesh.positions)),
        np.concatenate([mesh.uvs for mesh in meshes]),
        numbered(lambda mesh: mesh.faces, lambda mesh: len(mesh.uvs)),
        numbered(lambda mesh: mesh.normal_groups, lambda mesh: int(mesh.normal_groups.max()) + 1),
        own,
    )


def _morphs(model: Model, copies: list[Model]) -> Morphs | None:
    """The morph targets of all copies; those that have none stand still."""
    if model.morphs is None:
        return None
    shape = len(model.morphs.names)
    rows = [
        np.zeros((shape, len(copy.mesh.positions), 3)) if copy.morphs is None else copy.morphs.offsets
        for copy in copies
    ]
    return replace(model.morphs, offsets=np.concatenate(rows, axis=1))
