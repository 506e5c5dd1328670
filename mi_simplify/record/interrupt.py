"""
Ctrl-C, and the SIGTERM of batch systems, that wait for a good moment.
"""

from __future__ import annotations

import contextlib
import logging
import signal
import threading
from types import FrameType, TracebackType
from typing import Self

log = logging.getLogger("mi_simplify")


class DeferredInterrupt:
    """
    A context in which the first signal is only noted; the second one interrupts as usual.

    Dr.Jit turns an exception that Python raises inside one of its callbacks into another error, and
    an interrupted step leaves a model half updated: so whoever runs the steps calls :meth:`check`
    between them. Outside the main thread, which alone receives signals, nothing changes.
    """

    def __init__(self):
        self.pending = False
        self.left_behind = ""
        """What is there already and how to go on, for whoever interrupts."""

    def __enter__(self) -> Self:
        self._main = threading.current_thread() is threading.main_thread()
        if self._main:
            self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        if self._main:
            for number, before in self._before.items():
                signal.signal(number, before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.pending:
            raise KeyboardInterrupt(self.left_behind)
        self.pending = True
        with contextlib.suppress(RuntimeError):  # raised where it interrupts another line on its way
            log.warning("stopping after this step; once more stops at once")

    def check(self) -> None:
        """
        Raise :class:`KeyboardInterrupt` where one has been noted.
        """
        if self.pending:
            raise KeyboardInterrupt(self.left_behind)
