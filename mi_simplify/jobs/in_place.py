"""
The job of the command ``fit``: a glTF file fitted in place, with its log, checkpoints and figures in a folder.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..config import dump
from ..errors import ConfigError
from ..export.environment import ENVIRONMENT, write_environment
from ..fitting.fit import Fit
from ..formats.textures import png
from ..judging.metrics import psnr, silhouette_error
from ..judging.pictures import displayed
from ..machine.files import write_atomic
from ..model.model import Model
from ..progress import Progress, ProgressCallback, silent
from ..record.checkpoint import Checkpoint
from ..record.interrupt import DeferredInterrupt
from ..record.output import RunFolder
from ..record.record import Record
from .optimization import Optimization

#: The result of the job, and the picture of target, start and result in rows.
RESULT, PICTURE = "model.glb", "comparison.png"


@dataclass(frozen=True)
class FittedInPlace:
    """
    Parameters
    ----------
    folder : Path
    figures : dict
        What ``metrics.json`` holds.
    """

    folder: Path
    figures: dict[str, Any]

    def summary(self) -> str:
        """A few lines for a person."""
        rows = [
            f"{name:6}  loss {row['loss']:.5f}  PSNR {row['psnr']:5.2f} dB  silhouette error "
            f"{row['silhouette_error']:.4f}"
            for name, row in self.figures["models"].items()
        ]
        return "\n".join([*rows, f"{self.folder / RESULT}: done in {self.figures['seconds']:.0f} s"])


@dataclass(frozen=True)
class _Record(Record):
    """The record of a fit whose model goes back into its own file."""

    optimization: Optimization

    def export(self, model: Model) -> Path:
        """See :class:`..record.record.Record`."""
        with self.folder.staged() as stage:
            self.optimization.write(model, stage / RESULT)
            if model.ambient is not None and len(model.ambient) > 1:
                write_environment(model.ambient, stage / ENVIRONMENT)
        return self.folder.path / RESULT


def fit_job(
    optimization: Optimization,
    out: str | Path,
    progress: ProgressCallback = silent,
    *,
    overwrite: bool = False,
    resume: bool = False,
) -> FittedInPlace:
    """
    Fit to the last step, and write ``model.glb``, ``metrics.json`` and a picture of target, start and result.

    Parameters
    ----------
    optimization : Optimization
        What is optimised is named, no step is done.
    out : str or Path
    overwrite, resume : bool
        As of :func:`.job.run_job`.

    Raises
    ------
    UserError
        File, targets, names or folder cannot be used; nothing is left behind.
    KeyboardInterrupt
        After the running step; the model so far is in ``out``, to be resumed.
    """
    folder = RunFolder(out, overwrite=overwrite, resume=resume)
    model, config = optimization.prepare()
    checkpoint = Checkpoint(folder.checkpoint, config, optimization.asset)
    state = checkpoint.load()[2] if resume else None
    with DeferredInterrupt() as interrupt, folder.opened():
        if not resume:
            write_atomic(folder.path / "config.yaml", dump(config))
            # What the file itself has is read from it again.
            checkpoint.begin(Model(**{f.name: getattr(model, f.name) for f in fields(Model)}), [])
        if folder.checkpoint.is_dir():
            interrupt.left_behind = f"{folder.path} holds a checkpoint; the same command with --resume goes on"
        facts = {"generator": f"mi_simplify {__version__}"}
        # Models stay in the normalised frame: the file they go into has the way back.
        record = _Record(folder, checkpoint, interrupt, config, _Same(), facts, optimization)  # type: ignore[arg-type]
        fitted = record.fit(model, optimization.target.reference, state, progress, 0.0)
        progress(Progress("export"))
        record.export(fitted.model)
        progress(Progress("evaluate"))
        figures, picture = _judged(optimization, model, fitted.model)
        figures |= {"seconds": round(fitted.seconds, 1), "optimized": list(optimization.names), "log": fitted.log}
        with folder.staged() as stage:
            write_atomic(stage / "metrics.json", json.dumps(figures, indent=2) + "\n")
            write_atomic(stage / PICTURE, png(picture))
        folder.finished()
    return FittedInPlace(folder.path, figures)


class _Same:
    """A frame in which nothing changes."""

    def restored(self, model: Model) -> Model:
        return model


def _judged(optimization: Optimization, start: Model, result: Model) -> tuple[dict[str, Any], np.ndarray]:
    """Figures of start and result beside the target, and up to four views of all three, shape (3 H, 4 W, 3)."""
    settings, rows, shown = optimization.prepare()[1], dict[str, Any](), list[np.ndarray]()
    for name, model in (("start", start), ("result", result)):
        fit = Fit(model, optimization.target.reference, settings)
        held, images = fit.held_out, fit.look()
        shown = shown or [held.images]
        rows[name] = {
            "loss": fit.judge()[0],
            "psnr": round(float(psnr(held.images, images).mean()), 3),
            "silhouette_error": round(silhouette_error(held.images[..., 3], images[..., 3]), 5),
        }
        shown.append(images)
    picture = np.concatenate([np.concatenate([displayed(image) for image in x[:4]], axis=1) for x in shown])
    return {"models": rows, "views": len(held.views)}, picture


def named(options: Sequence[str]) -> dict[str, float | None]:
    """
    Parameters as the command line names them: ``positions,normal=0.02``.

    Raises
    ------
    ConfigError
        A rate is no number.
    """
    out: dict[str, float | None] = {}
    for text in (item.strip() for option in options for item in option.split(",")):
        name, equals, value = text.partition("=")
        try:
            out[name.strip()] = float(value) if equals else None
        except ValueError:
            raise ConfigError(f"'{text}': a rate is a number, as in normal=0.02") from None
    return out
