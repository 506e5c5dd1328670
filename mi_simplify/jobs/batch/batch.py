"""
A batch: entries that are left are made, each ends as a line on the disk, and a page shows all of them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ...errors import UserError
from ...progress import Progress, ProgressCallback, in_words, silent
from .cluster import Cluster
from .entries import Entry
from .ledger import Ledger, Outcome
from .needs import expected_memory
from .overview import write_overview
from .work import Limits

#: The page is written anew this often while the batch runs [s].
_PAGE_EVERY = 20.0


@dataclass(frozen=True)
class Batch:
    """
    What a batch came to.

    Parameters
    ----------
    folder : Path
    entries : sequence of Entry
    outcomes : dict of str to Outcome
    """

    folder: Path
    entries: Sequence[Entry]
    outcomes: dict[str, Outcome]

    @property
    def failed(self) -> list[Outcome]:
        """Those that are not done, in the order of the entries."""
        ended = [self.outcomes[e.name] for e in self.entries if e.name in self.outcomes]
        return [outcome for outcome in ended if outcome.code != 0]

    @property
    def exit_code(self) -> int:
        """0 if all are done, 2 if nothing but inputs was at fault, else 1."""
        codes = {outcome.code for outcome in self.failed}
        left = any(e.name not in self.outcomes for e in self.entries)
        return 1 if left or codes - {2} else 2 if codes else 0

    def summary(self) -> str:
        """
        A line for each that failed, and how many did not.
        """
        lines = [f"{outcome.name}: exit code {outcome.code}: {outcome.line}" for outcome in self.failed]
        done = sum(outcome.code == 0 for outcome in self.outcomes.values())
        return "\n".join([*lines, f"{self.folder}: {done} done, {len(self.failed)} failed; see index.html"])


def batch_job(
    entries: Sequence[Entry],
    out: str | Path,
    progress: ProgressCallback = silent,
    *,
    address: str | None = None,
    jobs: int | None = None,
    limits: Limits | None = None,
    retries: int = 1,
    fail_fast: bool = False,
    shard: tuple[int, int] = (1, 1),
) -> Batch:
    """
    Make what is left of a batch; see ``docs/batch.md``.

    Parameters
    ----------
    entries : sequence of Entry
        All of them, see :func:`.entries.read_entries`.
    out : str or Path
        Folder: ``manifest.json``, ``results.jsonl``, ``index.html`` and a folder for each entry.
    address, jobs
        See :class:`.cluster.Cluster`.
    limits : Limits
        Of each entry.
    retries : int
        How often an entry that failed through no fault of its input is begun anew.
    fail_fast : bool
        End with the first entry that fails.
    shard : (int, int)
        ``(i, n)``: every n-th entry from the i-th on, counted from 1; others are somebody else's.

    Raises
    ------
    UserError
        The folder cannot be written, the disk is full, or there is no Ray.
    KeyboardInterrupt
        Ctrl-C: what was running is ended, and goes on from its checkpoint the next time.
    """
    limits = limits or Limits()
    ledger = Ledger(Path(out), entries)
    mine = list(entries)[shard[0] - 1 :: shard[1]]
    left = ledger.left(mine)
    course = _Course(progress, len(mine), len(left))
    show = partial(write_overview, ledger.folder, entries, ledger.outcomes)
    show()
    memory = partial(expected_memory, limit=limits.memory)
    if left:
        try:
            with Cluster(address, jobs, limits.threads) as cluster:
                for attempt in range(retries + 1):
                    again = set()
                    for outcome in cluster.run(left, ledger.fingerprints, ledger.folder, limits, memory):
                        if outcome is None:
                            course.running = cluster.running
                        else:
                            ledger.append(outcome)
                            course.report(outcome)
                            if outcome.code not in (0, 2) and attempt < retries:
                                again.add(outcome.name)
                            elif outcome.code and fail_fast:
                                raise UserError(f"{outcome.name}: {outcome.line}")
                        if course.page_is_due():
                            show()
                    left = [e for e in left if e.name in again]
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{course.done} of {len(mine)} are done; the same command goes on") from None
        finally:
            show()
    return Batch(ledger.folder, mine, {e.name: ledger.outcomes[e.name] for e in mine if e.name in ledger.outcomes})


class _Course:
    """How far a batch is, told as outcomes come."""

    def __init__(self, progress: ProgressCallback, n_entries: int, n_left: int):
        self.progress, self.n_entries, self.n_left = progress, n_entries, n_left
        self.ended: dict[str, int] = {}
        self.running = 0
        self.begin = self.page = time.monotonic()

    @property
    def done(self) -> int:
        """Entries that ended, now and earlier."""
        return self.n_entries - self.n_left + len(self.ended)

    def report(self, outcome: Outcome) -> None:
        """Of one that ended."""
        self.ended[outcome.name] = outcome.code
        notes = [f"{outcome.name}: {outcome.line}" if outcome.code else outcome.name]
        failed = sum(code != 0 for code in self.ended.values())
        if failed:
            notes.append(f"{failed} failed")
        rest = self.n_left - len(self.ended)
        if rest:
            notes += [f"{min(self.running, rest)} running"] if self.running else []
            notes.append(f"about {in_words((time.monotonic() - self.begin) / len(self.ended) * rest)} left")
        self.progress(Progress("batch", self.done, self.n_entries, message=", ".join(notes)))

    def page_is_due(self) -> bool:
        """Whether the page is to be written anew."""
        due = time.monotonic() - self.page > _PAGE_EVERY
        if due:
            self.page = time.monotonic()
        return due
