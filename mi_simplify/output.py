"""
The folder of one run: checked before the work starts, made once the input is known to be good.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import OutputError, UserError

LOG = "log.jsonl"
CHECKPOINT = "checkpoint"
MARKS = ("config.yaml", "metrics.json", LOG, CHECKPOINT, "model.glb", "model.obj", "model.usdc")
"""What only a run of ours leaves behind; a folder with one of these holds a run."""


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
    Where a run writes: the log while it goes on, all results together at its end.

    Parameters
    ----------
    path : str or Path
    overwrite : bool
        Replace a run that is there.

    Raises
    ------
    OutputError
        The folder cannot be written, or holds a run and ``overwrite`` is not set.
    """

    def __init__(self, path: str | Path, *, overwrite: bool = False):
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path} is a file, not a folder; choose another -o")
        check_writable(self.path)
        if self.holds_run() and not overwrite:
            raise OutputError(f"{self.path} already holds a run; pass --overwrite to replace it, or choose another -o")

    def holds_run(self) -> bool:
        """Whether a run of ours left its marks here."""
        return any((self.path / name).exists() for name in MARKS)

    @contextlib.contextmanager
    def opened(self) -> Iterator[RunFolder]:
        """
        Make the folder, without what an earlier run left; where the user's input then turns out
        to be wrong, nothing of it stays behind.
        """
        made = [p for p in (self.path, *self.path.parents) if not p.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            for name in MARKS:
                _remove(self.path / name)
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror}; choose another -o") from None
        try:
            yield self
        except UserError:
            for name in MARKS:
                _remove(self.path / name)
            for folder in made:
                with contextlib.suppress(OSError):  # something else was put there meanwhile
                    folder.rmdir()
            raise

    @contextlib.contextmanager
    def staged(self) -> Iterator[Path]:
        """
        A folder to write results into; they move to their place together, or not at all.
        """
        with tempfile.TemporaryDirectory(prefix=".writing-", dir=self.path) as temporary:
            yield Path(temporary)
            for item in sorted(Path(temporary).iterdir()):
                target = self.path / item.name
                if item.is_dir() or target.is_dir():
                    _remove(target)
                os.replace(item, target)

    def log(self, **record: Any) -> None:
        """
        Append one JSON object to the log.
        """
        with open(self.path / LOG, "a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
