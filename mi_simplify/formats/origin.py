"""
Where a file has its origin: what stands far from it has too few digits in float32.
"""

from __future__ import annotations

import numpy as np

from ..model.model import Model

#: How many times its own size a model may stand away from the origin: 2^-24 of that is 1e-6 of its size.
_FAR = 16.0


def recentred(model: Model) -> tuple[Model, np.ndarray]:
    """
    A model as its file has it, and where the file's origin stands in its space, shape (3,), float64.

    The origin is 0 unless the model lies so far from it that float32 would show: survey coordinates, for instance.
    """
    positions = model.mesh.positions
    box = np.stack([positions.min(0), positions.max(0)]).astype(np.float64)
    center, size = box.mean(0), float(np.ptp(box, axis=0).max())
    if not np.abs(center).max() > _FAR * size:
        return model, np.zeros(3)
    # A round number to a tenth of its size, which people can read and float64 adds without loss.
    step = 10.0 ** np.floor(np.log10(max(size, 1e-30)) - 1)
    origin = np.round(center / step) * step
    return model.transformed(1.0, -origin), origin
