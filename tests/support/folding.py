"""A sequence whose self-shadows are easy to see."""

import numpy as np

from mi_simplify.transfer.sequences.sequence import Sequence
from mi_simplify.transfer.surfaces.image import grid_faces


def folding(n_frames: int = 20) -> Sequence:
    """A square that folds along its middle."""
    x, z = np.meshgrid(np.linspace(-1, 1, 13), np.linspace(1, -1, 13))
    a = np.linspace(0.1, 1.2, n_frames)[:, None]
    x, z = x.ravel(), z.ravel()
    frames = np.stack([x * np.cos(a), np.abs(x) * np.sin(a), z + 0 * a], axis=2)
    return Sequence("folding", grid_faces(13), frames.astype(np.float32), frames[0])
