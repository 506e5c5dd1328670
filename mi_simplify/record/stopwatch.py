"""
Seconds of the stages of a job.
"""

from __future__ import annotations

import time


class Stopwatch:
    """
    Seconds since it was looked at last; ``seconds`` holds those of the stages that were named, and ``total``.
    """

    def __init__(self):
        self.seconds: dict[str, float] = {"total": 0.0}
        self._total, self._last = 0.0, time.perf_counter()

    def lap(self, stage: str | None = None, before: float = 0.0) -> float:
        """
        Seconds since the last lap, and ``before`` that, which a process that was resumed took.
        """
        now = time.perf_counter()
        self._last, passed = now, now - self._last + before
        self._total += passed
        if stage is not None:
            self.seconds |= {stage: round(passed, 2), "total": round(self._total, 2)}
        return passed
