"""
What is on the disk of a batch: its manifest, one line for each asset that ended, and what of that still counts.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from ... import __version__
from ...machine.files import make_folder, output_error, write_atomic
from .entries import Entry

MANIFEST, RESULTS, DONE = "manifest.json", "results.jsonl", "batch.json"

#: Files that are looked at at once, here or behind addresses.
_READERS = 16


@dataclass(frozen=True)
class Outcome:
    """
    How an entry ended.

    Parameters
    ----------
    name, fingerprint : str
        Of the entry.
    code : int
        Exit code: 0 done, 2 the input is at fault, else ours.
    line : str
        What it said last, where it failed.
    seconds, peak : float
        Time [s] and peak memory [bytes] of its process.
    figures : dict
        Of the result: triangles, vertices, bytes, psnr [dB], flip.
    """

    name: str
    fingerprint: str
    code: int
    line: str = ""
    seconds: float = 0.0
    peak: float = 0.0
    figures: dict[str, Any] = field(default_factory=dict)

    def as_line(self) -> str:
        """
        JSON on one line.
        """
        return json.dumps(asdict(self), separators=(",", ":"), allow_nan=False)

    @staticmethod
    def of_line(text: str) -> Outcome | None:
        """
        The outcome that a line holds; None for one that was torn when the machine stopped.
        """
        try:
            keys = json.loads(text)
            return Outcome(**{f.name: keys[f.name] for f in fields(Outcome)})
        except (ValueError, LookupError, TypeError):
            return None


class Ledger:
    """
    The folder of a batch.

    Parameters
    ----------
    folder : Path
        Made where it is missing.
    entries : sequence of Entry
        Written as ``manifest.json``, resolved.

    Raises
    ------
    OutputError
        The folder cannot be written.
    """

    def __init__(self, folder: Path, entries: Sequence[Entry]):
        self.folder = make_folder(folder)
        with ThreadPoolExecutor(_READERS) as pool:
            found = pool.map(Entry.fingerprint, entries)
            self.fingerprints = {e.name: x for e, x in zip(entries, found, strict=True)}
        rows = [e.model_dump(mode="json") | {"fingerprint": self.fingerprints[e.name]} for e in entries]
        document = {"generator": f"mi_simplify {__version__}", "assets": rows}
        write_atomic(self.folder / MANIFEST, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
        self.outcomes: dict[str, Outcome] = {}
        self._read()

    def _read(self) -> None:
        """The newest outcome of every entry that is as it was; what ended without its line, too."""
        out = self.outcomes
        path = self.folder / RESULTS
        text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
        lines = text.splitlines()
        self._is_torn = bool(text) and not text.endswith("\n")
        for outcome in map(Outcome.of_line, lines):
            if outcome is not None and self.fingerprints.get(outcome.name) == outcome.fingerprint:
                out[outcome.name] = outcome
        for name, fingerprint in self.fingerprints.items():
            kept = self.folder / name / DONE
            outcome = Outcome.of_line(kept.read_text(encoding="utf-8")) if kept.is_file() else None
            if outcome is not None and outcome.fingerprint == fingerprint and name not in out:
                self.append(outcome)
            elif name in out and out[name].code == 0 and not kept.is_file():
                del out[name]  # somebody removed the result

    def append(self, outcome: Outcome) -> None:
        """
        Add a line, in one write, so that several drivers may share the file.

        Raises
        ------
        OutputError
            The disk is full, or the folder gone.
        """
        path = self.folder / RESULTS
        try:
            handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                line = ("\n" * self._is_torn + outcome.as_line() + "\n").encode()
                self._is_torn = False
                if os.write(handle, line) < len(line):
                    self._is_torn = True
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            finally:
                os.close(handle)
        except OSError as error:
            raise output_error(path, error) from error
        self.outcomes[outcome.name] = outcome

    def left(self, entries: Sequence[Entry]) -> list[Entry]:
        """
        The entries that are still to be made: all but those that are done and unchanged.
        """
        return [e for e in entries if e.name not in self.outcomes or self.outcomes[e.name].code != 0]
