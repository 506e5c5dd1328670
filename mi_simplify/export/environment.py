"""
The light that a model was fitted under, as an image of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import ConfigError
from ..machine.files import write_atomic
from ..model.light.environment_map import environment_map

ENVIRONMENT = "environment.exr"


def write_environment(ambient: np.ndarray, path: str | Path) -> Path:
    """
    Write an environment, harmonics or a map of shape (K, 3), as a linear latitude-longitude image.

    Parameters
    ----------
    ambient : ndarray, shape (K, 3)
    path : str or Path
        An ``.exr`` or ``.hdr`` file.

    Raises
    ------
    ConfigError
        Its name ends otherwise.
    """
    import mitsuba as mi  # which needs its variant by now, not on import

    path = Path(path)
    if path.suffix.lower() not in (".exr", ".hdr"):
        raise ConfigError(f"an environment is an EXR or HDR image; call it something.exr, got '{path.name}'")
    bitmap = mi.Bitmap(environment_map(ambient))
    return write_atomic(path, lambda temporary: bitmap.write(str(temporary)))
