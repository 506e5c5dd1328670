"""
OFF and 3MF through trimesh, which reads them; their materials as far as it knows them.
"""

from __future__ import annotations

import logging
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AssetError
from ...model.asset import Asset, Instance, Material, Part
from ...model.color import srgb_to_linear
from ..images import to_float
from ..resources import printable

#: Elements of 3MF models that colour them.
_COLORED = re.compile(rb"<(\w+:)?(basematerials|colorgroup|texture2d)\b")


def read_by_trimesh(path: Path) -> Asset:
    """
    Read a model file by trimesh: its scene graph as instances, UVs, vertex and face colours, base colour textures.

    Raises
    ------
    AssetError
        It cannot be read, holds no triangles, or a package is missing that it needs.
    """
    import trimesh

    said = _Lines()
    logging.getLogger("trimesh").addHandler(said)
    try:
        scene: Any = trimesh.load(path, force="scene", process=False)
    except (ImportError, AttributeError) as error:
        raise AssetError(
            f"{path.name}: trimesh needs more packages for this format: pip install 'mi-simplify[formats]'"
        ) from error
    except Exception as error:  # whatever a reader of somebody else's stumbles over
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise AssetError(f"{path.name}: trimesh cannot read it ({line:.100}); export it as GLB") from error
    finally:
        logging.getLogger("trimesh").removeHandler(said)
    notes = [f"trimesh: {printable(line)}" for line in dict.fromkeys(said.lines)]
    if path.suffix.lower() == ".3mf" and _has_colors(path):
        notes.append("colours and textures of the 3MF file were left out; export it as GLB to keep them")
    parts: dict[str, int] = {}
    made: list[Part] = []
    for name, mesh in scene.geometry.items():
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            parts[name] = len(made)
            made.append(_part(name, mesh))
        else:
            notes.append(f"'{name}' is no triangle mesh and is left out")
    instances = []
    for node in scene.graph.nodes_geometry:
        to_world, name = scene.graph[node]
        if name in parts:
            instances.append(Instance(parts[name], np.asarray(to_world, np.float64), name=str(node), node=str(node)))
    if not instances:
        raise AssetError(f"{path.name}: trimesh finds no triangles in it; export a mesh, as GLB")
    return Asset(tuple(made), tuple(instances), notes=tuple(notes))


def _has_colors(path: Path) -> bool:
    """Whether a 3MF package names materials."""
    with zipfile.ZipFile(path) as package:
        models = [name for name in package.namelist() if name.endswith(".model")]
        return any(_COLORED.search(package.read(name)) for name in models)


class _Lines(logging.Handler):
    """What trimesh warns of while it reads a file: what it leaves out."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(" ".join(record.getMessage().split()))


def _part(name: str, mesh: Any) -> Part:
    """One mesh; colours of faces become those of vertices, which then are split."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    visual, uvs, colors, material = mesh.visual, None, None, Material(name)
    if visual.kind == "texture":
        if visual.uv is not None and len(visual.uv) == len(vertices):
            uvs = (np.asarray(visual.uv) * [1, -1] + [0, 1]).astype(np.float32)
        material = _material(name, visual.material, has_uvs=uvs is not None)
    elif visual.kind == "face":
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
        colors = _linear(np.repeat(visual.face_colors, 3, axis=0))
    elif visual.kind == "vertex":
        colors = _linear(visual.vertex_colors)
    if colors is not None:
        material = Material(name, np.ones((1, 1, 4), np.float32))
    return Part(vertices, faces, uvs=uvs, colors=colors, material=material, name=name)


def _material(name: str, material: Any, has_uvs: bool) -> Material:
    """Base colour of trimesh's material; the rest of ours has its defaults."""
    pbr = material.to_pbr() if hasattr(material, "to_pbr") else material
    image = pbr.baseColorTexture
    if image is not None and has_uvs:
        return Material(name, to_float(np.asarray(image.convert("RGBA")), srgb=True).astype(np.float32))
    factor = pbr.baseColorFactor
    return Material(name) if factor is None else Material(name, _linear(np.asarray(factor).reshape(1, -1))[None])


def _linear(colors: np.ndarray) -> np.ndarray:
    """RGBA of 8 bits or in [0, 1] as linear floats, shape (N, 4)."""
    colors = np.asarray(colors)
    colors = colors / 255.0 if colors.dtype.kind in "ui" else colors.astype(np.float64)
    alpha = colors[:, 3:] if colors.shape[1] > 3 else np.ones((len(colors), 1))
    return np.concatenate([srgb_to_linear(colors[:, :3]), alpha], axis=1).astype(np.float32)
