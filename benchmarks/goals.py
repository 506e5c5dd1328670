"""
Whether `--psnr` finds the least model that reaches it: beside runs of budgets around the one that it found.

    .venv/bin/python benchmarks/goals.py ../shared/assets/skull/skull.obj:38 --set preset=fast

The least by brute force is where PSNR over the logarithm of the triangles crosses the goal, between two of these runs
(below or above all of them where it does not). The time is that of the whole
job over that of what follows the search, which is the run of a budget that is known.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import mi_simplify as ms

HEADS = ("asset", "goal [dB]", "reached [dB]", "triangles", "least by brute force", "ratio", "time, over one run")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("assets", nargs="+", help="each with its goal: FILE:DECIBELS")
    parser.add_argument("--factors", default=".8,.91,1.1", help="budgets of the brute force, over the one found")
    parser.add_argument("--out", type=Path, default=Path("out") / "goals")
    parser.add_argument("--set", nargs="*", default=[], help="configuration keys")
    args = parser.parse_args()
    factors = [float(x) for x in args.factors.split(",")]
    print("| " + " | ".join(HEADS) + " |\n" + "|---" * len(HEADS) + "|")
    for named in args.assets:
        name, goal = named.rsplit(":", 1)
        print("| " + " | ".join(row(name, float(goal), factors, args)) + " |", flush=True)


def row(name: str, goal: float, factors: list[float], args: argparse.Namespace) -> list[str]:
    """Cells of one asset."""
    out = args.out / Path(name.replace(":", "_")).stem

    def run(label: str, *more: str) -> tuple[ms.Config, dict[str, Any]]:
        config = ms.load_config(None, [f"asset={name}", "export.formats=glb", *args.set, *more])
        ms.run_job(config, out / label, overwrite=True)
        figures = json.loads((out / label / "metrics.json").read_text())
        return ms.load_config(out / label / "config.yaml"), figures

    found_config, found = run("goal", f"goal.psnr={goal}")
    asked = found_config.initial.triangles
    assert isinstance(asked, int)
    result, seconds = found["candidates"]["result"], found["run"]["seconds"]
    psnr: dict[int, float] = {result["triangles"]: result["psnr"]}
    for factor in factors:
        _, figures = run(f"{factor:g}", f"initial.triangles={round(asked * factor)}")
        other = figures["candidates"]["result"]
        psnr[other["triangles"]] = other["psnr"]
    least = crossing(psnr, goal)
    return [
        Path(name).name, f"{goal:g}", f"{result['psnr']:.2f}", f"{result['triangles']}",
        ", ".join(f"{n}: {psnr[n]:.2f}" for n in sorted(psnr)) + f" → {least[0]}",
        f"{result['triangles'] / least[1]:.2f}", f"{seconds['total'] / (seconds['total'] - seconds['budget']):.2f}",
    ]  # fmt: skip


def crossing(psnr: dict[int, float], goal: float) -> tuple[str, float]:
    """The number of triangles from which on a goal is reached, as text and as a number."""
    n = np.array(sorted(psnr))
    y = np.array([psnr[k] for k in n])
    enough = np.flatnonzero(y >= goal)
    if not len(enough):
        return f"above {n[-1]}", float(n[-1])
    k = int(enough[0])
    if k == 0:
        return f"below {n[0]}", float(n[0])
    x = float(np.exp(np.interp(goal, y[k - 1 : k + 1], np.log(n[k - 1 : k + 1]))))
    return f"{x:.0f}", x


if __name__ == "__main__":
    main()
