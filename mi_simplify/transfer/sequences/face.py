"""
A face of blend shapes that makes faces (ICT-FaceKit's npz file, see ``transfer_face.yaml``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import AssetError
from .sequence import Sequence, smooth_weights

#: Expressions that move eyes alone, which are not part of the face.
_EYES = ("PupilDilate", "eyeLook")


def face(path: str | Path, n_frames: int = 500, n_vertices: int | None = None, seed: int = 0) -> Sequence:
    """
    The neutral face with smoothly changing expressions, a few at a time.

    Parameters
    ----------
    path : str or Path
        An npz file with ``neutral`` (V, 3), ``quads`` (Q, 4), ``expression`` (E, V, 3) and ``expression_names``.
    n_frames : int
    n_vertices : int, optional
        Keep the first vertices alone; by default those that the file's ``n_face`` counts.
    seed : int
        Of the expressions.

    Raises
    ------
    AssetError
        The file is missing or has other contents.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as data:
            neutral, quads, shapes = (np.array(data[k]) for k in ("neutral", "quads", "expression"))
            names = [str(name) for name in data["expression_names"]]
            count = n_vertices or int(data["n_face"])
    except (OSError, KeyError, ValueError) as error:
        raise AssetError(f"{path}: blend shapes expected (npz with neutral, quads, expression): {error}") from None
    quads = quads[(quads < count).all(1)].astype(np.int64)
    used = [k for k, name in enumerate(names) if not name.startswith(_EYES)]
    rng = np.random.default_rng(seed)
    weights = smooth_weights(n_frames, len(used), rng, 60.0)
    weights = np.clip(2.2 * weights - 1.4, 0, 1)  # each at rest most of the time
    neutral = neutral[:count].astype(np.float64)
    offsets = shapes[used, :count].astype(np.float64).reshape(len(used), -1)
    frames = (neutral + (weights @ offsets).reshape(n_frames, count, 3)).astype(np.float32)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Sequence("face", faces, frames, neutral, weights.astype(np.float32))
