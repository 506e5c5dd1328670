"""
Fewer triangles for a welded mesh: quadric edge collapse in a frame of fixed size.
"""

from __future__ import annotations

import fast_simplification
import numpy as np

from ..errors import MeshError


def decimate(positions: np.ndarray, faces: np.ndarray, n_triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """
    At most ``n_triangles`` triangles that follow a surface.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
        Welded positions, any unit.
    faces : ndarray, shape (F, 3)
        Indices into ``positions``, wound alike.
    n_triangles : int
        Budget, at least 4.

    Returns
    -------
    positions : ndarray, shape (Q, 3), float64
    faces : ndarray, shape (G, 3), int64

    Raises
    ------
    MeshError
        The budget is below 4.
    """
    if n_triangles < 4:
        raise MeshError(f"a budget of {n_triangles} triangles is too small; ask for at least 4")
    positions, faces = np.asarray(positions, np.float64), np.asarray(faces, np.int64)
    if len(faces) <= n_triangles:
        return positions, faces
    centre = positions.mean(0)
    scale = 100 / np.ptp(positions, axis=0).max()  # fast-simplification compares errors with absolute thresholds
    p, f = fast_simplification.simplify(
        ((positions - centre) * scale).astype(np.float32), faces.astype(np.int32), target_count=n_triangles
    )
    return p.astype(np.float64) / scale + centre, f.astype(np.int64)
