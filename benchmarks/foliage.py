"""
Plants on cards: against what else makes them as small, path traced under light that no fit has seen.

    python benchmarks/foliage.py --environment sky.hdr -o out/foliage  # both plants: fitted, then judged
    python benchmarks/foliage.py --plant sample:shrub --triangles 9600 --only fit -o out/foliage

Candidates of equal triangles: the fitted cards and their first guess, quadric decimation with colours carried over, and
stochastic simplification (Cook et al. 2007). Images of 512² are averaged to 128² and 64², which is what a box filter
sees there with more samples. Every picture is kept, so that an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

#: Budgets of the embedded plants: 0.8 % and 0.4 % of their triangles.
PLANTS = {"sample:shrub": 9600, "sample:fern": 6600}
SIDES = (512, 128, 64)


def fitted(plant: str, triangles: int, folder: Path, settings: list[str]) -> Path:
    """The result's file; fits it where it is not there."""
    from mi_simplify.config import load_config
    from mi_simplify.display import Lines
    from mi_simplify.jobs.job import run_job

    model = folder / "model.glb"
    if not model.is_file():
        initial = {"kind": "cards", "triangles": triangles}
        config = load_config(overrides=[{"asset": plant, "initial": initial}, *settings])
        result = run_job(config, folder, Lines(lambda line: print(line, flush=True)), overwrite=True)
        print(result.summary())
    return model


def candidate(kind: str, plant: str, triangles: int, folder: Path, settings: list[str]):
    """One of the assets that are compared; in the units of the plant."""
    from mi_simplify.config import load_config
    from mi_simplify.formats.load import load_asset
    from mi_simplify.initial.quadrics import quadrics_only
    from mi_simplify.initial.stochastic import stochastic
    from mi_simplify.subjects import open_asset, open_subject

    if kind == "original":
        return open_asset(plant)
    if kind == "cards":
        return load_asset(fitted(plant, triangles, folder, settings))
    if kind == "first guess":
        initial = {"kind": "cards", "triangles": triangles}
        subject = open_subject(load_config(overrides=[{"asset": plant, "initial": initial}, *settings]))
        return subject.frame.restored(subject.guess()[0]).as_asset()
    if kind == "stochastic":
        return stochastic(open_asset(plant), triangles)
    return quadrics_only(open_asset(plant), triangles)[0].as_asset()


def pictures(asset, bounds: np.ndarray, environment: str | None, n_views: int, spp: int) -> np.ndarray:
    """Path traced images, shape (B, 512, 512, 4): an environment alone, or the judge's point lights and sky."""
    from mi_simplify.scenes.references.path_traced import make_reference
    from mi_simplify.scenes.views import Views, held_out_views

    views = held_out_views(bounds, n_views, SIDES[0], 5)
    if environment is None:
        return make_reference(asset, transport="baked", spp=spp, sky=0.1).render(views, seed=1)
    arrays = views.arrays()
    dark = Views.from_arrays(arrays | {"light_intensity": 0 * arrays["light_intensity"]}, views.width, views.height)
    return make_reference(asset, transport="baked", spp=spp, environment=environment).render(dark, seed=1)


def averaged(images: np.ndarray, side: int) -> np.ndarray:
    """Images of fewer pixels by averaging squares of them."""
    n, k = len(images), images.shape[1] // side
    return images.reshape(n, side, k, side, k, 4).mean((2, 4))


def figures(target: np.ndarray, images: np.ndarray) -> dict:
    """By side: PSNR [dB], FLIP and by how much the coverage of all views is off."""
    from mi_simplify.judging.metrics import flip, psnr

    out = {}
    for side in SIDES:
        a, b = averaged(target, side), averaged(images, side)
        out[side] = {"psnr": float(psnr(a, b).mean()), "flip": float(flip(a, b).mean())}
    out["coverage"] = float(images[..., 3].sum() / target[..., 3].sum() - 1)
    return out


def sheet(rows: dict[str, np.ndarray], path: Path, view: int = 0) -> None:
    """One view of every candidate side by side, cut around the original."""
    from PIL import Image

    from mi_simplify.judging.metrics import tonemap

    covered = rows["original"][view, ..., 3] > 0.02
    y, x = (np.flatnonzero(covered.any(k)) for k in (1, 0))
    margin = len(covered) // 50
    box = [slice(max(k[0] - margin, 0), k[-1] + margin) for k in (y, x)]
    cut = [tonemap(im[view])[box[0], box[1]] for im in rows.values()]
    image = Image.fromarray((np.concatenate(cut, 1) * 255).astype(np.uint8))
    image.thumbnail((1600, 600))
    image.save(path, quality=85)


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--plant", help="one plant instead of both embedded ones: a model file or sample:NAME")
    p.add_argument("--triangles", type=int, help="its budget")
    p.add_argument("--environment", help="HDR file that lights the comparison; without it point lights and a dim sky")
    p.add_argument("--only", help="make one candidate's pictures and stop: fit, original, cards, first guess, …")
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the fit")
    p.add_argument("--views", type=int, default=4)
    p.add_argument("--spp", type=int, default=64)
    p.add_argument("-o", "--out", default="out/foliage")
    a = p.parse_args()
    from mi_simplify.machine.runtime import ensure_variant

    ensure_variant()
    plants = {a.plant: a.triangles} if a.plant else PLANTS
    table = {}
    for plant, triangles in plants.items():
        name = plant.rpartition(":")[2] if ":" in plant else Path(plant).stem
        folder = Path(a.out, name)
        if a.only == "fit":
            fitted(plant, triangles, folder, a.set)
            continue
        images, counts = {}, {}
        for kind in ("original", "cards", "first guess", "quadrics", "stochastic"):
            if a.only not in (None, kind):
                continue
            cache = Path(a.out, f"{name}-{kind.replace(' ', '-')}.npz")
            if not cache.is_file():
                asset = candidate(kind, plant, triangles, folder, a.set)
                bounds = candidate("original", plant, triangles, folder, a.set).bounds
                shown = pictures(asset, bounds, a.environment, a.views, a.spp)
                cache.parent.mkdir(parents=True, exist_ok=True)
                np.savez_compressed(cache, images=shown, triangles=asset.n_triangles)
                print(f"{name}: {kind} rendered", flush=True)
            with np.load(cache) as data:
                images[kind], counts[kind] = data["images"], int(data["triangles"])
        if a.only:
            continue
        sheet(images, Path(a.out, f"{name}.jpg"))
        table[name] = {
            kind: {"triangles": counts[kind], **figures(images["original"], x)} for kind, x in images.items()
        }
        for kind, row in table[name].items():
            sides = "  ".join(f"{s}²: {row[s]['psnr']:5.2f} dB {row[s]['flip']:.4f}" for s in SIDES)
            print(f"{name:8} {kind:12} {row['triangles']:8}  {sides}  coverage {100 * row['coverage']:+.1f} %")
    if table:
        Path(a.out, "figures.json").write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()
