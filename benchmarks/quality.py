"""
Results beside the baselines, end to end, as an independent program judges the exported files.

    .venv/bin/python benchmarks/quality.py --assets ../shared/assets --judge ../shared/tools/judge.py

Every case is run once and kept in --out (out/quality); those that are there already are not run again, unless named
by --only. The table and the pictures of docs/results.md are written from all that is there.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import mi_simplify as ms

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- figures: benchmarks/quality.py -->", "<!-- end of figures -->"
FIGURES = ("psnr", "flip", "silhouette_error")


@dataclass(frozen=True)
class Case:
    """
    An asset, a budget, and the figures to reach: PSNR [dB] at least, FLIP and silhouette error at most.
    """

    name: str
    asset: str
    triangles: int
    targets: tuple[float | None, float | None, float | None] = (None, None, None)
    settings: list[str] = field(default_factory=list)
    paper: bool = False
    """Measured as in the paper: random views and lights, direct light without shadows."""


SHAPE = ["latent.optimize=[vertices,normal]"]
SPHERE = ["initial.kind=sphere"]
CASES = [
    Case("skull, 1,000", "skull/skull.obj", 1000, (34.4, 0.0165, 0.0076)),
    Case("skull, 3,000", "skull/skull.obj", 3000, (41.8, 0.0078, 0.0031)),
    Case("scorpion, 3,000", "scorpion/scorpion.obj", 3000, (37.0, 0.0118, 0.0180)),
    Case("lion statue, 3,000", "lion_statue/lionstatue.obj", 3000, (37.8, 0.0115, 0.0092)),
    Case("spot, 1,000", "spot/spot.obj", 1000, (36.7, 0.0135, 0.0080)),
    Case("spot, 500", "spot/spot.obj", 500, (33.4, 0.0192, None)),
    Case("bishop, 1,500", "bishop/bishop.glb", 1500, (38.0, 0.0100, 0.0090)),
    Case("milk truck, 1,500", "cesium_milk_truck/CesiumMilkTruck.glb", 1500),
    Case("bishop, 500", "bishop/bishop.glb", 500),
    Case("milk truck, 700", "cesium_milk_truck/CesiumMilkTruck.glb", 700),
    Case("skull from a sphere, 3,000", "skull/skull.obj", 3000, (25.0, 0.051, None), [*SPHERE, *SHAPE], paper=True),
    Case("skull reduced, 9,000", "skull/skull.obj", 9000, settings=SHAPE, paper=True),
    Case("spot from a sphere, 3,000", "spot/spot.obj", 3000, (None, None, 0.03), SPHERE),
]


def run(case: Case, args: argparse.Namespace, folder: Path) -> None:
    """
    Fit a case, export its first guess and quadrics with the same bake, and have all three judged.
    """
    asset = args.assets / case.asset
    overrides = [f"asset={asset}", f"initial.triangles={case.triangles}", "export.formats=glb", *case.settings]
    start = time.perf_counter()
    result = ms.run_job(ms.load_config(overrides=[*overrides, *args.set]), folder, overwrite=True)
    seconds = time.perf_counter() - start
    candidates = {"quadrics, baked": quadrics(asset, case.triangles), "first guess": result.guess}
    if case.paper:
        figures = as_in_the_paper(ms.load_asset(asset), {**candidates, "result": result.model}, folder / "judge.png")
    else:
        figures = judged(args.judge, asset, candidates, folder)
    stages = result.figures["run"]["seconds"]
    record = {"case": case.name, "seconds": seconds, "fit_seconds": stages["fit"], "figures": figures}
    (folder / "judged.json").write_text(json.dumps(record, indent=1))


def judged(judge: Path, asset: Path, candidates: dict[str, ms.Model], folder: Path) -> dict[str, dict]:
    """
    What the outside program says of candidates and of the folder's ``model.glb``.
    """
    for name, model in candidates.items():
        ms.export_model(model, folder / name, formats=("glb",))
    paths = [folder / name / "model.glb" for name in candidates] + [folder / "model.glb"]
    command = [sys.executable, judge, asset, *paths, "--png", folder / "judge.png"]
    rows = subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True).stdout.splitlines()
    rows = [json.loads(row) for row in rows if row.startswith("{")]
    return dict(zip([*candidates, "result"], rows, strict=True))


def as_in_the_paper(asset: ms.Asset, models: dict[str, ms.Model], picture: Path) -> dict[str, dict]:
    """
    Figures over 16 random views of 512² with the fit's own light and framing, which no fit has seen; black background.
    """
    from PIL import Image

    from mi_simplify.judging.metrics import compare
    from mi_simplify.judging.pictures import displayed
    from mi_simplify.scenes.views import goniometer

    frame = ms.Frame.around(asset.bounds)
    views = goniometer(16, np.random.default_rng(20_26), width=512, height=512, irradiance=np.pi)
    assets = [asset, *(model.as_asset() for model in models.values())]
    images = [ms.make_reference(frame.normalised(a), transport="direct", spp=64).render(views) for a in assets]
    sheet = np.concatenate([np.concatenate(list(displayed(image[:4])), 1) for image in images])
    Image.fromarray(sheet).resize((sheet.shape[1] // 2, sheet.shape[0] // 2)).save(picture)
    return {name: compare(images[0], image) for name, image in zip(models, images[1:], strict=True)}


def quadrics(path: Path, triangles: int) -> ms.Model:
    """
    fast-simplification's mesh with our baker's textures: what a user can have for free.
    """
    from mi_simplify.initial.quadrics import fast_quadrics
    from mi_simplify.model.asset import Asset, Instance, Part

    asset = ms.load_asset(path)
    positions, faces, _ = fast_quadrics(asset, triangles)
    low = Asset((Part(positions, faces),), (Instance(0),))
    return ms.first_guess(asset, mesh=low, repair=False)[0]


def slug(name: str) -> str:
    return name.replace(",", "").replace(" ", "-")


def write_page(records: dict[str, dict], page: Path) -> None:
    """
    The table, and a picture for every case.
    """
    lines = [
        "| case | asked for | quadrics, baked | first guess | result | over the former | over the latter | s |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for case in CASES:
        if case.name not in records:
            continue
        record = records[case.name]
        rows = record["figures"]
        cells = [
            displayed([rows[name][key] for key in FIGURES]) for name in ("quadrics, baked", "first guess", "result")
        ]
        lines.append(
            f"| {case.name} | {displayed(case.targets)} | {cells[0]} | {cells[1]} | **{cells[2]}** "
            f"| {gain(rows, 'quadrics, baked')} | {gain(rows, 'first guess')} | {record['seconds']:.0f} |"
        )
    for case in CASES:
        if case.name in records:
            lines += ["", f"## {case.name} triangles", "", f"![{case.name}](images/results-{slug(case.name)}.jpg)"]
    before, _, rest = page.read_text().partition(BEGIN)
    page.write_text(before + "\n".join([BEGIN, "", *lines, "", END]) + rest.partition(END)[2])


def gain(rows: dict[str, dict], name: str) -> str:
    """
    What the result has over a candidate: dB, and percent of FLIP and silhouette error.
    """
    before, result = (np.array([rows[key][figure] for figure in FIGURES]) for key in (name, "result"))
    return ", ".join(
        [f"{result[0] - before[0]:+.1f} dB", *(f"{x:+.0f} %" for x in 100 * (result[1:] / before[1:] - 1))]
    )


def displayed(row) -> str:
    return " / ".join("–" if x is None else f"{x:.1f}" if x > 1 else f"{x:.4f}".lstrip("0") for x in row)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--judge", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "quality")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs", help="whose results.md and images are written")
    parser.add_argument("--only", nargs="*", default=[], help="cases to run, again if need be")
    parser.add_argument("--set", nargs="*", default=[], help="settings for all cases, as on the command line")
    args = parser.parse_args()
    ms.ensure_variant()
    from PIL import Image

    records = {}
    for case in CASES:
        folder = args.out / slug(case.name)
        named = case.name in args.only or slug(case.name) in args.only
        if named or not (args.only or (folder / "judged.json").exists()):
            print(f"{case.name} …", flush=True)
            shutil.rmtree(folder, ignore_errors=True)
            run(case, args, folder)
        if (folder / "judged.json").exists():
            records[case.name] = json.loads((folder / "judged.json").read_text())
            for name, row in records[case.name]["figures"].items():
                print(f"  {name:16} {displayed([row[key] for key in FIGURES])}")
            picture = Image.open(folder / "judge.png")
            picture.save(args.docs / "images" / f"results-{slug(case.name)}.jpg", quality=80)
    write_page(records, args.docs / "results.md")


if __name__ == "__main__":
    main()
