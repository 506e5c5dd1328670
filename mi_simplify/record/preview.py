"""
The newest picture of a running fit on the disk, for whoever wants to watch.
"""

from __future__ import annotations

import logging
import time
from pathlib import Path

import numpy as np

from ..errors import OutputError
from ..fitting import Run
from ..formats.textures import png
from ..judging.pictures import displayed
from ..machine.files import write_atomic

log = logging.getLogger("mi_simplify")

PREVIEW = "preview.png"

SHARE = 0.01
"""Most of the time of a run that its previews may take."""


class Preview:
    """
    Writes one view that is never fitted, reference on the left and current state on the right, every few seconds.

    Parameters
    ----------
    path : Path
        A PNG file, replaced as a whole.
    interval : float
        Least time between two pictures [s]; it grows where a picture would take more than a hundredth of it.
    """

    def __init__(self, path: Path, interval: float = 3.0):
        self.path, self.interval = path, interval
        self._due, self._failed = time.monotonic() + interval, False

    def __call__(self, run: Run) -> np.ndarray | None:
        """
        After every step; returns the picture, shape (H, 2W, 3), uint8, where one was due.
        """
        start = time.monotonic()
        if start < self._due:
            return None
        picture = np.concatenate([displayed(image)[0] for image in run.fit.preview()], axis=1)
        try:
            write_atomic(self.path, png(picture))
            self._failed = False
        except OutputError as error:
            if not self._failed:
                log.warning("no preview: %s; the run goes on", str(error).split(";")[0])
            self._failed = True
        took = time.monotonic() - start
        self._due = start + max(self.interval, took / SHARE)
        return picture
