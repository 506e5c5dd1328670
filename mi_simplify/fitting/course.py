"""
How far a run is, and when it is over: its steps are done, its time is up, or the held-out loss no longer falls.
"""

from __future__ import annotations

import math
from typing import Any

from ..config.optimizer import OptimizerSettings


class Course:
    """
    The way from the first step to the last, along which rates, weights and resolution change.

    Parameters
    ----------
    settings : OptimizerSettings
        ``steps``, ``time``, ``tolerance``, and whether ``resolution`` goes from coarse to fine.
    interval : int
        Steps between two measurements of the held-out loss.
    spent : float
        How much of the time has passed before.
    """

    def __init__(self, settings: OptimizerSettings, interval: int, spent: float = 0.0):
        self.time = math.inf if settings.time is None else max(settings.time - spent, 1e-3)
        self.tolerance, self.interval = settings.tolerance, interval
        self._fine_from = 0.5 if len(settings.resolution) > 1 else 0.0  # see schedules.resolution_at
        self.end = settings.steps
        self._turn, self._before = 0, 0.0
        """Step since which progress is even up to ``end``, and the progress there."""
        self._ending, self._rises = False, 0

    def progress(self, done: int, seconds: float = 0.0) -> float:
        """
        How much of the run has passed, in [0, 1]: its share of the steps, or of the time, whichever is more.
        """
        share = (done - self._turn) / max(1, self.end - self._turn)
        return min(1.0, max(self._before + (1 - self._before) * share, seconds / self.time))

    def is_over(self, done: int, seconds: float, needed: float = 0.0) -> bool:
        """
        Whether ``done`` steps are all, after ``seconds``, where ``needed`` more are to be kept free at the end.
        """
        return done >= self.end or seconds + needed >= self.time

    def measured(self, done: int, before: float, now: float) -> None:
        """
        Take note of a measurement: the least loss before it, and that of now.

        Where it fell by less than the tolerance, or rose twice in a row, what is left to gain is what the noise of the
        steps takes away: the rates fall to their last value within as many steps as lie between two measurements, and
        that is the end. One rise alone says that the rates are too high for a good start, which
        :meth:`.fit.Fit.retreat` mends. Coarse images are passed over as long as there are finer ones to come.
        """
        self._rises = self._rises + 1 if now >= before else 0
        still_falls = now < before * (1 - self.tolerance) or self._rises == 1
        if self._ending or still_falls or self.progress(done) < self._fine_from:
            return
        if self.tolerance > 0 and math.isfinite(before):
            self._before, self._turn, self._ending = self.progress(done), done, True
            self.end = min(self.end, done + self.interval)

    def stop(self, done: int) -> None:
        """
        No step follows.
        """
        self.end = done

    def state(self) -> dict[str, Any]:
        """
        What later steps depend on.
        """
        return {
            "end": self.end, "turn": self._turn, "before": self._before, "ending": self._ending, "rises": self._rises,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """
        Inverse of :meth:`state`.
        """
        self.end, self._turn, self._before = state["end"], state["turn"], state["before"]
        self._ending, self._rises = state["ending"], state["rises"]
