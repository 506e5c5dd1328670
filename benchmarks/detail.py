"""
Prefiltering, mip levels, displacement and chains of levels, measured; each table is a command of its own.

    python benchmarks/detail.py prefilter ASSET --size 64 --metal 0.4   # one sample a pixel against many; flicker
    python benchmarks/detail.py mips ASSET                              # derived against custom at 32², 64², 128²
    python benchmarks/detail.py displacement ASSET                      # a base of 1,000 triangles, split to 64,000
    python benchmarks/detail.py tessellations ASSET                     # one model for 4, 16 and 64 times the triangles
    python benchmarks/detail.py chain ASSET                             # mi-simplify lod, as lod.json has it

Without path tracing: direct light, images of the fit's kind from views that it never saw. Displacement alone is judged
as `evaluate` does.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import mi_simplify as ms
from mi_simplify.config import load_config

ROOT = Path(__file__).resolve().parents[1]
GOLD = (1.0, 0.77, 0.34)


def opened(settings: list[str], metal: float | None):
    """The subject of a configuration; with ``metal`` all of it is gold of this roughness."""
    from mi_simplify.subjects import open_subject

    subject = open_subject(load_config(None, settings))
    if metal is not None:
        colour, specular = np.float32([[[*GOLD, 1.0]]]), np.float32([[[0, metal, 1]]])
        gold = [replace(p, material=replace(p.material, base_color=colour, specular=specular, normal=None))
                for p in subject.geometry.parts]  # fmt: skip
        subject.geometry = replace(subject.geometry, parts=tuple(gold))
    return subject


def fitted(settings: list[str], metal: float | None = None):
    """First guess and fitted model in the normalised frame, and the seconds of the fit."""
    from mi_simplify.fitting import fit

    subject = opened(settings, metal)
    guess, _ = subject.guess()
    start = time.perf_counter()
    return guess, fit(guess, subject.reference(), subject.config).model, time.perf_counter() - start


class Judge:
    """Views of one size, the asset in them without aliasing, and figures of anything beside it."""

    def __init__(self, subject, views, spp: int = 256):
        from mi_simplify.scenes.references.path_traced import make_reference

        self.views, self.asset = views, subject.frame.normalised(subject.geometry)
        self.truth = make_reference(self.asset, spp=spp).render(views, 5)

    def once(self, anywhere: bool = False) -> np.ndarray:
        """The asset with one sample in the middle of each pixel, or anywhere in it."""
        from mi_simplify.scenes.references.mitsuba import MitsubaReference
        from mi_simplify.scenes.references.path_traced import make_reference

        reference = make_reference(self.asset, spp=1)
        assert isinstance(reference, MitsubaReference)
        reference.sampler = {"type": "stratified", "jitter": anywhere}
        return reference.render(self.views, 6)

    def fine(self, k: int, integrator: dict, times: int = 8) -> np.ndarray:
        """What an integrator finds at ``times`` by ``times`` places of every pixel of view k, shape (H, t, W, t, C)."""
        from mi_simplify.scenes.references.mitsuba import MitsubaReference
        from mi_simplify.scenes.references.path_traced import make_reference

        reference = make_reference(self.asset, spp=1)
        assert isinstance(reference, MitsubaReference)
        reference.integrator, reference.sampler = integrator, {"type": "stratified", "jitter": False}
        height, width = self.views.height, self.views.width
        large = self.views.take(np.array([k])).resized(width * times, height * times)
        return reference.render(large)[0].reshape(height, times, width, times, -1)

    def best(self) -> np.ndarray:
        """
        What one sample a pixel can show at best: the truth but for pixels in which an outline lies, of the asset or of
        a part before another; those show what lies in their middle.
        """
        out, views = self.once(), self.views
        for k in range(len(views)):
            depth = self.fine(k, {"type": "depth"})[..., 0]
            step = 2 * 3.5 * np.tan(np.radians(views.fov / 2))[k] / (views.width * depth.shape[1])
            jumps = [np.abs(np.diff(depth, axis=axis)).max(axis=(1, 3)) for axis in (1, 3)]
            whole = np.maximum(*jumps) < 6 * step
            out[k][whole] = self.truth[k][whole]
        return out

    def lobe(self, roughness: float, share: float = 0.25) -> np.ndarray:
        """
        The same, but that pixels without an outline show one lobe of gold, as those of a texture do: about the mean of
        the pixel's normals, and wider by a share of their spread; a quarter is best.
        """
        import mitsuba as mi

        from mi_simplify.bsdfs import microfacet

        out, at = self.best(), self.views.arrays()
        for k in range(len(out)):
            inside = (out[k] == self.truth[k]).all(axis=2) & (out[k, ..., 3] == 1)
            found = self.fine(k, {"type": "aov", "aovs": "p:position,cover:depth"})[..., :3].mean(axis=(1, 3))[inside]
            n = self.fine(k, {"type": "aov", "aovs": "n:sh_normal,cover:depth"})[..., :3].mean(axis=(1, 3))[inside]
            r = np.linalg.norm(n, axis=1, keepdims=True)
            wi, to_light = at["origin"][k] - found, at["light_position"][k] - found
            far, d = (np.linalg.norm(x, axis=1, keepdims=True) for x in (wi, to_light))
            n, wi, wo = (mi.Vector3f(x.T) for x in (n / r, wi / far, to_light / d))
            wider = mi.Float((np.clip(roughness**4 + share * 2 * (1 - r) / r, 0, 1) ** 0.25).ravel())
            gold = mi.Color3f(GOLD), mi.Float(0), wider, mi.Float(1)
            value = microfacet.evaluate(*gold, microfacet.face_viewer(n, wi), wi, wo).numpy().T
            out[k, inside, :3] = value * at["light_intensity"][k] / d**2
        return out

    def strict(self, model, mips: str | None = None) -> np.ndarray:
        """A model with one sample in the middle of each pixel."""
        from mi_simplify.judging.screen import Screen

        return Screen(model, shade="centre", mips=mips).images(self.views)

    def figures(self, images: np.ndarray) -> tuple[float, float]:
        """PSNR [dB] and FLIP."""
        from mi_simplify.judging.metrics import flip, psnr

        return float(psnr(self.truth, images).mean()), float(flip(self.truth, images).mean())

    def flicker(self, images: np.ndarray) -> float:
        """Mean absolute change from frame to frame, less that of the asset without aliasing, pixel by pixel [1/255]."""
        from mi_simplify.judging.metrics import tonemap

        return float(np.abs(np.diff(tonemap(images) - tonemap(self.truth), axis=0)).mean() * 255)


def row(*cells) -> None:
    shown = [c if isinstance(c, str) else f"{c:.4f}" if abs(c) < 1 else f"{c:.2f}" for c in cells]
    print("| " + " | ".join(shown) + " |", flush=True)


def prefilter(args) -> None:
    """One sample a pixel of the prefiltered model, of one fitted for large images, and of the asset itself."""
    from mi_simplify.scenes.views import goniometer, look_at

    size = args.size
    base = [f"asset={args.asset}", f"initial.triangles={args.triangles}", f"optimizer.steps={args.steps}", *args.set]
    subject = opened(base, args.metal)
    light = {"irradiance": 2.5, "width": size, "height": size}
    judge = Judge(subject, goniometer(args.views, np.random.default_rng(99), **light), min(256, 2**20 // size**2 * 4))
    angle = np.linspace(0, 0.5, args.path)[:, None]  # half a radian: a degree every other frame
    eye = 3.5 * np.concatenate([np.sin(angle), 0.3 + 0 * angle, np.cos(angle)], axis=1)
    path = Judge(subject, look_at(eye, [0, 0, 0], eye + [1.0, 1.5, 0.5], **light), 64)

    guess, model, seconds = fitted([*base, f"optimizer.target_resolution={size}"], args.metal)
    large = 512 if size < 512 else 64
    steps = f"optimizer.steps={args.others}"
    other = fitted([*base, f"optimizer.target_resolution={large}", steps], args.metal)[1]
    unfiltered = fitted([*base[:2], "optimizer.batch=2", steps], args.metal)[1]
    shown = {
        "the asset itself": (judge.once(), path.once()),
        "the asset, anywhere in the pixel": (judge.once(True), path.once(True)),
        "the best that shows outlines": (judge.best(), path.best()),
        **({} if args.metal is None else {"the best of one lobe": tuple(j.lobe(args.metal) for j in (judge, path))}),
        "fitted plainly, without mip levels": tuple(j.strict(unfiltered, "none") for j in (judge, path)),
        f"fitted for {large}²": (judge.strict(other), path.strict(other)),
        f"start for {size}²": (judge.strict(guess), path.strict(guess)),
        f"prefiltered for {size}²": (judge.strict(model), path.strict(model)),
    }
    print(f"\n{Path(args.asset).stem}, {size}², {args.triangles} triangles, {args.steps} steps, {seconds:.0f} s\n")
    print("| one sample a pixel | PSNR [dB] | FLIP | flicker [1/255] |\n|---|---|---|---|")
    for name, (images, frames) in shown.items():
        row(name, *judge.figures(images), path.flicker(frames))
    save(args, "prefilter", [judge.truth, *(images for images, _ in shown.values())])


def mips(args) -> None:
    """Derived against custom mip levels."""
    from mi_simplify.scenes.views import goniometer

    print("| size | derived PSNR [dB] | FLIP | custom PSNR [dB] | FLIP |\n|---|---|---|---|---|")
    for size in (32, 64, 128):
        base = [f"asset={args.asset}", f"initial.triangles={args.triangles}", f"optimizer.steps={args.steps}",
                f"optimizer.target_resolution={size}", "initial.atlas_size=512", *args.set]  # fmt: skip
        rng = np.random.default_rng(99)
        views = goniometer(args.views, rng, width=size, height=size, irradiance=2.5)
        judge, cells = Judge(opened(base, args.metal), views), []
        for kind in ("derived", "custom"):
            cells += judge.figures(judge.strict(fitted([*base, f"latent.mips={kind}"], args.metal)[1]))
        row(f"{size}²", *cells)


def displacement(args) -> None:
    """A displaced base mesh against normal maps alone, as `evaluate` judges."""
    from mi_simplify.judging.evaluate import Judging, compare_assets

    common = [f"asset={args.asset}", f"optimizer.steps={args.steps}", "initial.atlas_size=1024"]
    few = [*common, "initial.triangles=1000", *args.set]
    split = [*few, "initial.subdivisions=3"]
    shape = "latent.optimize=[vertices,displacement]"
    runs = {
        "normal map, 3,000 triangles": [*common, "initial.triangles=3000", *args.set],
        "normal map, 1,000 triangles": few,
        "displacement, 1,000 to 64,000": split,
        "displacement and normal map": split,
    }
    subject, candidates, seconds = opened(few, None), {}, {}
    for name, settings in runs.items():
        alone = name.startswith("displacement,")
        _, model, seconds[name] = fitted([*settings, shape] if alone else settings)
        if alone:
            model = replace(model, normal=np.broadcast_to(np.float32([0, 0, 1]), model.normal.shape).copy())
        candidates[name] = model.as_asset()
    target = subject.frame.normalised(subject.geometry)
    comparison = compare_assets(target, candidates, Judging(n_views=args.views, resolution=args.resolution, spp=32))
    print("| | triangles | PSNR [dB] | FLIP | silhouette error | fit [s] |\n|---|---|---|---|---|---|")
    for name, figures in comparison.figures["candidates"].items():
        numbers = (figures[key] for key in ("psnr", "flip", "silhouette_error"))
        row(name, str(figures["triangles"]), *numbers, f"{seconds[name]:.0f}")
    save(args, "displacement", [comparison.reference, *comparison.candidates.values()], 3)


def tessellations(args) -> None:
    """
    One displaced model for three tessellations at once, beside models that are fitted for one alone, in as many steps
    for each.
    """
    from mi_simplify.judging.evaluate import Judging, compare_assets
    from mi_simplify.model.model import tessellated

    common = [f"asset={args.asset}", "initial.triangles=1000", "initial.atlas_size=1024", *args.set]
    steps, tripled = (f"optimizer.steps={n * args.steps}" for n in (1, 3))
    together = fitted([*common, tripled, "initial.subdivisions=3", "initial.tessellations=[1,2,3]"])[1]
    subject, candidates = opened(common, None), {}
    for n in (1, 2, 3):
        alone = fitted([*common, steps, f"initial.subdivisions={n}"])[1]
        candidates[f"{4**n} times, alone"] = alone.as_asset()
        candidates[f"{4**n} times, with the others"] = tessellated(together, n).as_asset()
    target = subject.frame.normalised(subject.geometry)
    comparison = compare_assets(target, candidates, Judging(n_views=args.views, resolution=args.resolution, spp=32))
    print("| | triangles | PSNR [dB] | FLIP | silhouette error |\n|---|---|---|---|---|")
    for name, figures in comparison.figures["candidates"].items():
        row(name, str(figures["triangles"]), *(figures[key] for key in ("psnr", "flip", "silhouette_error")))
    save(args, "tessellations", [comparison.reference, *comparison.candidates.values()], 3)


def chain(args) -> None:
    """The levels of one asset."""
    from mi_simplify.jobs.chain import lod_job

    out = Path(args.out) / f"chain_{Path(args.asset).stem}"
    budgets = [{"triangles": int(n)} for n in args.budgets.split(",")]
    fixed = [f"asset={args.asset}", f"optimizer.steps={args.steps}", *args.set]
    made = lod_job(lambda keys: load_config(None, [*fixed, keys]), budgets, out, overwrite=True)
    print("| triangles | textures | file [kB] | below [px] | PSNR [dB] | FLIP | s |\n|---|---|---|---|---|---|---|")
    for level in made.levels:
        below = "any" if level.screen_size is None else f"{level.screen_size:.0f}"
        row(str(level.triangles), f"{level.texels}²", f"{level.bytes / 1024:.0f}", below, level.psnr, level.flip,
            f"{level.seconds:.0f}")  # fmt: skip
    print(f"\nin all {made.seconds:.0f} s")


def save(args, name: str, rows: list[np.ndarray], n: int = 6) -> None:
    """A picture: a row for each set of images, the first few views, enlarged to be seen."""
    from mi_simplify.judging.metrics import tonemap

    sheet = np.concatenate([np.concatenate(list(tonemap(x[:n])), axis=1) for x in rows], axis=0)
    times = max(1, 900 // sheet.shape[1])
    image = Image.fromarray((sheet * 255).astype(np.uint8))
    folder = Path(args.out)
    folder.mkdir(parents=True, exist_ok=True)
    image.resize((image.width * times, image.height * times), 0).save(folder / f"{name}_{Path(args.asset).stem}.png")


TABLES = {table.__name__: table for table in (prefilter, mips, displacement, tessellations, chain)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=list(TABLES))
    parser.add_argument("asset")
    parser.add_argument("--metal", type=float, metavar="ROUGHNESS", help="make all of it gold of this roughness")
    parser.add_argument("--size", type=int, default=64, help="of images, for prefilter [px]")
    parser.add_argument("--triangles", type=int, default=9000)
    parser.add_argument("--budgets", default="9000,3000,1000,300")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--others", type=int, default=100, help="steps of the models that prefilter compares with")
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--resolution", type=int, default=256, help="of the verdict on displacement [px]")
    parser.add_argument("--path", type=int, default=60, help="camera positions of the path")
    parser.add_argument("--out", default=ROOT / "out" / "detail")
    parser.add_argument("--set", nargs="*", default=[], help="settings, as on the command line")
    args = parser.parse_args()
    ms.ensure_variant()
    TABLES[args.table](args)


if __name__ == "__main__":
    main()
