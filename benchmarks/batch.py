"""
A library of small assets by `mi-simplify batch`: what it costs beside single runs, and what it survives.

    python benchmarks/batch.py assets --n 60 --models ../shared/assets/spot   # three broken: time, memory, exit code
    python benchmarks/batch.py overhead --n 8                                 # what each asset takes beside its process
    python benchmarks/batch.py nothing --n 10000                              # entries that only write their line
    python benchmarks/batch.py cluster --n 6                                  # two Ray nodes, then one of them dies
    python benchmarks/batch.py kills --n 6 --times 10                         # the driver dies at random moments
    python benchmarks/batch.py disk --n 4                                     # as root: a file system that is too small

The best time that can be had for `assets` is that of all single runs, one after another, over the speed-up of two
beside each other. Results are equal where the bytes of the models and the figures of all candidates are.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from mi_simplify.initial.sphere import sphere
from mi_simplify.jobs.batch.batch import batch_job
from mi_simplify.jobs.batch.entries import Entry, read_entries
from mi_simplify.jobs.batch.needs import expected_memory
from mi_simplify.machine.memory import shown_size

N_BROKEN, SAMPLES = 3, ("sample:relic:20k", "sample:fish")

#: Small enough that sixty of them take minutes.
TINY = [
    "preset=fast", "initial.atlas_size=64", "optimizer.steps=8", "optimizer.resolution=32", "optimizer.batch=1",
    "reference.pool=4", "evaluation.views=1", "evaluation.resolution=32", "evaluation.spp=4", "export.formats=glb",
]  # fmt: skip


def library(folder: Path, n: int, n_broken: int = 0, models: Sequence[Path] = ()) -> Path:
    """A folder of models: those named, and spheres with waves and colours of their own; the last ones are cut off."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in models:
        for file in path.iterdir() if path.is_dir() else [path]:
            shutil.copy(file, folder)
    n -= len(read_entries([str(folder)], [], {})) if models else 0
    rng = np.random.default_rng(5)
    for k in range(n):
        positions, faces = sphere(int(rng.integers(1000, 4000)) * 4 ** int(rng.integers(2)))
        waves = np.sin(rng.uniform(3, 9, 3) * positions)
        positions = positions * (1 + 0.1 * waves.sum(1, keepdims=True))
        rows = np.hstack([positions, 0.5 + 0.4 * waves])
        lines = ["v " + " ".join(f"{x:.5f}" for x in row) for row in rows]
        lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
        broken = k >= n - n_broken
        (folder / f"asset{k:03}.obj").write_text("\n".join(lines[: len(rows) // 2] if broken else lines))
    return folder


def command(sources: Sequence[str | Path], out: Path, settings: Sequence[str], *more: str) -> list[str]:
    """The command line of a batch."""
    line = [sys.executable, "-m", "mi_simplify", "batch", *map(str, sources), "-o", str(out), "--triangles", "200"]
    return [*line, *(x for s in settings for x in ("--set", s)), *more]


def batched(sources: Sequence[str | Path], out: Path, settings: Sequence[str], *more: str) -> tuple[int, float, str]:
    """Exit code, seconds, and the last line that the batch said."""
    begin = time.perf_counter()
    done = subprocess.run(command(sources, out, settings, *more), capture_output=True, text=True, check=False)
    said = (done.stderr if done.returncode not in (0, 2) or not done.stdout else done.stderr + done.stdout).splitlines()
    return done.returncode, time.perf_counter() - begin, next((x for x in said if x.startswith("error")), said[-1])


def ended(out: Path) -> dict[str, dict]:
    """The line of each entry by name; an entry that is done twice is a mistake."""
    lines = [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines() if line]
    done = [line["name"] for line in lines if line["code"] == 0]
    assert len(done) == len(set(done)), f"twice: {done}"
    return {line["name"]: line for line in lines}


def results(out: Path) -> dict[str, tuple[str, str]]:
    """By entry that is done: hash of its model, and the figures of all candidates."""
    found = {}
    for name, line in ended(out).items():
        if line["code"] == 0:
            figures = json.loads((out / name / "metrics.json").read_text())["candidates"]
            figures = {key: row | {"file": ""} for key, row in figures.items()}  # which has the folder in its path
            model = hashlib.sha256((out / name / "model.glb").read_bytes()).hexdigest()
            found[name] = (model, json.dumps(figures, sort_keys=True))
    return found


def same(a: dict, b: dict) -> str:
    """How many of the results in ``a`` those in ``b`` are equal to."""
    return f"{sum(b.get(name) == value for name, value in a.items())} of {len(a)} equal to the bit"


def single(entry: Entry, out: Path) -> float:
    """Seconds of one `simplify`."""
    begin = time.perf_counter()
    line = [sys.executable, "-m", "mi_simplify", *entry.arguments(out), "--overwrite"]
    subprocess.run(line, check=False, capture_output=True)
    return time.perf_counter() - begin


def of_assets(args: argparse.Namespace) -> str:
    """Half of the single runs before the batch and half after it, since a machine is not equally busy all the time."""
    folder = library(args.out / "models", args.n - len(SAMPLES), N_BROKEN, args.models)
    sources, settings = [str(folder), *SAMPLES], dict(text.split("=", 1) for text in args.set)
    entries = read_entries(sources, [], {"triangles": "200", "set": settings})
    alone, beside = [], []

    def singles(some: Sequence[Entry]) -> None:
        alone.extend(single(entry, args.out / "alone") for entry in some)
        pair = [e for e in some if e.asset.endswith(".obj")][:2]
        begin = time.perf_counter()
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda e: single(e, args.out / f"beside-{e.name}"), pair))
        beside.append((sum(alone[len(alone) - len(some) + some.index(e)] for e in pair), time.perf_counter() - begin))

    singles(entries[:: 2 * args.every])
    code, seconds, _ = batched(sources, args.out / "together", args.set)
    singles(entries[args.every :: 2 * args.every])
    speed_up = sum(x for x, _ in beside) / sum(y for _, y in beside)
    total = sum(alone) / len(alone) * len(entries)
    lines, best = ended(args.out / "together"), total / speed_up
    failed = [name for name, line in lines.items() if line["code"]]
    shares = {e.name: lines[e.name]["peak"] / expected_memory(e) for e in entries}
    most = max(shares, key=lambda name: shares[name])
    return (
        f"{len(entries)} assets: exit code {code}, {len(lines) - len(failed)} done, failed: {', '.join(failed)};"
        f" {seconds:.0f} s, alone {total:.0f} s (by {len(alone)} of them), two beside each other {speed_up:.2f} times"
        f" as fast: {seconds / best:.2f} times the best; memory at most {shares[most]:.0%} of the forecast ({most}),"
        f" {shown_size(max(line['peak'] for line in lines.values()))}"
    )


def of_overhead(args: argparse.Namespace) -> str:
    """What a batch of one at a time takes, less what the processes of its entries took themselves."""
    folder = library(args.out / "models", args.n)
    _, few, _ = batched([folder / "asset000.obj"], args.out / "one", args.set, "--jobs", "1")
    first = ended(args.out / "one")["asset000"]["seconds"]
    _, seconds, _ = batched([folder], args.out / "all", args.set, "--jobs", "1")
    own = sum(line["seconds"] for line in ended(args.out / "all").values())
    more = (seconds - own - (few - first)) / (args.n - 1)
    return (
        f"{args.n} assets one at a time: {seconds:.1f} s, their processes {own:.1f} s: {(seconds - own) / args.n:.2f} s"
        f" an asset with the start of Ray, {more:.2f} s without it (a batch of one: {few - first:.1f} s)"
    )


def of_nothing(args: argparse.Namespace) -> str:
    entries = [Entry(asset=f"m{k}.obj", name=f"m{k:05}", command="none") for k in range(args.n)]
    begin = time.perf_counter()
    made = batch_job(entries, args.out / "nothing")
    seconds = time.perf_counter() - begin
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    page = args.out / "nothing" / "index.html"
    size = shown_size(page.stat().st_size)
    return f"{args.n} entries: exit code {made.exit_code}, {seconds:.0f} s, driver {shown_size(held)}, page {size}"


def of_cluster(args: argparse.Namespace) -> str:
    """Here, on two nodes, and on two nodes of which one dies once something is done."""
    from ray.cluster_utils import Cluster

    folder = library(args.out / "models", args.n)
    batched([folder], args.out / "local", args.set)
    said = []
    for name, dies in (("cluster", False), ("dying", True)):
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        second = cluster.add_node(num_cpus=1)
        out = args.out / name
        line = command([folder], out, args.set, "--address", cluster.address)
        process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        if dies:
            _until(lambda out=out: (out / "results.jsonl").is_file(), process)
            cluster.remove_node(second, allow_graceful=False)  # SIGKILL
        code = process.wait()
        cluster.shutdown()
        said.append(f"{name}: exit code {code}, {same(results(args.out / 'local'), results(out))}")
    return "; ".join(said)


def _until(holds: Callable[[], bool], process: subprocess.Popen) -> None:
    while process.poll() is None and not holds():
        time.sleep(0.05)


def of_kills(args: argparse.Namespace) -> str:
    """Drivers that die within the time that a whole batch takes, each in what the one before left; then a last one."""
    folder, settings = library(args.out / "models", args.n), [*args.set, "export.checkpoint=1"]
    _, seconds, _ = batched([folder], args.out / "whole", settings)
    rng, out, left = np.random.default_rng(3), args.out / "killed", []
    for _ in range(args.times):
        process = subprocess.Popen(
            command([folder], out, settings), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            process.wait(rng.uniform(0.2, 0.8) * seconds)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        n_done = sum(path.is_file() for path in out.glob("*/batch.json"))
        left.append(args.n - n_done)
        if n_done == args.n:  # to have something to kill
            assert same(results(args.out / "whole"), results(out)) == same(*[results(args.out / "whole")] * 2)
            shutil.rmtree(out)
    code, _, _ = batched([folder], out, settings)
    equal = same(results(args.out / "whole"), results(out))
    return f"{args.times} kills, entries left after each {left}: then exit code {code}, {equal}"


def of_disk(args: argparse.Namespace) -> str:
    """A tmpfs with room for half of the results, then for all."""
    folder, small = library(args.out / "models", args.n), args.out / "small"
    batched([folder], args.out / "whole", args.set)
    size = sum(path.stat().st_size for path in (args.out / "whole").rglob("*") if path.is_file()) >> 10
    small.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size // 2}k", "tmpfs", str(small)], check=True)
    try:
        code, _, line = batched([folder], small, args.set)
        n_done = len(results(small)) if (small / "results.jsonl").is_file() else 0
        subprocess.run(["mount", "-o", f"remount,size={4 * size}k", str(small)], check=True)
        again, _, _ = batched([folder], small, args.set)
        equal = same(results(args.out / "whole"), results(small))
    finally:
        subprocess.run(["umount", "-l", str(small)], check=True)
    return f"full: exit code {code}, {n_done} done, '{line}'; with room: exit code {again}, {equal}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    cases = {
        "assets": of_assets, "overhead": of_overhead, "nothing": of_nothing, "cluster": of_cluster, "kills": of_kills,
        "disk": of_disk,
    }  # fmt: skip
    parser.add_argument("case", choices=cases)
    parser.add_argument("--n", type=int, default=6, help="assets")
    parser.add_argument("--every", type=int, default=1, help="of the assets are run alone, for the time of all")
    parser.add_argument("--times", type=int, default=10, help="kills of the driver")
    parser.add_argument("--models", type=Path, nargs="*", default=[], help="files and folders, for the first ones")
    parser.add_argument("--out", type=Path, default=Path("out/batch"))
    parser.add_argument("--set", nargs="*", default=TINY, help="for all assets")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    print(cases[args.case](args))


if __name__ == "__main__":
    main()
