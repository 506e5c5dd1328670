"""
The primitives of a file that is written, one a group of faces, with the same vertices: attributes, morph targets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...config.schema import GlbSettings
from ...model.mesh import Mesh
from ...model.model import Model
from ...model.tangents import split_mirrored, vertex_tangents
from .container import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Container, some
from .order import ordered_groups
from .quantize import EXTENSION, Grid, directions, texture_coordinates


@dataclass(frozen=True)
class Primitives:
    """
    Parameters
    ----------
    mesh : Mesh
        As stored: no vertex with two signs of tangents, in the order of :func:`.order.ordered`.
    attributes : dict
        Of all primitives.
    entries : list of dict
        Of the JSON, one for each group that has faces; its number is that of its material.
    grid : Grid or None
        What positions are rounded to; None: they are exact.
    """

    mesh: Mesh
    attributes: dict
    entries: list[dict]
    grid: Grid | None


def write_primitives(container: Container, model: Model, settings: GlbSettings, *, tangents: bool) -> Primitives:
    """
    Append the mesh of a model, which has faces.
    """
    groups = model.face_groups
    mesh, of_face = ordered_groups(split_mirrored(model.mesh) if tangents else model.mesh, groups.of_face)
    grid = None
    if settings.compress != "none":
        grid = Grid.around(mesh.vertices)
        container.extensions.add(EXTENSION)
        container.required.add(EXTENSION)
    attributes = _attributes(container, mesh, grid, tangents)
    shared = {"attributes": attributes, **some("targets", _targets(container, model, mesh, grid))}
    used = np.unique(of_face)
    entries = [
        shared | {"indices": _indices(container, mesh.faces[of_face == k], len(mesh.uvs)), "material": int(k)}
        for k in used
    ]
    return Primitives(mesh, attributes, entries, grid)


def _attributes(container: Container, mesh: Mesh, grid: Grid | None, tangents: bool) -> dict[str, int]:
    normals = mesh.normals()
    exact = {"POSITION": mesh.vertices, "NORMAL": normals[mesh.normal_groups], "TEXCOORD_0": mesh.uvs}
    if tangents:
        direction, sign = vertex_tangents(mesh, normals)
        exact["TANGENT"] = np.concatenate([direction, sign[:, None]], axis=1)
    out = {}
    for name, array in exact.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{name} holds values that are not finite")
        small, packed = None, None
        if grid is not None:
            if name == "POSITION":
                small = grid.positions(array)
            elif name == "TEXCOORD_0":
                small = texture_coordinates(array)
            else:
                small, packed = directions(array)
        stored = np.asarray(array, "<f4") if small is None else small
        out[name] = container.accessor(
            stored, ARRAY_BUFFER, bounds=name == "POSITION", normalized=small is not None, packed=packed
        )
    return out


def _indices(container: Container, faces: np.ndarray, n_vertices: int) -> int:
    small = n_vertices <= 65535  # 65535 itself is reserved (primitive restart)
    return container.accessor(faces.ravel().astype("<u2" if small else "<u4"), ELEMENT_ARRAY_BUFFER)


def _targets(container: Container, model: Model, mesh: Mesh, grid: Grid | None) -> list[dict] | None:
    """
    A morph target for every further vertex set: the set itself at weight 1, blends of two between them; or for those of
    the asset.
    """
    moving = model.vertex_sets if model.morphs is None else model.morphs
    if moving is None:
        return None
    normals, targets = mesh.normals(), []
    for offset in moving.offsets:
        moved = replace(mesh, positions=mesh.positions + offset).normals()
        step, turn = offset[mesh.position_index], (moved - normals)[mesh.normal_groups]
        # A difference of normals may be longer than 1, which integers cannot hold.
        stored = np.asarray(step, "<f4") if grid is None else grid.offsets(step)
        targets.append(
            {
                "POSITION": container.accessor(stored, ARRAY_BUFFER, bounds=True, normalized=grid is not None),
                "NORMAL": container.accessor(np.asarray(turn, "<f4"), ARRAY_BUFFER),
            }
        )
    return targets
