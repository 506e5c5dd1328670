"""
The folder of one run: checked before the work starts, made once the input is known to be good.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import OutputError, UserError
from ..machine.files import write_atomic
from .checkpoint import STATE

log = logging.getLogger("mi_simplify")

LOG = "log.jsonl"
CHECKPOINT = "checkpoint"
MARKS = (
    "config.yaml", "metrics.json", LOG, CHECKPOINT, "preview.png", "tensorboard",
    "model.glb", "model.obj", "model.usdc", "forest.json",
)  # fmt: skip
"""What only a run of ours leaves behind; a folder with one of these holds a run."""

BESIDES = ("model.mtl", "model_*.png", "displacement", "mips", "transfer")
"""What goes with a run when it is replaced, and may be anybody's elsewhere."""

_STAGE = ".writing-"


def check_writable(path: str | Path) -> None:
    """
    Raise :class:`OutputError` unless a file or folder of this name can be made; writes nothing.
    """
    path = Path(path).absolute()
    parent = path if path.is_dir() else path.parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise OutputError(f"cannot write {path}: {parent} is a file, not a folder; choose another -o")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write {path}: no permission in {parent}; choose another -o")


class RunFolder:
    """
    Where a run writes: log and checkpoint while it goes on, all results together at its end.

    Parameters
    ----------
    path : str or Path
    overwrite : bool
        Replace a run that is there.
    resume : bool
        Go on with a run that is there.

    Raises
    ------
    OutputError
        The folder cannot be written; it holds a run and neither ``overwrite`` nor ``resume`` is set; or there is
        nothing to resume.
    """

    def __init__(self, path: str | Path, *, overwrite: bool = False, resume: bool = False):
        self.path, self.resume, self._log_failed = Path(path), resume, False
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path} is a file, not a folder; choose another -o")
        check_writable(self.path)
        if resume and overwrite:
            raise OutputError("--resume goes on with a run and --overwrite replaces it: choose one of them")
        if resume and not self.checkpoint.is_dir():
            raise OutputError(f"{self.path} holds {self._instead_of_checkpoint()}")
        if self.holds_run() and not (overwrite or resume):
            way_out = "--resume to go on with it, " if self.checkpoint.is_dir() else ""
            raise OutputError(
                f"{self.path} already holds a run; pass {way_out}--overwrite to replace it, or choose another -o"
            )

    @property
    def checkpoint(self) -> Path:
        """Where an unfinished run keeps what it needs to go on."""
        return self.path / CHECKPOINT

    def _instead_of_checkpoint(self) -> str:
        if (self.path / "metrics.json").exists():
            return "a finished run, there is nothing to resume; pass --overwrite to do it again"
        if self.holds_run():
            return "a run without a checkpoint, there is nothing to resume; pass --overwrite to begin anew"
        return "no run, there is nothing to resume; leave out --resume"

    def holds_run(self) -> bool:
        """Whether a run of ours left its marks here."""
        return any((self.path / name).exists() for name in MARKS)

    @contextlib.contextmanager
    def opened(self) -> Iterator[RunFolder]:
        """
        Make the folder, without what an earlier run left unless that is resumed; where the user's input turns out to be
        wrong before there is a model or anything to resume, nothing of it stays behind.
        """
        made = [p for p in (self.path, *self.path.parents) if not p.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            for unfinished in self.path.glob(f"{_STAGE}*"):
                _remove(unfinished)
            for name in () if self.resume or not self.holds_run() else (*MARKS, *BESIDES):
                for path in self.path.glob(name):
                    _remove(path)
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror}; choose another -o") from None
        try:
            yield self
        except UserError:
            if self.resume or (self.checkpoint / STATE).exists() or any(self.path.glob("model.*")):
                raise
            with contextlib.suppress(OSError):  # something else was put there meanwhile
                for name in MARKS:
                    _remove(self.path / name)
                for folder in made:
                    folder.rmdir()
            raise

    @contextlib.contextmanager
    def staged(self) -> Iterator[Path]:
        """
        A folder to write results into; they move to their place together, or not at all.

        Raises
        ------
        OutputError
            They cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)  # somebody may have removed it while the fit ran
            with tempfile.TemporaryDirectory(prefix=_STAGE, dir=self.path) as temporary:
                yield Path(temporary)
                for item in sorted(Path(temporary).iterdir()):
                    target = self.path / item.name
                    if item.is_dir() or target.is_dir():
                        _remove(target)
                    os.replace(item, target)
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror}; make room, or choose another -o") from None

    def log(self, **record: Any) -> None:
        """
        Append one JSON object to the log; where that is not possible, a warning says so once.
        """
        try:
            with open(self.path / LOG, "a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
        except OSError as error:
            if not self._log_failed:
                log.warning("cannot write %s: %s; the run goes on without it", self.path / LOG, error.strerror)
            self._log_failed = True

    def rewind_log(self, step: int) -> None:
        """
        Drop what the log says of steps after this one, which will be done again.
        """
        path = self.path / LOG
        if path.exists():
            kept = [line for line in path.read_text(encoding="utf-8").splitlines() if _step(line) <= step]
            write_atomic(path, "".join(f"{line}\n" for line in kept))

    def finished(self) -> None:
        """
        All results are there: nothing is left to resume.
        """
        with contextlib.suppress(OSError):  # at worst it stays
            done = self.path / f"{_STAGE}{CHECKPOINT}"
            os.replace(self.checkpoint, done)  # not half of it, whenever the process ends
            _remove(done)


def _step(line: str) -> float:
    """Of a line of the log; infinite for one that a killed process did not finish."""
    try:
        return json.loads(line)["step"]
    except ValueError:
        return math.inf


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
