"""
Sequences from files: skinned models, and folders with one mesh a frame.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import AssetError, MeshError
from ...formats.load import load_asset
from ...model.asset import Asset, Part
from ...model.topology import weld
from .sequence import Sequence

#: Meshes of a folder's frames.
SUFFIXES = (".obj", ".ply")


def skinned(asset: Asset, n_frames: int, part: str | None = None) -> Sequence:
    """
    One part of an animated model over its clip, at evenly spaced times.

    Parameters
    ----------
    asset : Asset
        With a rig.
    n_frames : int
    part : str, optional
        Name of the part; needed where there are several.

    Raises
    ------
    AssetError
        Nothing in it moves, or no part has the name.
    """
    if asset.rig is None or asset.rig.n_frames < 2:
        raise AssetError(f"{asset.name}: an animated model expected, nothing in it moves; name one with a clip")
    names = [instance.name for instance in asset.instances]
    chosen = [k for k, name in enumerate(names) if part in (None, name)]
    if len(chosen) != 1:
        what = "several parts" if part is None else f"no single part '{part}'"
        listed = ", ".join(dict.fromkeys(names))
        raise AssetError(f"{asset.name}: one part expected, it has {what}; choose with 'part' one of {listed}")
    k = chosen[0]
    rest, index, faces = _welded(asset.placed()[k])
    first = np.unique(index, return_index=True)[1]
    times = np.linspace(0, asset.rig.n_frames - 1, n_frames)
    frames = np.stack([asset.posed(float(t)).placed()[k].vertices[first] for t in times]).astype(np.float32)
    return Sequence(asset.name, faces, frames, rest, notes=asset.notes)


def folder(path: str | Path) -> Sequence:
    """
    The OBJ or PLY files of a folder, sorted by name, as frames.

    Raises
    ------
    AssetError
        There are none, or fewer than two.
    MeshError
        A frame has another topology than the first.
    """
    path = Path(path)
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in SUFFIXES)
    if len(files) < 2:
        raise AssetError(f"{path}: at least two OBJ or PLY files expected, one a frame, got {len(files)}; add some")
    frames, first = [], None
    for file in files:
        part = _joined(load_asset(file, purpose="frame"))
        if first is None:
            rest, index, faces = _welded(part)
            first, kept = part, np.unique(index, return_index=True)[1]
        if part.faces.shape != first.faces.shape or not np.array_equal(part.faces, first.faces):
            raise MeshError(f"{file}: the faces of {files[0].name} expected, this frame has others; export them alike")
        frames.append(part.vertices[kept])
    return Sequence(path.name, faces, np.stack(frames).astype(np.float32), rest)


def _joined(asset: Asset) -> Part:
    parts = asset.placed()
    starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    faces = np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=False)])
    return replace(parts[0], vertices=np.concatenate([p.vertices for p in parts]), faces=faces)


def _welded(part: Part) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distinct positions, their number for each vertex, and the faces over them that have three corners left."""
    positions, index = weld(part.vertices)
    faces = index[part.faces]
    return positions, index, faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
