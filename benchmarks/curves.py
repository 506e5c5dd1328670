"""
Two plots of docs/results.md: quality against triangles, and against seconds.

    .venv/bin/python benchmarks/curves.py --asset ../shared/assets/skull/skull.obj

Both by the project's own `evaluate` (path traced, held-out views). The runs are kept in --out (out/curves).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib

import mi_simplify as ms

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asset", required=True)
    parser.add_argument("--triangles", type=int, nargs="+", default=[300, 1000, 3000, 10_000])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "curves")
    parser.add_argument("--picture", type=Path, default=ROOT / "docs" / "images" / "curves.png")
    parser.add_argument("--set", nargs="*", default=[], help="settings for all runs, as on the command line")
    args = parser.parse_args()
    ms.ensure_variant()
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.6), constrained_layout=True)
    rows = {}
    for count in args.triangles:
        folder = args.out / str(count)
        if not (folder / "metrics.json").exists():
            overrides = [f"asset={args.asset}", f"initial.triangles={count}", "evaluation.every=10", *args.set]
            ms.run_job(ms.load_config(overrides=overrides), folder, overwrite=True)
        rows[count] = json.loads((folder / "metrics.json").read_text())["candidates"]
        steps = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
        seen = [(row["seconds"], row["psnr"]) for row in steps if row.get("psnr")]
        right.plot(*zip(*seen, strict=True), label=f"{count:,}")
    for axis, key, label in ((left, "psnr", "PSNR [dB]"), (middle, "silhouette_error", "silhouette error")):
        for name, style in (("first guess", "o--"), ("result", "o-")):
            axis.plot(args.triangles, [rows[count][name][key] for count in args.triangles], style, label=name)
        axis.set(xscale="log", xlabel="triangles", ylabel=label)
        axis.legend()
    middle.set(yscale="log")
    right.set(xlabel="seconds of fitting", ylabel="PSNR on held-out views [dB]")
    right.legend()
    figure.savefig(args.picture, dpi=110)
    print(args.picture)


if __name__ == "__main__":
    main()
