"""
The course of a fit for TensorBoard, where it is asked for.
"""

from __future__ import annotations

import importlib.util
import logging
import time
from pathlib import Path

import numpy as np

from ..errors import RuntimeUnavailable
from ..formats.textures import png

log = logging.getLogger("mi_simplify")

EVENTS = "tensorboard"
"""Folder of a run that `tensorboard --logdir` is given."""


def require_tensorboard() -> None:
    """
    Raise :class:`RuntimeUnavailable` where the package is missing.
    """
    if importlib.util.find_spec("tensorboard") is None:
        raise RuntimeUnavailable("--tensorboard needs the package tensorboard: pip install 'mi-simplify[tensorboard]'")


class Events:
    """
    Writes event files; where that fails, a warning says so once and the fit goes on.

    Parameters
    ----------
    folder : Path
        Made where it is missing.
    step : int
        A resumed fit goes on after this one; what the folder says of later steps no longer counts.
    """

    def __init__(self, folder: Path, step: int = 0):
        from tensorboard.compat.proto import event_pb2, summary_pb2
        from tensorboard.summary.writer.event_file_writer import EventFileWriter

        self._event, self._summary, self._failed = event_pb2.Event, summary_pb2.Summary, False
        try:
            self._writer = EventFileWriter(str(folder), flush_secs=5)
            start = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
            self._writer.add_event(self._event(wall_time=time.time(), step=step + 1, session_log=start))
        except OSError as error:
            self._fail(error)

    def figures(self, step: int, **values: float | None) -> None:
        """
        Add a point to the curve of each name; None is left out.
        """
        self._add(step, [self._summary.Value(tag=k, simple_value=v) for k, v in values.items() if v is not None])

    def picture(self, step: int, name: str, image: np.ndarray) -> None:
        """
        Add an image, shape (H, W, 3), uint8, sRGB.
        """
        height, width = image.shape[:2]
        content = self._summary.Image(height=height, width=width, colorspace=3, encoded_image_string=png(image))
        self._add(step, [self._summary.Value(tag=name, image=content)])

    def close(self) -> None:
        """
        Write what is still waiting.
        """
        if not self._failed:
            try:
                self._writer.close()
            except OSError as error:
                self._fail(error)

    def _add(self, step: int, values: list) -> None:
        if self._failed:
            return
        event = self._event(wall_time=time.time(), step=step, summary=self._summary(value=values))
        try:
            self._writer.add_event(event)
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        log.warning("no more events for TensorBoard: %s; the run goes on", error.strerror or error)
        self._failed = True
