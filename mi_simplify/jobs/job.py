"""
The main job: from an asset to a small textured model in files, with the figures that judge it.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .. import __version__
from ..config import Config, dump, load_config
from ..config.schema import GlbSettings
from ..errors import Defect
from ..export import as_exported, export_model
from ..export.own_normals import with_own_normals
from ..formats.load import load_asset
from ..initial.guess import first_guess
from ..judging.comparison import save_comparison
from ..judging.evaluate import Judging
from ..judging.self_check import LEAST_LOSSY_PSNR, LEAST_PSNR, self_check
from ..judging.verdict import larger, unlike
from ..machine import memory
from ..machine.files import write_atomic
from ..machine.runtime import ensure_variant
from ..model.asset import Asset
from ..model.model import Model, tessellated
from ..progress import Progress, ProgressCallback, silent
from ..record.checkpoint import Checkpoint
from ..record.events import require_tensorboard
from ..record.interrupt import DeferredInterrupt
from ..record.output import RunFolder
from ..record.record import Record
from ..record.stopwatch import Stopwatch
from ..report.folder import report_folder
from ..subjects import Subject, open_asset, open_subject
from ..transfer.carrier import Carrier
from .budget_search import Found, find_budget, with_stored_budget
from .byte_budget import require_room, with_packing, within_bytes
from .footprint import check_footprint
from .goals import goal_of
from .names import require_names

log = logging.getLogger("mi_simplify")


@dataclass(frozen=True)
class Result:
    """
    What a job made.

    Parameters
    ----------
    folder : Path
    guess, model : Model
        First guess and result, in the units of the file.
    figures : dict
        What ``metrics.json`` holds.
    """

    folder: Path
    guess: Model
    model: Model
    figures: dict

    def summary(self) -> str:
        """
        A few lines for a person: where it is, how large, how much better than the first guess.
        """
        run = self.figures["run"]
        seconds = run["seconds"]["total"]
        told = [run[key] for key in ("goal", "packing") if key in run]
        return "\n".join([*figure_rows(self.figures), *told, f"{self.folder}: done in {seconds:.0f} s"])

    @property
    def alarm(self) -> str | None:
        """
        One line where the result is plainly unlike the asset: see :func:`mi_simplify.judging.verdict.unlike`.
        """
        return unlike(self.figures)

    @property
    def growth(self) -> list[str]:
        """
        Lines where the result is larger than the asset: see :func:`mi_simplify.judging.verdict.larger`.
        """
        return larger(self.figures)


def run_job(
    config: Config,
    out: str | Path,
    progress: ProgressCallback = silent,
    *,
    overwrite: bool = False,
    resume: bool = False,
) -> Result:
    """
    Load, guess, fit, export, evaluate, report: everything that the command line does.

    Parameters
    ----------
    config : Config
    out : str or Path
        Folder of the results; made once asset and first guess are known to be good.
    progress : callable
    overwrite : bool
        Replace a run that ``out`` holds.
    resume : bool
        Go on with the unfinished run that ``out`` holds, of the same asset and configuration, from its last
        checkpoint: the same steps with the same random numbers follow.

    Raises
    ------
    UserError
        The asset, the configuration, the output folder or this machine cannot be used; nothing is
        left behind in ``out``, but what can be resumed.
    Defect
        The exported file does not show what was fitted; everything is written all the same.
    KeyboardInterrupt
        Ctrl-C, after the running step; the model as far as it was fitted is in ``out``, to be resumed. A second Ctrl-C
        does not wait.
    """
    folder = RunFolder(out, overwrite=overwrite, resume=resume)
    if config.export.tensorboard:
        require_tensorboard()
    require_names(config)
    check_footprint(config)
    config = config.model_copy(update={"variant": ensure_variant(config.variant)})
    with DeferredInterrupt() as interrupt:

        def checked(event: Progress) -> None:
            progress(event)
            if event.stage != "fit":  # which looks at the end of each step
                interrupt.check()

        return _run_job(config, folder, checked, interrupt)


def _run_job(config: Config, folder: RunFolder, progress: ProgressCallback, interrupt: DeferredInterrupt) -> Result:
    """The stages in their order, with the variant set and the folder free."""
    clock = Stopwatch()
    progress(Progress("load", message=config.asset))
    found = None
    if folder.resume and goal_of(config.goal) is not None:
        config = with_stored_budget(config, folder.path / "config.yaml")
    else:
        found = find_budget(config, progress)
    if found is not None:
        config = found.config
        clock.lap("budget")
    subject = open_subject(config)
    if found is not None:
        subject.kept = found.kept
    config, frame = subject.config, subject.frame
    check_footprint(config, subject.geometry)
    carry = Carrier(subject.display, config.export.transfer) if config.export.transfer.write else None
    clock.lap("load")
    checkpoint = Checkpoint(folder.checkpoint, config, subject.geometry)
    state = None
    if folder.resume:
        guess, notes, state = checkpoint.load()
    else:
        progress(Progress("first guess"))
        guess, notes = subject.guess()
    if config.export.glb.max_bytes is not None:
        require_room(frame.restored(guess), config.export.glb, _facts(config))
    reference = subject.reference()
    memory.release()
    clock.lap("first guess")
    with folder.opened():
        if not folder.resume:
            write_atomic(folder.path / "config.yaml", dump(config))
            checkpoint.begin(guess, notes)
        if folder.checkpoint.is_dir():
            interrupt.left_behind = f"{folder.path} holds a checkpoint; the same command with --resume goes on"
        record = Record(folder, checkpoint, interrupt, config, frame, _facts(config))
        fitted = record.fit(guess, reference, state, progress, clock.seconds["total"])
        clock.lap("fit", before=0.0 if state is None else state["seconds"])
        memory.release()
        guess, model = frame.restored(guess), frame.restored(fitted.model)
        progress(Progress("export"))
        if folder.checkpoint.is_dir():
            interrupt.left_behind = f"{folder.path} holds the finished fit; the same command with --resume judges it"
        packed = None
        if config.export.glb.max_bytes is not None:
            packed = within_bytes(model, config.export.glb, extras=_facts(config), form=config.latent.shading)
            config = with_packing(config, packed.settings)
            record = replace(record, config=config)
        written = record.export(model)  # before it is judged, whatever happens there
        clock.lap("export")
        result = replace(load_asset(written), ambient=model.ambient)  # formats but GLB do not carry it
        shown = self_check(with_own_normals(fitted.model), frame.normalised(result), form=config.latent.shading)
        candidates = {"first guess": as_exported(guess), "result": result}
        if config.evaluation.baseline:
            baseline = subject.baseline(guess.n_triangles)
            candidates = {"quadrics": as_exported(frame.restored(baseline)), **candidates}
        comparison = subject.judge(candidates, Judging.of(config), progress)
        memory.release()
        clock.lap("evaluate")
        run = {
            **_facts(config), "variant": config.variant, "notes": notes, "seconds": clock.seconds,
            "self_check": {"file": written.name, "psnr": round(shown, 2)}, **subject.facts(fitted.model),
            **({} if packed is None else {"packing": packed.note}),
            **({} if found is None else {"goal": _verdict(found, subject, comparison.figures, fitted.model)}),
        }  # fmt: skip
        comparison = replace(comparison, figures={**comparison.figures, "run": run})
        with folder.staged() as stage:
            if carry is not None:
                run["transfer"] = carry(result, stage / "transfer", progress)
                clock.lap("transfer")
            save_comparison(comparison, stage)
            write_atomic(stage / "config.yaml", dump(config))  # again: the folder may have been removed meanwhile
        report_folder(folder.path, _displayed(subject) | {"result": result})
        folder.finished()
    _require_likeness(shown, written, config.export.glb)
    return Result(folder.path, guess, model, comparison.figures)


def _verdict(found: Found, subject: Subject, figures: dict, model: Model) -> str:
    """What has come of a goal, for a person; a warning where it is missed."""
    reached = found.goal.reached(subject, figures, model)
    line, is_reached = found.goal.verdict(reached, tessellated(model).n_triangles)
    if not is_reached:
        log.warning("%s", line)
    return line


def _displayed(subject: Subject) -> dict[str, Asset]:
    """What a report shows of the subject in 3D."""
    return {} if subject.display is None else {"reference": subject.display}


def _require_likeness(psnr: float, written: Path, packed: GlbSettings = GlbSettings()) -> None:
    """Raise where a file does not show the model it was made from."""
    is_exact = packed.is_lossless or written.suffix != ".glb"
    least = LEAST_PSNR if is_exact else LEAST_LOSSY_PSNR
    if psnr < least:
        raise Defect(
            f"{written} does not show the model it was made from: {psnr:.1f} dB PSNR, where "
            f"{least:.0f} are expected; all files are kept, please report this with them"
        )


def _facts(config: Config) -> dict[str, str]:
    """What an exported file says of itself."""
    return {"generator": f"mi_simplify {__version__}", "transport": config.reference.transport}


def bake_job(
    reference: str,
    lowpoly: str,
    out: str | Path,
    progress: ProgressCallback = silent,
    *,
    keep_uv: bool = False,
    atlas_size: int | None = None,
    bake_occlusion: bool = False,
    variant: str | None = None,
    overwrite: bool = False,
) -> dict[str, Path]:
    """
    Bake the look of one file into textures for the mesh of another, which stands in the same place.

    Returns
    -------
    dict
        Format to path of the models written.

    Raises
    ------
    UserError
        A file or the folder cannot be used.
    Defect
        The exported file does not show what was baked; it is written all the same.
    """
    folder = RunFolder(out, overwrite=overwrite)
    ensure_variant(variant)
    progress(Progress("load"))
    asset, init = open_asset(reference), open_asset(lowpoly)
    progress(Progress("bake"))
    size: dict[str, Any] = {} if atlas_size is None else {"atlas_size": atlas_size}
    model, _ = first_guess(asset, mesh=init, keep_uv=keep_uv, bake_occlusion=bake_occlusion, repair=False, **size)
    progress(Progress("export"))
    with folder.opened(), folder.staged() as stage:
        files = export_model(model, stage, extras={"generator": f"mi_simplify {__version__}"})
    files = {name: folder.path / path.name for name, path in files.items()}
    _require_likeness(self_check(model, load_asset(files["glb"])), files["glb"])
    return files


def evaluate_job(
    reference: str,
    candidates: Sequence[str],
    out: str | Path | None = None,
    progress: ProgressCallback = silent,
    *,
    judging: Judging = Judging(),
    variant: str | None = None,
    overwrite: bool = False,
    animation: Mapping[str, Any] | None = None,
) -> dict:
    """
    Judge files against an asset, or that of a YAML file in its own light.

    Returns
    -------
    dict
        The figures, written as ``metrics.json`` with pictures and a report where ``out`` is given.
    """
    folder = None if out is None else RunFolder(out, overwrite=overwrite)
    ensure_variant(variant)
    progress(Progress("load"))
    is_config = Path(reference).suffix.lower() in (".yaml", ".yml")
    chosen = [{"animation": dict(animation)}] if animation else []
    named: list[dict[str, Any]] = [] if is_config else [{"asset": reference}]
    subject = open_subject(load_config(reference if is_config else None, [*named, *chosen]))
    assets = {name: open_asset(name) for name in candidates}
    comparison = subject.judge(assets, judging, progress)
    if folder is not None:
        with folder.opened():
            with folder.staged() as stage:
                save_comparison(comparison, stage)
            report_folder(folder.path, _displayed(subject) | assets)
    return comparison.figures


def figure_rows(figures: dict) -> list[str]:
    """
    One line of text for every candidate of ``metrics.json``.
    """
    width = max(len(name) for name in figures["candidates"])
    return [
        f"{name:{width}}  {row['triangles']:7} triangles  PSNR {row['psnr']:5.2f} dB  FLIP {row['flip']:.4f}"
        f"  silhouette error {row['silhouette_error']:.4f}"
        for name, row in figures["candidates"].items()
    ]
