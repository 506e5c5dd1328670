"""
Damaged files through readers, validation, clean-up and decimation: each must end in a result or in one clear line.

    python tests/fuzz/fuzz.py --inputs 20000            # minutes; exit code 1 and a folder of findings if there are any
    python tests/fuzz/fuzz.py --only 4711 --kinds glb   # one input again, in this process, with its traceback

Input number n of a seed is the same on every machine. Each is read in a worker process; a traceback, an error of
several lines, a dead worker, more than 10 s or more than 2 GB is a finding.
"""

from __future__ import annotations

import argparse
import collections
import faulthandler
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import types
import warnings
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parents[1])]

import containers  # noqa: E402
import mutations  # noqa: E402
import numpy as np  # noqa: E402
from seeds import Seed, seeds  # noqa: E402

from mi_simplify.config import dump, load_config  # noqa: E402
from mi_simplify.errors import UserError  # noqa: E402
from mi_simplify.formats.load import load_asset  # noqa: E402
from mi_simplify.formats.usd import layers as usd_layers  # noqa: E402
from mi_simplify.initial.reduce.cleanup import clean  # noqa: E402
from mi_simplify.initial.reduce.decimate import decimate  # noqa: E402
from mi_simplify.initial.soup import merge  # noqa: E402
from mi_simplify.machine.memory import limited  # noqa: E402

LONGEST = 10.0  # [s] for one input
LARGEST = 2 << 30  # [bytes] that a worker may hold
RESULT, REFUSED = "result", "refused"
_ADDRESSES = 8 << 30  # [bytes] a worker may reserve, so that a finding does not take the machine down
_BEFORE_A_NEW_WORKER = 2000  # inputs; the peak of a process's memory never falls again


def kind_of(number: int, kinds: tuple[str, ...]) -> str:
    """
    What input ``number`` is.
    """
    known = sorted({s.kind for s in seeds() if not kinds or s.kind in kinds})
    return known[number % len(known)]


def damaged(number: int, seed: int, kinds: tuple[str, ...]) -> tuple[Seed, dict[str, bytes]]:
    """
    Input ``number``: a seed, and its files of which one is mutated.
    """
    rng, kind = np.random.default_rng([seed, number]), kind_of(number, kinds)
    alike = [s for s in seeds() if s.kind == kind]
    chosen, other = (alike[k] for k in rng.integers(len(alike), size=2))
    data, foreign = chosen.files[chosen.target], other.files[other.target]
    in_parts = {
        "glb": containers.glb, "png": containers.png, "png-deep": containers.png, "usdc": containers.usdc,
        "usdz": containers.usdz, "xml": containers.xml,
    }  # fmt: skip
    if kind in in_parts and rng.random() < 0.8:
        data = in_parts[kind](data, foreign, rng)
    else:
        text = kind in ("obj", "mtl", "ply", "stl", "gltf", "usda", "yaml", "xml", "xml-mesh")
        data = mutations.mutate(data, foreign, rng, text or (kind == "ply-binary" and rng.random() < 0.3))
    return chosen, {**chosen.files, chosen.target: data}


def read(entry: Path) -> None:
    """
    What a job does with a file before it renders.
    """
    if entry.suffix == ".yaml":
        dump(load_config(entry))
        return
    soup, _ = clean(merge(load_asset(entry)))
    decimate(soup.positions, soup.position_faces, 8)


def outcome(entry: Path) -> str:
    """
    ``RESULT`` or ``REFUSED`` where a file ends as it should, else what is wrong.
    """
    verdict = RESULT
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        with warnings.catch_warnings(action="error"), limited(LARGEST):
            read(entry)
    except UserError as error:
        text = str(error)
        if "\n" in text or not text.strip() or len(text) > 2000:
            return f"the message is not one line: {text[:160]!r} … {text[-80:]!r}, {len(text)} characters"
        if isinstance(error.__cause__, MemoryError):
            return f"out of memory: {text[:300]}"
        verdict = REFUSED
    except Exception as error:
        own = [f for f in traceback.extract_tb(error.__traceback__) if "mi_simplify" in f.filename]
        where = f" at {Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""
        return f"{type(error).__name__}{where}: {str(error)[:200]}"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return f"{peak >> 20} GB of memory" if peak << 10 > LARGEST and peak > before else verdict


class Rehearsal:
    """
    Stands in for ``subprocess`` where a USD file is opened in a process of its own: a fork of one that stands ready.
    """

    TimeoutExpired = subprocess.TimeoutExpired

    def __init__(self):
        context = multiprocessing.get_context("fork")
        self._here, there = context.Pipe()
        self._process = context.Process(target=self._serve, args=(there, self._here), daemon=True)
        self._process.start()

    @staticmethod
    def _serve(asked, other) -> None:
        other.close()  # or it would not be told that the one who asks has died
        while True:
            try:
                path, room = asked.recv()
            except EOFError:
                return
            there, here = os.pipe()
            worker = os.fork()
            if not worker:
                signal.alarm(round(LONGEST / 2))
                code, said = usd_layers._work(path, room)
                os.write(here, said.encode(errors="replace"))
                os._exit(code)
            os.close(here)
            code = os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1])
            with os.fdopen(there, "rb") as pipe:
                asked.send((code, pipe.read()))

    def run(self, command: list[str], *, timeout: float, **_) -> types.SimpleNamespace:
        """How the worker ended; one that hangs, as USD does with some crates, gets less than its ``timeout``."""
        *_, path, room = command
        self._here.send((path, int(room)))
        code, said = self._here.recv()
        if code == -signal.SIGALRM:
            raise subprocess.TimeoutExpired(command, timeout)
        return types.SimpleNamespace(returncode=code, stdout=said)


def _work(numbers: range, arguments: argparse.Namespace, current, results) -> None:
    """The loop of a worker: inputs in order, ``current`` is the one it is at."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    usd_layers.subprocess = Rehearsal()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        for number in numbers:
            current.value = number
            seed, files = damaged(number, arguments.seed, arguments.kinds)
            for name, data in files.items():
                Path(folder, name).write_bytes(data)
            finding = outcome(Path(folder, seed.entry))
            for name in files:
                Path(folder, name).unlink()
            results.put((number, seed.kind, finding))
    current.value = -2


def run(arguments: argparse.Namespace) -> list[tuple[int, str, str]]:
    """
    All inputs in a worker process that is replaced where it dies; returns the findings: number, kind, what is wrong.
    """
    context = multiprocessing.get_context("fork")  # nothing has started a thread yet
    seeds()
    findings: list[tuple[int, str, str]] = []
    done: collections.Counter[tuple[str, bool]] = collections.Counter()
    begin, stop = time.monotonic(), arguments.start + arguments.inputs
    number = arguments.start
    results = context.SimpleQueue()
    current = context.Value("q", -1, lock=False)

    def drain() -> None:
        while not results.empty():
            _, kind, finding = result = results.get()
            done[kind, finding == RESULT] += 1
            if finding not in (RESULT, REFUSED):
                findings.append(result)
                print(*result, flush=True)

    while number < stop and time.monotonic() - begin < arguments.seconds:
        current.value = number
        numbers = range(number, min(number + _BEFORE_A_NEW_WORKER, stop))
        worker = context.Process(target=_work, args=(numbers, arguments, current, results))
        worker.start()
        at, since = number, time.monotonic()
        verdict = ""
        while worker.is_alive() and time.monotonic() - begin < arguments.seconds:
            worker.join(0.05)
            drain()
            if current.value != at:
                at, since = current.value, time.monotonic()
            elif time.monotonic() - since > LONGEST:
                verdict = f"longer than {LONGEST:.0f} s"
                break
            if _resident(worker.pid) > LARGEST:
                verdict = f"more than {LARGEST / (1 << 30):g} GB"
                break
        if worker.is_alive():
            worker.kill()
        worker.join()
        drain()
        at = current.value
        if at == -2:
            number = numbers.stop
            continue
        if not verdict and worker.exitcode != -9:
            verdict = f"the process died (exit code {worker.exitcode})"
        if verdict:
            findings.append((at, kind_of(at, arguments.kinds), verdict))
            print(*findings[-1], flush=True)
        number = at + 1
    seconds = time.monotonic() - begin
    total = sum(done.values())
    print(f"{total} inputs in {seconds:.0f} s ({total / seconds:.0f} a second), {len(findings)} findings")
    for kind in sorted({kind for kind, _ in done}):
        good, refused = done[kind, True], done[kind, False]
        print(f"{kind:10}  {good + refused} inputs, {good} gave a result")
    return findings


def _resident(pid: int | None) -> int:
    """Memory that a process holds [bytes]; 0 once it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def _write(number: int, arguments: argparse.Namespace, folder: Path) -> Path:
    """The files of an input, in a folder; returns the one to open."""
    seed, files = damaged(number, arguments.seed, arguments.kinds)
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / seed.entry


def main() -> int:
    """
    The command line; returns 1 where something was found.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--start", type=int, default=0, help="number of the first input")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so many")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", type=lambda text: tuple(text.split(",")), default=(), help="obj,ply,glb,…; all")
    parser.add_argument("--only", type=int, help="this input alone, in this process")
    parser.add_argument("--findings", type=Path, default=Path("out/fuzz"), help="folder for the inputs of findings")
    arguments = parser.parse_args()
    faulthandler.enable()
    if arguments.only is not None:
        entry = _write(arguments.only, arguments, arguments.findings / str(arguments.only))
        print(entry)
        read(entry)
        return 0
    findings = run(arguments)
    for number, _, finding in findings[:100]:
        entry = _write(number, arguments, arguments.findings / str(number))
        (entry.parent / "finding.txt").write_text(f"{entry.name}: {finding}\n")
    return bool(findings)


if __name__ == "__main__":
    sys.exit(main())
