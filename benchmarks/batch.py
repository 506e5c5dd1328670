"""
A library of small assets by `mi-simplify batch`: its time beside that of single runs, its memory, what broken files do.

    python benchmarks/batch.py --assets 60 --out out/batch      # three of them broken
    python benchmarks/batch.py --nothing 10000                  # entries that only write their line

The best that can be had is the time of all single runs, one after another, over the speed-up of two beside each other.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from mi_simplify.jobs.batch.batch import batch_job
from mi_simplify.jobs.batch.entries import Entry
from mi_simplify.machine.memory import shown_size

N_BROKEN = 3


def library(folder: Path, n: int) -> list[Entry]:
    """Spheres with waves of their own, as OBJ files; the last three are cut off."""
    from mi_simplify.initial.sphere import sphere

    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(5)
    entries = []
    for k in range(n):
        positions, faces = sphere(int(rng.integers(1000, 4000)))
        positions = positions * (1 + 0.1 * np.sin(rng.uniform(3, 9, 3) * positions).sum(1, keepdims=True))
        path = folder / f"asset{k:03}.obj"
        lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in positions] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
        path.write_text("\n".join(lines[: len(positions) // 2] if k >= n - N_BROKEN else lines))
        entries.append(Entry(asset=str(path.resolve()), name=path.stem))
    return entries


def single(entry: Entry, settings: Sequence[str], out: Path) -> float:
    """Seconds of one `simplify`."""
    command = [sys.executable, "-m", "mi_simplify", "simplify", entry.asset, "--quiet", "--overwrite"]
    command += ["-o", str(out), "--triangles", "200", *(x for s in settings for x in ("--set", s))]
    begin = time.perf_counter()
    subprocess.run(command, check=False, capture_output=True)
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=int, default=0)
    parser.add_argument("--nothing", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/batch"))
    parser.add_argument("--set", nargs="*", default=["preset=fast", "initial.atlas_size=256"], help="for all assets")
    args = parser.parse_args()
    if args.nothing:
        entries = [Entry(asset=f"m{k}.obj", name=f"m{k:05}", command="none") for k in range(args.nothing)]
        begin = time.perf_counter()
        made = batch_job(entries, args.out / "nothing")
        held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        size = (args.out / "nothing" / "index.html").stat().st_size
        print(f"{args.nothing} entries: exit code {made.exit_code}, {time.perf_counter() - begin:.0f} s,"
              f" driver {shown_size(held)}, page {shown_size(size)}")  # fmt: skip
    if args.assets:
        settings = {key: value for key, _, value in (text.partition("=") for text in args.set)}
        entries = [
            e.model_copy(update={"triangles": "200", "settings": settings})
            for e in library(args.out / "models", args.assets)
        ]
        alone = [single(e, args.set, args.out / "alone") for e in entries]
        pair = entries[:2]
        begin = time.perf_counter()
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda e: single(e, args.set, args.out / f"beside-{e.name}"), pair))
        speed_up = sum(alone[:2]) / (time.perf_counter() - begin)
        begin = time.perf_counter()
        made = batch_job(entries, args.out / "together", jobs=2)
        seconds = time.perf_counter() - begin
        best = sum(alone) / speed_up
        peak = max(outcome.peak for outcome in made.outcomes.values())
        print(
            f"{args.assets} assets: exit code {made.exit_code}, {len(made.failed)} failed; {seconds:.0f} s, alone"
            f" {sum(alone):.0f} s, two beside each other {speed_up:.2f} times as fast: {seconds / best:.2f} times the"
            f" best; largest process {shown_size(peak)}"
        )


if __name__ == "__main__":
    main()
