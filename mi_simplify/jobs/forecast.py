"""
What a run would do and what it would take: it is begun in earnest, the first steps are timed, and nothing is written.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import drjit as dr
import numpy as np

from ..config import Config
from ..errors import OutputError
from ..export import WRITERS, as_exported
from ..fitting import Run
from ..fitting.fit import REFRESH_EVERY
from ..fitting.schedules import resolution_at
from ..initial.unwrap.charting import charts
from ..judging.evaluate import Judging
from ..judging.pictures import contact_sheet
from ..machine import memory
from ..machine.runtime import ensure_variant
from ..model.asset import Asset
from ..model.mesh import Mesh
from ..model.model import Model
from ..progress import Progress, ProgressCallback, in_words, silent
from ..record.events import require_tensorboard
from ..record.output import RunFolder
from ..record.preview import SHARE
from ..record.stopwatch import Stopwatch
from ..report.html import report_page
from ..scenes.references.reference import Reference
from ..subjects import Subject, open_subject
from .budget_search import find_budget
from .footprint import check_footprint, footprint
from .names import require_names


@dataclass
class Forecast:
    """
    What is expected of a run.

    Parameters
    ----------
    plan : dict of str to str
        What would be done, by stage.
    seconds : dict of str to float
        Expected time of every stage.
    memory : int
        Expected peak of the process [bytes]: what :func:`.footprint.footprint` reckons, or the trial took, if more.
    steps : int
        How many steps of the fit were done to find out.
    """

    plan: dict[str, str]
    seconds: dict[str, float] = field(default_factory=dict)
    memory: int = 0
    steps: int = 0

    def summary(self) -> str:
        """
        For a person, one line a stage.
        """
        parts = ", ".join(f"{name} {in_words(seconds)}" for name, seconds in self.seconds.items())
        rows = dict(self.plan) | {"time": f"about {in_words(sum(self.seconds.values()))}: {parts}"}
        rows["memory"] = f"about {memory.shown_size(self.memory)} at most"
        rows["measured"] = (
            f"on this machine as busy as it is now: the first guess, {self.steps} steps of the fit and two views of "
            "the evaluation were done, the rest is reckoned from them, as if all steps were needed; nothing was written"
        )
        return "\n".join(f"{name:12} {text}" for name, text in rows.items())


def forecast(
    config: Config,
    out: str | Path,
    progress: ProgressCallback = silent,
    *,
    overwrite: bool = False,
    resume: bool = False,
) -> Forecast:
    """
    Begin a job without writing anything, and reckon from it what all of it takes.

    Parameters
    ----------
    config, out, progress, overwrite, resume
        As of :func:`.job.run_job`; what is wrong with them is found out here, too.

    Returns
    -------
    Forecast
    """
    if resume:
        raise OutputError("--dry-run says what a whole run takes; leave out --resume")
    folder = RunFolder(out, overwrite=overwrite)
    require_names(config)
    check_footprint(config)
    if config.export.tensorboard:
        require_tensorboard()
    config = config.model_copy(update={"variant": ensure_variant(config.variant)})
    clock = Stopwatch()
    found = find_budget(config, progress)
    config = config if found is None else found.config
    progress(Progress("load", message=config.asset))
    subject = open_subject(config)
    asset, config, frame = subject.geometry, subject.config, subject.frame
    check_footprint(config, asset)
    load = clock.lap()
    progress(Progress("first guess"))
    guess, notes = subject.guess()
    result = Forecast(_plan(config, asset, guess, notes, folder.path))
    reference = subject.reference()
    result.seconds |= {"load": load, "first guess": clock.lap()}
    if config.optimizer.steps:
        _try_fit(result, config, guess, reference, progress)
    _try_rest(result, config, subject, frame.restored(guess), progress)
    result.memory = max(sum(footprint(config, asset).values()), memory.peak() or 0)
    return result


def _plan(config: Config, asset: Asset, guess: Model, notes: list[str], out: Path) -> dict[str, str]:
    """What is known before any time is measured."""
    n_charts, used = _charts(guess.mesh)
    height, width = guess.base_color.shape[:2]
    fit, seen = config.optimizer, config.evaluation
    sizes = ", then ".join(f"{r}²" for r in fit.resolution)
    parts = {"displacement": guess.displacement, "vertex_sets": guess.vertex_sets, "skinning": guess.skin}
    fitted = [name for name in config.latent.optimize if parts.get(name, guess) is not None]
    return {
        "asset": f"{config.asset}: {asset.n_triangles:,} triangles in {len(asset.instances)} part(s)",
        "first guess": f"{guess.n_triangles:,} triangles" + "".join(f"; {note}" for note in notes),
        "atlas": f"{width} × {height} texels, {n_charts} charts on {100 * used:.0f} % of it",
        "fit": ("at most " if fit.tolerance or fit.time else "")
        + f"{fit.steps:,} steps of {fit.batch} views of {sizes} pixels with {fit.spp} samples, "
        f"{config.reference.transport} light; {', '.join(fitted)}",
        "evaluation": f"{seen.views} views of {seen.resolution}² pixels with {seen.spp} samples",
        "results": f"{out}: {', '.join(WRITERS[name].file for name in config.export.formats)}, report.html, …",
    }


def _charts(mesh: Mesh) -> tuple[int, float]:
    """Number of charts, and the share of the texture that they cover."""
    corners = mesh.faces
    a, b, c = np.moveaxis(mesh.uvs[corners].astype(np.float64), 1, 0)
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    return charts(mesh)[1], float(np.abs(ux * vy - uy * vx).sum() / 2)


def _try_fit(result: Forecast, config: Config, guess: Model, reference: Reference, progress: ProgressCallback) -> None:
    """
    Time the first steps at every resolution: a span of ``REFRESH_EVERY`` to warm up, in which kernels are compiled and
    the pool is begun, and another, in which the pool is refreshed once as in all that follow.
    """
    n_steps, clock = config.optimizer.steps, Stopwatch()
    counts = Counter(resolution_at(k / n_steps, config.optimizer.resolution) for k in range(n_steps))
    n_trial = sum(min(2 * REFRESH_EVERY, n) for n in counts.values())
    run = Run(guess, reference, config)
    seconds, first = clock.lap(), 0
    for n in counts.values():  # in the order of the run
        for span in (range(REFRESH_EVERY), range(REFRESH_EVERY, 2 * REFRESH_EVERY)):
            steps = [first + k for k in span if k < n]
            for k in steps:
                run.fit.step(k)
            dr.sync_thread()
            took = clock.lap()
            seconds += took
            result.steps += len(steps)
            progress(Progress("trial", result.steps, n_trial))
        seconds += took * max(0, n - 2 * REFRESH_EVERY) / REFRESH_EVERY
        first += n
    run.judge()
    seconds += clock.lap()  # which compiles
    run.judge()
    seconds += clock.lap() * (math.ceil(n_steps / config.evaluation.every) - 1)
    run.state()  # what a checkpoint takes, for the memory's sake
    limit = config.optimizer.time or math.inf
    result.seconds["fit"] = min(seconds * (1 + SHARE), max(0.0, limit - sum(result.seconds.values())))


def _try_rest(result: Forecast, config: Config, subject: Subject, guess: Model, progress: ProgressCallback) -> None:
    """Time an export, two views of the evaluation and their page: every later view costs as the second."""
    progress(Progress("trial", message="evaluation"))
    judged, clock = config.evaluation, Stopwatch()
    candidate = as_exported(guess)
    exported = clock.lap()
    result.seconds["export"] = exported * len(config.export.formats)
    images = Stopwatch()
    laps: list[float] = []
    two = replace(Judging.of(config), n_views=2)
    comparison = subject.judge({"result": candidate}, two, lambda _: laps.append(images.lap()))
    _, of_reference, _, of_candidate = laps  # the first of each compiles
    n_candidates = 2 + judged.baseline
    more = (judged.views - 2) * of_reference + (judged.views * n_candidates - 2) * of_candidate
    result.seconds["evaluate"] = clock.lap() + more + exported * (1 + judged.baseline)
    if judged.baseline:
        result.seconds["evaluate"] += result.seconds["first guess"]
    contact_sheet(comparison.reference, comparison.candidates, comparison.per_view)
    report_page(comparison, title=subject.geometry.name)
    per_view = clock.lap() / 2 * n_candidates
    models = {"result": candidate} if subject.display is None else {"reference": subject.display, "result": candidate}
    report_page(comparison, title=subject.geometry.name, models=models)
    result.seconds["report"] = clock.lap() + per_view * judged.views
