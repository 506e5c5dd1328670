"""
What ``report/web/transfer.js`` plays: surfaces that move, each seen with one or several sets of coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..report.embed import packed_array
from .light import SKIES, sky, turning_series

#: From where it is looked at first, and where pictures are taken [degrees around +Y from +Z, degrees up].
VIEW = (40.0, 25.0)


@dataclass(frozen=True)
class Surface:
    """
    A surface in several frames.

    Parameters
    ----------
    positions : ndarray, shape (T, V, 3)
        In a frame in which its middle is at 0 and its diagonal about 2.
    faces : ndarray, shape (F, 3)
    transfers : mapping of str to ndarray, shape (T, V, K) or (T, n, n, K)
        What is shown side by side, by name: of its vertices, or textures.
    uvs : ndarray, shape (V, 2), optional
        Where the textures are looked up, origin top left.
    """

    positions: np.ndarray
    faces: np.ndarray
    transfers: Mapping[str, np.ndarray]
    uvs: np.ndarray | None = None


def player_data(surfaces: Sequence[Surface]) -> dict[str, Any]:
    """
    What the player draws, as JSON values: geometry and transfer of the frames as 16-bit fractions, and each sky as a
    Fourier series of its angle.
    """
    transfers = [t for surface in surfaces for t in surface.transfers.values()]
    scale = max(float(np.abs(t).max()) for t in transfers)
    order = round(transfers[0].shape[-1] ** 0.5) - 1
    out = []
    for surface in surfaces:
        size = float(np.abs(surface.positions).max())
        views = {name: packed_array(_fractions(t / scale)) for name, t in surface.transfers.items()}
        uvs = np.zeros((0, 2)) if surface.uvs is None else surface.uvs
        side = 0 if surface.uvs is None else next(iter(surface.transfers.values())).shape[1]
        out.append({
            "vertices": surface.positions.shape[1], "faces": packed_array(surface.faces.astype(np.uint32)),
            "size": size, "positions": packed_array(_fractions(surface.positions / size)), "views": views,
            "uvs": packed_array(uvs.astype(np.float32)), "side": side,
        })  # fmt: skip
    return {
        "surfaces": out, "names": [name for surface in surfaces for name in surface.transfers],
        "frames": len(surfaces[0].positions), "coefficients": (order + 1) ** 2, "view": VIEW, "scale": scale,
        "skies": {name: turning_series(sky(name, order)).round(6).tolist() for name in SKIES},
    }  # fmt: skip


def _fractions(x: np.ndarray) -> np.ndarray:
    """Values in [-1, 1] as signed 16-bit fractions."""
    return np.rint(np.clip(x, -1, 1) * 32767).astype(np.int16)
