"""
The optimisation loop: step, look at held-out views now and then, keep the best, come back from what went astray.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ..config import FitSettings
from ..model.model import Model
from ..progress import Progress, ProgressCallback, silent
from ..scenes.references.reference import Reference
from .course import Course
from .fit import Fit

log = logging.getLogger("mi_simplify")

#: Figures of a model so far.
Measure = Callable[[Model], dict[str, float]]


@dataclass
class FitResult:
    """
    The fitted model, in the frame of the first guess, one record per logged step, and the seconds that it took.
    """

    model: Model
    log: list[dict] = field(default_factory=list)
    seconds: float = 0.0


class Run:
    """
    A fit under way: how many steps are done, the best state so far, what was logged.

    Parameters
    ----------
    model : Model
        First guess in the normalised frame.
    reference : Reference
    settings : FitSettings
    state : dict, optional
        Of the run to go on with, from :meth:`state`; model, reference and configuration are the same as there.
    spent : float
        Seconds of ``optimizer.time`` that passed before.
    measure : callable, optional
        ``measure(model) -> figures`` of the model so far, whenever it is judged.
    """

    def __init__(
        self,
        model: Model,
        reference: Reference,
        settings: FitSettings,
        state: dict | None = None,
        spent: float = 0.0,
        measure: Measure | None = None,
    ):
        self.measure = measure
        self.done, self._earlier, self._start = 0, 0.0, time.perf_counter()
        self.fit, self.first_guess = Fit(model, reference, settings), model
        self.every = settings.evaluation.every
        self.course = Course(settings.optimizer, self.every, spent)
        self._judging = 0.0
        self.records: list[dict] = []
        self.best, self.best_step, self.least, self.setbacks = self.fit.parameters(), 0, math.inf, 0
        self.retreated = -1
        """Step of the last return to the best state for the loss's sake, -1 for none."""
        if state is None:
            self.judge()
        else:
            self.fit.restore(state["fit"])
            self.course.restore(state["course"])
            self._earlier = state["seconds"]
            for name in _KEPT:
                setattr(self, name, state[name])

    @property
    def seconds(self) -> float:
        """Since it was set up, without the time between two processes."""
        return self._earlier + time.perf_counter() - self._start

    @property
    def is_done(self) -> bool:
        """Whether no step follows."""
        return self.course.is_over(self.done, self.seconds, self._judging)

    @property
    def n_steps(self) -> int:
        """How many steps it takes, as far as is known by now."""
        return self.done if self.is_done else self.course.end

    def state(self) -> dict:
        """
        All that is needed to go on: nested dicts of arrays, which are copies, and plain values.
        """
        own = {name: getattr(self, name) for name in _KEPT}
        return {"fit": self.fit.state(), "course": self.course.state(), "seconds": self.seconds, **own}

    def judge(self) -> dict:
        """
        Measure the current state on held-out views and remember it where it is the best.

        Returns
        -------
        dict
            ``held_out_loss`` and ``psnr`` [dB]; ``unpeeled`` where something lies behind all layers, see
            ``Fit.unpeeled``.
        """
        start = self.seconds
        loss, psnr = self.fit.judge()
        self._judging = self.seconds - start
        if loss < self.least:
            self.least, self.best, self.best_step = loss, self.fit.parameters(), self.done
        record = {"held_out_loss": loss, "psnr": psnr}
        if self.fit.unpeeled:
            record["unpeeled"] = self.fit.unpeeled
        return record | (self.measure(self.fit.model()) if self.measure is not None else {})

    def step(self) -> dict | None:
        """
        One step.

        Returns
        -------
        dict or None
            The record of a step at which something was measured: ``step``, ``loss``, ``seconds`` and what
            :meth:`judge` returns.
        """
        loss = self.fit.step(self.done, self.course.progress(self.done, self.seconds))
        self.done += 1
        judged = self.done % self.every == 0 or self.is_done
        if not judged and (self.done - 1) % _LOG_EVERY:
            return None
        value = float(loss[0])
        not_finite = self.fit.not_finite() if math.isfinite(value) else "loss"
        if not_finite is not None:
            self._set_back(not_finite)
            return None
        record = {"step": self.done, "loss": value, "seconds": round(self.seconds, 3)}
        self.records.append(record)
        if judged:
            before = self.least
            record.update(self.judge())
            self.course.measured(self.done, before, record["held_out_loss"])
            if self.best_step != self.done and not self.is_done:
                self.fit.retreat(self.best, again=self.best_step <= self.retreated)
                self.retreated = self.done
        return record

    def _set_back(self, what: str) -> None:
        """Back to the best state, more carefully; after too many times that is where it ends."""
        self.setbacks += 1
        self.fit.retreat(self.best)
        self.fit.pool.clear()
        back = f"step {self.done}: NaN or infinity in the {what}; back to the state of step {self.best_step}"
        if self.setbacks < _MAX_SETBACKS:
            log.warning("%s, at half the rates", back)
        else:
            log.warning("%s, which is kept: %d times is enough", back, self.setbacks)
            self.course.stop(self.done)

    def result(self) -> FitResult:
        """
        The best model so far, which may be the first guess itself.
        """
        if self.best_step == 0:
            return FitResult(self.first_guess, self.records, self.seconds)
        self.fit.take(self.best)
        return FitResult(self.fit.model(), self.records, self.seconds)


def fit(
    model: Model,
    reference: Reference,
    settings: FitSettings = FitSettings(),
    progress: ProgressCallback = silent,
    on_step: Callable[[Run], None] | None = None,
    state: dict | None = None,
    spent: float = 0.0,
    measure: Measure | None = None,
) -> FitResult:
    """
    Optimise a first guess until it looks like the reference.

    Minimises the expected image loss over random views (Hasselgren et al. 2021, Eq. 1 and 6), and returns the state
    with the least loss on held-out views, which may be the first guess itself: a warning says so. Where that loss has
    not fallen, or a loss or a gradient is not finite, it goes back to the best state, and on with half the rates, and,
    where that has brought nothing, twice the samples: a start that is nearly right wants smaller steps than the noise
    of the images makes. It ends where :class:`.course.Course` says so.

    Parameters
    ----------
    model : Model
        First guess in the normalised frame.
    reference : Reference
    settings : FitSettings
        A whole job (:class:`..config.Config`) is one, too.
    progress : callable
    on_step : callable, optional
        ``on_step(run)`` after every step: checkpoints, pictures.
    state : dict, optional
        ``run.state()`` of an earlier call with the same model, reference and configuration, to go on with.
    spent : float
        Seconds of ``optimizer.time`` that passed before this call.
    measure : callable, optional
        ``measure(model) -> figures``, told to ``progress`` and kept in the log whenever the model is judged.

    Returns
    -------
    FitResult
    """
    if settings.optimizer.steps == 0:
        return FitResult(model)
    run = Run(model, reference, settings, state, spent, measure)
    while not run.is_done:
        record = run.step()
        if record is not None:
            figures = {key: value for key, value in record.items() if key not in _TOLD}
            progress(Progress("fit", run.done, run.n_steps, record["loss"], record.get("psnr"), figures=figures))
        if on_step is not None:
            on_step(run)
    if run.done == 0:
        log.warning(
            "no time was left for a step of the fit: the first guess is the result; optimizer.time is %g s",
            settings.optimizer.time,
        )
    elif run.best_step == 0:
        log.warning("no step of the fit was better on held-out views than the first guess, which is kept as it was")
    elif run.best_step < run.done:
        log.info("the model of step %d of %d is kept: it was the best on held-out views", run.best_step, run.done)
    if run.fit.unpeeled > _MUCH_UNPEELED:
        log.warning(
            "%.1f %% of what is seen lies behind more than %d transparent surfaces, which is as far as the fit looks; "
            "raise opacity.layers", 100 * run.fit.unpeeled, run.fit.renderer.layers,
        )  # fmt: skip
    return run.result()


#: Share of what lies beyond the last layer from which it is worth a warning.
_MUCH_UNPEELED = 0.01

#: Parts of a record that are no figures of their own, or told as such.
_TOLD = ("step", "loss", "seconds", "held_out_loss", "psnr", "unpeeled")

#: What a state holds beside the fit's own.
_KEPT = ("done", "records", "best", "best_step", "least", "setbacks", "retreated")

#: Steps between two readings of the loss; each waits for the device.
_LOG_EVERY = 10

#: So often a fit that is not finite goes back; then its cause will not go away.
_MAX_SETBACKS = 5
