"""
From any renderer, from any representation: an implicit surface, images, another renderer, effects baked on purpose.

    .venv/bin/python benchmarks/representations.py creature-isosurface creature-sphere
    .venv/bin/python benchmarks/representations.py images --asset sample:relic:20k --environment SKY.exr
    .venv/bin/python benchmarks/representations.py vtk baked --asset ASSET.obj --environment SKY.exr

Prints one row of a table for each case (first guess, result), writes the run into OUT/CASE and a strip of pictures
(reference, first guess, result, of two held-out views) beside it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

import mi_simplify as ms

ROOT = Path(__file__).resolve().parents[1]
CASES = ("creature-isosurface", "creature-sphere", "creature-shadows", "images", "images-unknown", "vtk", "baked")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", choices=CASES)
    parser.add_argument("--asset", default="sample:relic:20k", help="of the cases that have none of their own")
    parser.add_argument("--environment", help="EXR or HDR, for 'baked' and 'images-unknown'")
    parser.add_argument("--triangles", type=int, default=3000)
    parser.add_argument("--photographs", type=int, default=100, help="images to fit, and a fifth as many to judge by")
    parser.add_argument("--side", type=int, default=256, help="of these [px]")
    parser.add_argument("--views", type=int, default=8, help="held-out views")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "representations")
    parser.add_argument("--set", nargs="*", default=[], help="settings for all, as on the command line")
    args = parser.parse_args()
    ms.ensure_variant()
    print("| case | first guess | result | light found | fit [s] |\n|---|---|---|---|---|")
    for case in args.cases:
        run(case, args)


def run(case: str, args: argparse.Namespace) -> None:
    """One case: its settings, the job, a row, and a strip."""
    folder = args.out / (case if case.startswith("creature") else f"{case}-{Path(args.asset.split(':')[-1]).stem}")
    settings = settings_of(case, args, folder)
    config = ms.load_config(overrides=["export.formats=glb", f"evaluation.views={args.views}", *settings, *args.set])
    result = ms.run_job(config, folder, overwrite=True)
    rows = [result.figures["candidates"][name] for name in ("first guess", "result")]
    cells = [f"{row['psnr']:.2f} / {row['flip']:.4f} / {row['silhouette_error']:.4f}" for row in rows]
    light = result.model.ambient
    found = "–" if light is None else ", ".join(f"{x:.3f}" for x in light[0] * (1 if len(light) == 1 else 0.2821))
    seconds = result.figures["run"]["seconds"]["fit"]
    print(f"| {case} {args.asset if 'creature' not in case else ''} | {' | '.join(cells)} | {found} | {seconds:.0f} |")
    strip(folder)


def settings_of(case: str, args: argparse.Namespace, folder: Path) -> list:
    """The configuration of a case."""
    if case.startswith("creature"):
        settings = ["asset=sample:creature", "initial.triangles=12000", "reference.spp=4"]
        if case == "creature-sphere":
            return [*settings, "initial.kind=sphere"]
        if case == "creature-shadows":
            return [*settings, "reference.transport=baked", "views.light.position=[2.0, 3.0, 1.5]"]
        return settings
    if case.startswith("images"):
        path = photographs(args, folder.with_name(folder.name + "-set"), case)
        held_out = path.parent / "held_out" / path.name
        return [f"asset={path}", f"images.held_out={held_out}", f"initial.triangles={args.triangles}"]
    settings = [f"asset={args.asset}", f"initial.triangles={args.triangles}"]
    if case == "vtk":
        return [*settings, "reference.renderer=vtk"]
    baked = {"transport": "baked", "environment": args.environment}
    static = {"views": {"light": {"position": [2.0, 3.0, 1.5]}}, "evaluation": {"light": "fitted"}}
    return [*settings, {"reference": baked, **static}, "optimizer.rates.base_color=0.01"]


def photographs(args: argparse.Namespace, folder: Path, case: str) -> Path:
    """Images to fit and to judge by, by Mitsuba: lit by a light each, or path traced in a static one."""
    from mi_simplify.formats.captured.write import write_captured
    from mi_simplify.scenes.views import goniometer

    model = ms.open_asset(args.asset)
    frame = ms.Frame.around(model.bounds)
    known = case == "images"
    target = frame.normalised(model)
    reference = ms.make_reference(target, transport="direct", spp=32)
    if not known:
        reference = ms.make_reference(target, transport="baked", spp=64, environment=args.environment)
    for name, n, seed in ((".", args.photographs, 1), ("held_out", args.photographs // 5, 2)):
        views = goniometer(n, np.random.default_rng(seed), width=args.side, height=args.side, irradiance=2.5)
        views = views if known else views.lit_by(0.0)
        light = "point" if known else "environment"
        path = write_captured(folder / name, views.arrays(), reference.render(views, seed), format="exr", light=light)
    return folder / path.name


def strip(folder: Path) -> None:
    """Reference, first guess and result of two held-out views as one JPEG."""
    from mi_simplify.judging.comparison import load_comparison
    from mi_simplify.judging.pictures import displayed

    comparison = load_comparison(folder)
    images = [comparison.reference, comparison.candidates["first guess"], comparison.candidates["result"]]
    rows = [np.concatenate([displayed(x[k : k + 1])[0] for x in images], axis=1) for k in (0, 1)]
    Image.fromarray(np.concatenate(rows, axis=1)).save(folder.with_suffix(".jpg"), quality=85)


if __name__ == "__main__":
    main()
