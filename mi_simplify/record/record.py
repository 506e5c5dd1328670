"""
What a fit leaves behind while it runs: its log, its checkpoints, and the model as far as it got.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..config import Config
from ..errors import OutputError
from ..export import export_model
from ..export.environment import ENVIRONMENT, write_environment
from ..fitting import FitResult, Run, fit
from ..fitting.loop import Measure
from ..model.frame import Frame
from ..model.light.environment_map import as_harmonics
from ..model.model import Model
from ..progress import Progress, ProgressCallback
from ..scenes.references.reference import Reference
from .checkpoint import Checkpoint
from .events import EVENTS, Events
from .interrupt import DeferredInterrupt
from .output import RunFolder
from .preview import PREVIEW, Preview


@dataclass(frozen=True)
class Record:
    """
    The fit of a job, put on record in its folder.

    Parameters
    ----------
    folder : RunFolder
        Opened.
    checkpoint : Checkpoint
        With the first guess.
    interrupt : DeferredInterrupt
    config : Config
    frame : Frame
        In which it is fitted.
    facts : dict
        What exported files say of themselves.
    """

    folder: RunFolder
    checkpoint: Checkpoint
    interrupt: DeferredInterrupt
    config: Config
    frame: Frame
    facts: dict[str, Any]

    def fit(
        self,
        guess: Model,
        reference: Reference,
        state: dict | None,
        progress: ProgressCallback,
        spent: float,
        measure: Measure | None = None,
    ) -> FitResult:
        """
        Fit, from a checkpoint's state where there is one, after ``spent`` seconds of the time that it may take; what
        ``measure`` says of the models on the way is in the log, too.

        Raises
        ------
        KeyboardInterrupt
            After the running step; state and best model are in the folder.
        """
        done, before = (0, 0.0) if state is None else (state["done"], state["seconds"])
        start = time.perf_counter() - before
        if self.folder.resume:
            self.folder.rewind_log(done)
            progress(Progress("fit", done, self.config.optimizer.steps, message="resumed"))

        preview = Preview(self.folder.path / PREVIEW)
        events = Events(self.folder.path / EVENTS, done) if self.config.export.tensorboard else None

        def logged(event: Progress) -> None:
            seconds = round(time.perf_counter() - start, 3)
            self.folder.log(
                stage=event.stage, step=event.step, loss=event.loss, psnr=event.psnr, seconds=seconds, **event.figures
            )
            if events is not None:
                events.figures(event.step, loss=event.loss, psnr=event.psnr)
            progress(event)

        def after_step(run: Run) -> None:
            picture = preview(run)
            if events is not None and picture is not None:
                events.picture(run.done, "reference and now", picture)
            self._keep(run)

        try:
            return fit(guess, reference, self.config, logged, after_step, state, spent, measure)
        finally:
            if events is not None:
                events.close()

    def _keep(self, run: Run) -> None:
        """After every step: a checkpoint where one is due, and the end where that is wanted."""
        if not (self.interrupt.pending or self.checkpoint.due() or run.is_done):
            return
        if run.is_done:
            run.fit.pool.clear()  # no step follows that would draw from it, and it is most of a checkpoint
        saved = self.checkpoint.save(run.state())
        if not self.interrupt.pending:
            return
        run.judge()
        self.export(self.frame.restored(run.result().model))
        done = f"{self.folder.path} holds the best model of {run.done} of {run.n_steps} steps"
        raise KeyboardInterrupt(f"{done}; the same command with --resume goes on" if saved else done)

    def export(self, model: Model) -> Path:
        """
        Write a model, in the units of the file, in all formats; returns the path of the first.

        Raises
        ------
        OutputError
            The folder has no room for it, or is gone for good; where it is instead.
        """
        formats, facts = self.config.export.formats, self.facts
        if not self.config.export.metadata:
            model = replace(model, metadata={})
        environment = None
        if model.ambient is not None:
            environment = model.ambient if len(model.ambient) > 1 else None
            facts = facts | {"ambient": " ".join(f"{x:.6g}" for x in as_harmonics(model.ambient).ravel())}
            if self.config.latent.ambient.export == "drop":
                model = replace(model, ambient=None)
        try:
            with self.folder.staged() as stage:
                if environment is not None:
                    write_environment(environment, stage / ENVIRONMENT)
                files = export_model(model, stage, formats=formats, extras=facts, glb=self.config.export.glb)
        except OutputError as error:
            spare = Path(tempfile.mkdtemp(prefix="mi-simplify-"))
            export_model(model, spare, formats=formats, extras=facts, glb=self.config.export.glb)
            raise OutputError(f"{error}; the model is in {spare} instead") from None
        return self.folder.path / next(iter(files.values())).name
