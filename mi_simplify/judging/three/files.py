"""
What three.js is given of a model: its own GLB file, or parts of what was read, each as a file of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import AssetError
from ...formats.gltf.write import glb_bytes
from ...formats.mitsuba.read import SceneAsset
from ...model.asset import Asset, Part
from ...model.mesh import Mesh
from ...model.model import Model
from ...model.topology import weld
from ...scenes.shapes import part_normals


def own_file(asset: Asset) -> Path | None:
    """
    The glTF file of an asset that three.js can read itself; None where it is no such file, or moves.
    """
    path = Path(asset.source)
    is_gltf = bool(asset.source) and path.suffix.lower() in (".glb", ".gltf") and path.is_file()
    return path if is_gltf and asset.rig is None else None


def written(asset: Asset) -> list[bytes]:
    """
    An asset at rest, of whatever format, as GLB files: one a placed part, in world space.

    Raises
    ------
    AssetError
        It is a Mitsuba scene, or has what the files would not hold: colours of vertices, several sets of texture
        coordinates.
    """
    if isinstance(asset, SceneAsset):
        raise AssetError(f"{asset.name}: three.js shows model files, not Mitsuba scenes; leave --renderer three out")
    return [glb_bytes(_model(part)) for part in asset.placed()]


def _model(part: Part) -> Model:
    material = part.material
    if part.colors is not None or material.lookups:
        what = "colours of vertices" if part.colors is not None else "several sets of texture coordinates"
        raise AssetError(f"{part.name}: three.js is shown {what} of GLB files only; convert the model to GLB")
    if not len(part.faces):
        raise AssetError(f"{part.name} has no faces")
    n = len(part.vertices)
    positions, index = weld(part.vertices)
    uvs = np.zeros((n, 2), np.float32) if part.uvs is None else part.uvs
    normals = part_normals(part).astype(np.float64)
    mesh = Mesh(positions, index, uvs, part.faces, np.arange(n), normals)
    flat = np.array([[[0, 0, 1]]], np.float32)
    return Model(
        mesh, material.base_color, material.specular, flat if material.normal is None else material.normal,
        material.alpha_mode, material.alpha_cutoff, part.name, emission=material.emission,
    )  # fmt: skip
