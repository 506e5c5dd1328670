"""
The light that a model was fitted under, as an image of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..machine.files import write_atomic
from ..model.light.harmonics import environment_image

ENVIRONMENT = "environment.exr"


def write_environment(coefficients: np.ndarray, folder: str | Path) -> Path:
    """
    Write an environment, coefficients of shape (K, 3), as a linear latitude-longitude EXR into an existing folder.
    """
    import mitsuba as mi  # which needs its variant by now, not on import

    bitmap = mi.Bitmap(environment_image(coefficients))
    return write_atomic(Path(folder) / ENVIRONMENT, lambda temporary: bitmap.write(str(temporary)))
