"""
The job of the command ``fit``: a glTF file fitted in place, with its log, checkpoints and figures in a folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..config import dump
from ..errors import ConfigError
from ..export.environment import ENVIRONMENT, write_environment
from ..fitting.fit import Fit
from ..fitting.samples import LOOK_SPP
from ..formats.load import load_asset
from ..judging.comparison import Comparison, save_comparison
from ..judging.evaluate import costs
from ..judging.metrics import compare
from ..judging.normal_maps import FIGURE
from ..machine.files import write_atomic
from ..model.asset import Asset
from ..model.model import Model
from ..progress import Progress, ProgressCallback, silent
from ..record.checkpoint import Checkpoint
from ..record.interrupt import DeferredInterrupt
from ..record.output import RunFolder
from ..record.record import Record
from ..report import report_folder
from .optimization import Optimization

#: The result of the job.
RESULT = "model.glb"


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
            f"{row['silhouette_error']:.4f}" + (f"  {FIGURE} {row[FIGURE]:.5f}" if FIGURE in row else "")
            for name, row in self.figures["candidates"].items()
        ]
        seconds = self.figures["run"]["seconds"]["fit"]
        return "\n".join([*rows, f"{self.folder / RESULT}: done in {seconds:.0f} s"])


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
    Fit to the last step, and write ``model.glb``, the figures and pictures of start and result, and their report.

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
        fitted = record.fit(model, optimization.target.reference, state, progress, 0.0, optimization.measure)
        progress(Progress("export"))
        written = load_asset(record.export(fitted.model))
        progress(Progress("evaluate"))
        models = {"start": (model, optimization.asset), "result": (fitted.model, written)}
        comparison = _judged(optimization, models)
        comparison.figures["run"] = {
            **facts, "seconds": {"fit": round(fitted.seconds, 1)}, "optimized": list(optimization.names),
            "notes": list(dict.fromkeys(optimization.notes)),
        }  # fmt: skip
        with folder.staged() as stage:
            save_comparison(comparison, stage)
        report_folder(folder.path, {name: asset for name, (_, asset) in models.items()})
        folder.finished()
    return FittedInPlace(folder.path, comparison.figures)


class _Same:
    """A frame in which nothing changes."""

    def restored(self, model: Model) -> Model:
        return model


def _judged(optimization: Optimization, models: Mapping[str, tuple[Model, Asset]]) -> Comparison:
    """Models, and the files that they are in, beside the target: what the fit itself compares them by."""
    settings, rows, images = optimization.prepare()[1], dict[str, dict](), dict[str, np.ndarray]()
    for name, (model, asset) in models.items():
        fit = Fit(model, optimization.target.reference, settings)
        target, images[name] = fit.held_out.images, fit.look()
        normals = {} if optimization.measure is None else optimization.measure(model)
        rows[name] = costs(asset) | {"loss": fit.judge()[0]} | compare(target, images[name]) | normals
    seen = {"n_views": len(target), "resolution": target.shape[2], "spp": LOOK_SPP, "seed": settings.seed}
    reference = {"name": optimization.asset.name, "triangles": optimization.asset.n_triangles}
    return Comparison(target, images, {"settings": seen, "reference": reference, "candidates": rows})


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
