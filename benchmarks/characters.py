"""
Characters over frames that no fit has seen: fitted over the animation, in the bind pose alone, from a sphere, and what
a user would take instead.

    .venv/bin/python benchmarks/characters.py ASSET --triangles 1000 400 --out out/characters [--set KEY=VALUE ...]

Every case is run once and kept in --out; what is there already is not run again. The exported GLB is what is judged.
The table is printed and kept in --out as table.md, and one picture for each budget.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

import mi_simplify as ms
from mi_simplify.machine.runtime import ensure_variant

CASES = {
    "fitted over the animation": ["optimizer.steps=600"],
    "fitted in the bind pose alone": ["optimizer.steps=600", "animation.bind_pose_only=true"],
    "from a sphere, over the animation": ["initial.kind=sphere", "optimizer.steps=1000"],
}
BASELINE, GUESS = "decimated bind pose, weights carried over", "first guess"


def main() -> None:
    """Run what is missing, then write the table and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("asset")
    parser.add_argument("--triangles", type=int, nargs="+", default=[1000, 400])
    parser.add_argument("--out", type=Path, default=Path("out/characters"))
    parser.add_argument("--only", nargs="+", default=list(CASES), choices=list(CASES), metavar="CASE")
    parser.add_argument("--set", dest="settings", nargs="*", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    ensure_variant(None)
    for triangles in options.triangles:
        folder = options.out / str(triangles)
        for case in options.only:
            if not (folder / f"{case}.npz").exists():
                run(options.asset, triangles, case, options.settings, folder)
        picture(folder)
    text = table(options.out, options.triangles)
    (options.out / "table.md").write_text(text)
    print(text)


def run(asset: str, triangles: int, case: str, settings: list[str], folder: Path) -> None:
    """One fit, its files, and its verdict on the frames that were held out."""
    from mi_simplify.export import as_exported, export_model
    from mi_simplify.fitting import fit
    from mi_simplify.judging.evaluate import Judging
    from mi_simplify.judging.self_check import self_check
    from mi_simplify.subjects import open_subject

    overrides: list = [{"asset": asset}, f"initial.triangles={triangles}", "initial.atlas_size=1024"]
    config = ms.load_config(None, [*overrides, *CASES[case], *settings])
    subject = open_subject(config)
    config = subject.config
    guess, _ = subject.guess()
    begin = time.perf_counter()
    fitted = fit(guess, subject.reference(), config).model
    seconds = time.perf_counter() - begin
    files = export_model(subject.frame.restored(fitted), folder / case, formats=("glb", "usd"))
    written = {name: ms.load_asset(path) for name, path in files.items()}
    checks = {
        n: self_check(fitted, subject.frame.normalised(a), form=config.latent.shading) for n, a in written.items()
    }
    candidates = {case: written["glb"]}
    if case == next(iter(CASES)):
        baseline = subject.frame.restored(subject.baseline(guess.n_triangles))
        candidates = {BASELINE: as_exported(baseline), GUESS: as_exported(subject.frame.restored(guess)), **candidates}
        candidates["unpruned"] = subject.frame.restored(fitted).as_asset()
    judged = config.evaluation
    comparison = subject.judge(candidates, Judging(judged.views, judged.resolution, judged.spp))
    images = {"reference": comparison.reference, **comparison.candidates}
    rows = {n: r | {"seconds": seconds, "checks": checks} for n, r in comparison.figures["candidates"].items()}
    facts = {
        "rows": rows,
        "frames": comparison.figures["settings"]["frames"],
        "settings": config.model_dump(mode="json"),
    }
    np.savez_compressed(
        folder / f"{case}.npz", facts=json.dumps(facts), **{k: v.astype(np.float16) for k, v in images.items()}
    )


def load(folder: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """All rows and images of a budget."""
    rows: dict = {}
    images: dict[str, np.ndarray] = {}
    for case in CASES:
        if (folder / f"{case}.npz").exists():
            with np.load(folder / f"{case}.npz") as archive:
                facts = json.loads(str(archive["facts"]))
                rows |= facts["rows"]
                images |= {name: archive[name] for name in archive.files if name != "facts"}
                images["frames"] = np.array(facts["frames"])
    return rows, images


def table(out: Path, budgets: list[int]) -> str:
    """Markdown: one row for each candidate of each budget."""
    lines = [
        "| triangles | candidate | PSNR | FLIP | silhouette error | worst frame | file against fit | seconds |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for budget in budgets:
        for name, row in load(out / str(budget))[0].items():
            made = name in CASES
            files = " / ".join(f"{k} {v:.1f}" for k, v in row["checks"].items()) if made else ""
            lines.append(
                f"| {budget} | {name} | {row['psnr']:.2f} | {row['flip']:.4f} | {row['silhouette_error']:.4f} | "
                f"{row['worst_frame']:.2f} | {files} | {row['seconds'] if made else 0:.0f} |"
            )
    return "\n".join(lines) + "\n"


def picture(folder: Path, n_frames: int = 6) -> None:
    """A contact sheet: a column for each of some frames, a row for the reference and for each candidate."""
    from PIL import Image

    from mi_simplify.judging.pictures import displayed

    rows, images = load(folder)
    if not images:
        return
    _, first = np.unique(images["frames"], return_index=True)
    chosen = first[np.linspace(0, len(first) - 1, min(n_frames, len(first))).astype(int)]
    names = ["reference", *(name for name in rows if name not in (GUESS, "unpruned"))]
    sheet = np.concatenate(
        [np.concatenate(list(displayed(images[name][chosen].astype(np.float32))), 1) for name in names]
    )
    Image.fromarray(np.uint8(sheet)).save(folder / "frames.jpg", quality=80)
    print(folder / "frames.jpg", "rows:", ", ".join(names))


if __name__ == "__main__":
    main()
