"""
What every mesh must satisfy before anything is computed from it, and what is mended on the way in.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import MeshError
from ..machine import memory
from ..model.asset import FEWER_INSTANCES, Asset, Material, Part
from ..model.topology import area_vectors
from .polygons import smooth_normals

#: Coordinates beyond this overflow when squared in float32.
MAX_COORDINATE = 1e15

#: Texture coordinates beyond this have lost their place on the texture in float32, and are as good as infinite.
MAX_UV = 1e6

#: Bytes that a placed triangle takes until the mesh is clean.
PER_TRIANGLE = 700


def check_indices(index: np.ndarray, n: int, model: str, part: str, what: str = "vertex", first: int = 0) -> None:
    """
    Raise unless every index lies in [0, n); ``first`` is what the file calls number 0.
    """
    if len(index) and (index.min() < 0 or index.max() >= n):
        bad = int(index.min() if index.min() < 0 else index.max()) + first
        raise MeshError(f"{model}: part '{part}' refers to {what} {bad}, but there are {n}; export the file again")


def used_vertices(faces: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Vertices that faces refer to, and the faces over these alone.
    """
    used = np.zeros(n, bool)
    used[faces] = True
    new_index = np.cumsum(used) - 1
    return np.flatnonzero(used), new_index[faces].reshape(-1, 3)


def check_asset(asset: Asset, model: str) -> Asset:
    """
    Refuse meshes that cannot be rendered; mend shading attributes and note it.

    Degenerate and duplicate faces stay: the clean-up before the first guess deals with them.

    Raises
    ------
    MeshError
        No faces, NaN or infinite positions, indices out of range, no area at all, a transform that is not finite.
    MemoryLimitError
        All instances together do not fit into memory.
    """
    for part in asset.parts:
        _check_part(part, model)
    if not asset.instances or not asset.n_triangles:
        raise MeshError(f"{model}: there are no faces in it; points and lines cannot be rendered")
    shown = f"{asset.n_triangles:,} triangles in {len(asset.instances):,} instances"
    memory.require(PER_TRIANGLE * asset.n_triangles, f"{model}: a model of {shown}", FEWER_INSTANCES)
    area = 0.0
    for instance in asset.instances:
        to_world = instance.to_world
        if not np.isfinite(to_world).all() or np.abs(to_world).max() > MAX_COORDINATE:
            raise MeshError(f"{model}: the transform of '{instance.name}' is not finite; reset it and export again")
        area += _area(asset.parts[instance.part], to_world)
    if not area > 0:
        names = ", ".join(f"'{p.name}'" for p in asset.parts[:3])
        raise MeshError(f"{model}: the faces of part {names} have no area; all their corners lie on a point or a line")
    notes = list(asset.notes)
    materials = {id(part.material): _mend_material(part.material, notes) for part in asset.parts}
    parts = tuple(replace(_mend_part(part, notes), material=materials[id(part.material)]) for part in asset.parts)
    return replace(asset, parts=parts, notes=tuple(notes))


def _check_part(part: Part, model: str) -> None:
    for what, values, width in (
        ("positions", part.vertices, 3), ("normals", part.normals, 3), ("texture coordinates", part.uvs, 2),
        ("colours", part.colors, 4), *(("texture coordinates", uvs, 2) for uvs in part.more_uvs),
    ):  # fmt: skip
        if values is not None and values.shape != (len(part.vertices), width):
            raise MeshError(f"{model}: the {what} of part '{part.name}' have the shape {values.shape}; export it again")
    check_indices(part.faces.reshape(-1), len(part.vertices), model, part.name)
    used = part.vertices[np.unique(part.faces)] if len(part.faces) else part.vertices[:0]
    bad = ~np.isfinite(used).all(axis=1)
    if bad.any():
        raise MeshError(
            f"{model}: {int(bad.sum())} of {len(used)} vertices of part '{part.name}' are NaN or infinite; "
            "repair the mesh and export again"
        )
    if len(used) and np.abs(used).max() > MAX_COORDINATE:
        largest = f"{np.abs(used).max():.0e}"
        raise MeshError(f"{model}: part '{part.name}' has coordinates up to {largest}; scale it down and export again")


def _area(part: Part, to_world: np.ndarray) -> float:
    p = (part.vertices @ to_world[:3, :3].T)[part.faces]
    return float(np.linalg.norm(area_vectors(p), axis=1).sum())


def _mend_material(material: Material, notes: list[str]) -> Material:
    found = {name: getattr(material, name) for name in ("base_color", "specular", "normal", "emission")}
    bad = {name: image for name, image in found.items() if image is not None and not np.isfinite(image).all()}
    if bad:
        notes.append(f"{', '.join(bad)} of material '{material.name}' that is NaN or infinite was set to 0")
    mended: dict[str, Any] = {name: np.where(np.isfinite(image), image, np.float32(0)) for name, image in bad.items()}
    return replace(material, **mended)


def _mend_part(part: Part, notes: list[str]) -> Part:
    normals, colors = part.normals, part.colors
    if normals is not None:
        normals = np.asarray(normals, np.float64)  # lengths that overflow in float32
        length = np.linalg.norm(normals, axis=1)
        bad = ~(np.isfinite(length) & (length > 1e-12))
        normals = normals / np.where(bad, 1.0, length)[:, None]
        if bad.any():
            normals[bad] = smooth_normals(part.vertices, part.faces)[bad]
            notes.append(f"{int(bad.sum())} of {len(bad)} normals of part '{part.name}' had no length; recomputed")
        normals = normals.astype(np.float32)
    uvs = None if part.uvs is None else _mend_uvs(part.uvs, part.name, notes)
    more = tuple(_mend_uvs(x, part.name, notes) for x in part.more_uvs)
    if colors is not None:
        colors = np.clip(np.nan_to_num(colors, nan=1.0), 0, 1).astype(np.float32)
    return replace(part, normals=normals, uvs=uvs, more_uvs=more, colors=colors)


def _mend_uvs(uvs: np.ndarray, name: str, notes: list[str]) -> np.ndarray:
    if not (fine := np.abs(uvs) < MAX_UV).all():
        notes.append(f"texture coordinates of part '{name}' that are NaN or infinite were set to 0")
        uvs = np.where(fine, uvs, 0.0)
    return uvs.astype(np.float32)
