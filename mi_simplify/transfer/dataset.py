"""
A deforming object as images: positions, normals and transfer of every frame, held as one file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..machine.files import write_atomic
from ..progress import Progress, ProgressCallback, silent
from .archive import opened
from .cast import Caster
from .sequences.sequence import Sequence
from .surfaces.image import geometry_image, grid_faces

#: Of every hundred frames the last ten are held out: neighbours in time of training frames are no test.
PERIOD, HELD_OUT = 100, 10


@dataclass(frozen=True)
class Dataset:
    """
    Geometry images of a sequence with the transfer cast on them.

    Parameters
    ----------
    n : int
        Pixels a side.
    positions : ndarray, shape (T, n², 3), float32
        In the frame in which the first pose has its middle at 0 and a diagonal of 2.
    normals : ndarray, shape (T, n², 3), float32
    transfer : ndarray, shape (T, n², K), float32
        Stored in half precision.
    albedo : float
    figures : dict
        Of the geometry image.
    """

    n: int
    positions: np.ndarray
    normals: np.ndarray
    transfer: np.ndarray
    albedo: float
    figures: dict[str, float]

    @property
    def faces(self) -> np.ndarray:
        """Over the pixels, shape (F, 3)."""
        return grid_faces(self.n)

    @property
    def held_out(self) -> np.ndarray:
        """Frames for tests: the last tenth of each hundred, or of all where they are fewer."""
        n_frames = len(self.positions)
        period = min(PERIOD, n_frames)
        return np.flatnonzero(np.arange(n_frames) % period >= period - max(1, period * HELD_OUT // PERIOD))

    @property
    def training(self) -> np.ndarray:
        """The other frames."""
        return np.setdiff1d(np.arange(len(self.positions)), self.held_out)

    def save(self, path: str | Path) -> Path:
        """
        Write everything into one npz file.
        """
        arrays: dict[str, Any] = {
            "n": self.n, "positions": self.positions, "normals": self.normals.astype(np.float16),
            "transfer": self.transfer.astype(np.float16), "albedo": self.albedo,
            "figure_names": list(self.figures), "figures": list(self.figures.values()),
        }  # fmt: skip
        return write_atomic(path, lambda p: np.savez(p, **arrays))


def load_dataset(path: str | Path) -> Dataset:
    """
    Read what :meth:`Dataset.save` wrote.

    Raises
    ------
    AssetError
        The file is missing or holds something else.
    """
    with opened(path, "a file of 'transfer bake'", "bake it") as data:
        figures = dict(zip(data["figure_names"].tolist(), data["figures"].tolist(), strict=True))
        positions, normals, transfer = (np.asarray(data[k], np.float32) for k in ("positions", "normals", "transfer"))
        return Dataset(int(data["n"]), positions, normals, transfer, float(data["albedo"]), figures)


def bake(
    sequence: Sequence,
    n: int = 64,
    progress: ProgressCallback = silent,
    *,
    close_holes: bool = False,
    **casting: Any,
) -> Dataset:
    """
    Resample a sequence to images and cast the transfer of every frame.

    Parameters
    ----------
    sequence : Sequence
    n : int
        Pixels a side.
    close_holes : bool
        Close further borders of the surface.
    **casting
        Of :class:`.cast.Caster`.

    Raises
    ------
    MeshError
        The surface has no geometry image.
    """
    image = geometry_image(sequence.rest, sequence.faces, n, close_holes=close_holes, what=sequence.name)
    first = image.positions(sequence.frames[0])
    low, high = first.min(0), first.max(0)
    scale = 2 / float(np.linalg.norm(high - low))
    positions = np.stack([(image.positions(f) - (low + high) / 2) * scale for f in sequence.frames])
    caster = Caster(positions[0], image.faces, **casting)
    normals, transfer = np.empty_like(positions), []
    for k, p in enumerate(positions):
        normals[k] = image.normals(p)
        transfer.append(caster(p, normals[k]))
        progress(Progress("cast", k + 1, len(positions)))
    return Dataset(n, positions, normals, np.stack(transfer), caster.albedo, image.figures)
