"""
What the three transports do to the materials and to the look: one asset fitted against each.

    .venv/bin/python benchmarks/transports.py --asset sample:relic --triangles 3000

Base colour error: fitted against true base colour, which is baked onto the fitted mesh; mean over covered texels, per
channel, linear. The look is judged by `evaluate`: path traced under light that no fit saw.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import mi_simplify as ms

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asset", default="sample:relic")
    parser.add_argument("--triangles", type=int, default=3000)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "transports")
    parser.add_argument("--set", nargs="*", default=[], help="settings for all three, as on the command line")
    args = parser.parse_args()
    ms.ensure_variant()
    asset = ms.open_asset(args.asset)
    print("| transport | PSNR [dB] | FLIP | silhouette error | base colour error R, G, B | fit [s] |")
    print("|---|---|---|---|---|---|")
    for transport in ("direct", "baked", "matched"):
        overrides = [f"asset={args.asset}", f"initial.triangles={args.triangles}", "export.formats=glb", *args.set]
        config = ms.load_config(overrides=[*overrides, f"reference.transport={transport}"])
        result = ms.run_job(config, args.out / transport, overwrite=True)
        truth = ms.bake(asset, result.model.mesh, size=len(result.model.base_color))
        error = np.abs(result.model.base_color - truth.base_color)[truth.covered].mean(0)
        if transport == "direct":
            show("first guess", result.figures["candidates"]["first guess"], "", "")
        colours = ", ".join(f"{x:.4f}" for x in error[:3])
        seconds = result.figures["run"]["seconds"]["fit"]
        show(transport, result.figures["candidates"]["result"], colours, f"{seconds:.0f}")


def show(name: str, figures: dict, colours: str, seconds: str) -> None:
    cells = [f"{figures['psnr']:.2f}", f"{figures['flip']:.4f}", f"{figures['silhouette_error']:.4f}", colours, seconds]
    print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
