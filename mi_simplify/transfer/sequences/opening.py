"""
A sequence by its name.
"""

from __future__ import annotations

from pathlib import Path

from ...formats.load import load_asset
from ...scenes.samples.catalogue import sample_asset
from .cloth import cloth
from .face import face
from .files import folder, skinned
from .sequence import Sequence


def open_sequence(
    source: str, n_frames: int, *, part: str | None = None, n_vertices: int | None = None, seed: int = 0
) -> Sequence:
    """
    Make or read a sequence.

    Parameters
    ----------
    source : str
        ``cloth``, ``sample:fish``, an animated model file, a folder of OBJ or PLY frames, or an npz of blend shapes.
    n_frames : int
        Of what is made; a folder has its own.
    part, n_vertices, seed
        See :func:`.files.skinned`, :func:`.face.face`, :func:`.cloth.cloth`.

    Raises
    ------
    UserError
        It cannot be read or does not move.
    """
    if source == "cloth":
        return cloth(n_frames, seed=seed)
    if source.startswith("sample:"):
        return skinned(sample_asset(source.removeprefix("sample:")), n_frames, part)
    if Path(source).is_dir():
        return folder(source)
    if source.endswith(".npz"):
        return face(source, n_frames, n_vertices, seed)
    return skinned(load_asset(source), n_frames, part)
