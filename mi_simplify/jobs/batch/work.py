"""
One entry in a process of its own, since native code can abort: its command, its limits, and what it leaves.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import AssetError, OutputError
from ...machine.files import make_folder, write_atomic
from ...machine.memory import shown_size
from .entries import Entry
from .ledger import DONE, Outcome
from .remote import fetched, is_address

#: How often a running process is looked at [s].
_INTERVAL = 0.1

#: A process that was taken down for a limit says so in place of an exit code of its own.
OVER_LIMIT = 3


@dataclass(frozen=True)
class Limits:
    """
    What one entry may take: resident memory [bytes] and time [s], None for as much as it likes, and threads.
    """

    memory: int | None = None
    seconds: float | None = None
    threads: int = 1


def work(entry: Entry, fingerprint: str, folder: str, limits: Limits) -> Outcome:
    """
    Make one entry below a folder: an unfinished run is resumed from its checkpoint, another is replaced.

    Returns
    -------
    Outcome
        Also written into the entry's folder where it is done; a failed one leaves nothing that was not there.

    Raises
    ------
    OutputError
        The disk is full, which is not this entry's fault and would be that of all others.
    """
    out = Path(folder, entry.name)
    if entry.command == "none":
        outcome = Outcome(entry.name, fingerprint, 0)
        make_folder(out)
    else:
        outcome = _made(entry, fingerprint, out, limits)
    if outcome.code == 0:
        write_atomic(out / DONE, outcome.as_line() + "\n")
    return outcome


def _made(entry: Entry, fingerprint: str, out: Path, limits: Limits) -> Outcome:
    """By its command, with copies of files that are behind addresses; these stay for an entry that is tried again."""
    copies = out.with_name(f".fetched-{fingerprint}")
    try:
        asset, *files = (fetched(x, copies) if is_address(x) else x for x in (entry.asset, *entry.files))
    except AssetError as error:
        return Outcome(entry.name, fingerprint, error.exit_code, str(error))
    here = entry.model_copy(update={"asset": str(asset), "files": tuple(map(str, files))})
    resumable = entry.command == "simplify" and (out / "checkpoint").is_dir()
    outcome = _ran(here, fingerprint, out, "--resume" if resumable else "--overwrite", limits)
    if resumable and outcome.code == 2:  # a checkpoint of other settings
        outcome = _ran(here, fingerprint, out, "--overwrite", limits)
    if outcome.code == 0:
        outcome = replace(outcome, figures=_figures(here, out))
    if outcome.code in (0, 2):
        shutil.rmtree(copies, ignore_errors=True)
    return outcome


def _ran(entry: Entry, fingerprint: str, out: Path, flag: str, limits: Limits) -> Outcome:
    begin, peak = time.monotonic(), 0.0
    command = [sys.executable, "-m", "mi_simplify", *entry.arguments(out), flag]
    threads = dict.fromkeys(("MI_SIMPLIFY_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(limits.threads))
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        errors="replace", env=os.environ | threads, preexec_fn=_die_with_parent if sys.platform == "linux" else None,
    )  # fmt: skip
    over = ""
    while True:
        try:
            _, said = process.communicate(timeout=_INTERVAL)
            break
        except subprocess.TimeoutExpired:
            peak = max(peak, _resident(process.pid))
        if limits.memory is not None and peak > limits.memory:
            over = f"took more than {shown_size(limits.memory)}; raise --memory, or ask for less"
        if limits.seconds is not None and time.monotonic() - begin > limits.seconds:
            over = f"took longer than {limits.seconds:g} s; raise --timeout, or ask for less"
        if over:
            process.kill()
    code, line = process.returncode, _last_line(said)
    if over:
        code, line = OVER_LIMIT, over
    elif code < 0:
        line = f"killed by {signal.Signals(-code).name}" + (f" after: {line}" if line else "")
    full = [text for text in said.splitlines() if any(os.strerror(n) in text for n in (errno.ENOSPC, errno.EDQUOT))]
    if code and full:
        raise OutputError(f"{_last_line(full[-1]).partition('; ')[0]}; make room, and the same command goes on")
    return Outcome(entry.name, fingerprint, code, line if code else "", time.monotonic() - begin, peak)


def _figures(entry: Entry, out: Path) -> dict:
    """What the files of a result say of it, as far as its command writes them."""
    from .thumbnail import thumbnail

    figures: dict = {}
    model, metrics = out / "model.glb", out / "metrics.json"
    if model.is_file():
        figures["bytes"] = model.stat().st_size
    if metrics.is_file():
        judged = json.loads(metrics.read_text(encoding="utf-8"))["candidates"]
        row = judged.get("result") or next(iter(judged.values()))
        figures |= {key: row[key] for key in ("triangles", "vertices", "psnr", "flip") if key in row}
        thumbnail(out)
    return figures


def _last_line(text: str) -> str:
    """The error, of what a process said: its traceback and warnings come before."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].removeprefix("error: ")[:500] if lines else ""


def _resident(pid: int) -> float:
    """Memory that a process holds [bytes], 0 where nobody tells."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return float(pages * os.sysconf("SC_PAGE_SIZE"))
    return 0.0


_libc = ctypes.CDLL(None) if sys.platform == "linux" else None


def _die_with_parent() -> None:
    """In the child: a worker that is killed takes its process along, or it would write on beside the next one."""
    assert _libc is not None
    _libc.prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
