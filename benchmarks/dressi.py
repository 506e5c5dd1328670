"""
The application of Dressi (Takimoto et al. 2022, supplement): fits in place, soft outlines, reactive steps, normal maps.

    python benchmarks/dressi.py main                 # 1 and 20 images, vertices and normal map, 1,000 steps
    python benchmarks/dressi.py bias                 # soft outlines' gradient beside direct_edge's, by radius
    python benchmarks/dressi.py reach                # how far off a start may be: edge, hard_soft, soft first
    python benchmarks/dressi.py sphere ASSET         # from a sphere: the usual recipe, and soft outlines first
    python benchmarks/dressi.py speed                # forward and backward, silhouettes or textures alone
    python benchmarks/dressi.py reactive ASSET       # a step of everything beside one of normals or colours alone
    python benchmarks/dressi.py normals ASSET        # normal maps from nothing

Each prints rows of the tables in docs/dressi.md, and writes its pictures and files into --out.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import mi_simplify as ms

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests")]

KHRONOS = """
require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(0)), {maxIssues: 0})
    .then(report => console.log(JSON.stringify(report.issues)))
"""


# Models ---------------------------------------------------------------------------------------------------------------


def opened(asset: str, side: int | None = None) -> ms.Model:
    """An asset of one material as it is, in the normalised frame; its textures ``side`` texels wide."""
    from mi_simplify.latent.file_model import file_model

    loaded = ms.open_asset(asset)
    model = file_model(ms.Frame.around(loaded.bounds).normalised(loaded), ["normal"], side or 512).model
    if model.cells is not None:
        sys.exit(f"{asset} has several materials; name an asset of one")
    plain = {f: getattr(model, f) for f in ("mesh", "base_color", "specular", "normal")}
    plain |= {name: shrunk(plain[name], side) for name in ("base_color", "specular", "normal")}
    plain["normal"] = plain["normal"] / np.linalg.norm(plain["normal"], axis=2, keepdims=True)
    return ms.Model(**plain, name=Path(asset).stem)


def shrunk(image: np.ndarray, side: int | None) -> np.ndarray:
    """Means of whole blocks of texels, or texels repeated where it has fewer."""
    if side is None or image.shape[0] == side:
        return image
    if image.shape[0] < side:
        return np.repeat(np.repeat(image, side // image.shape[0], 0), side // image.shape[1], 1)
    k = image.shape[0] // side
    return image.reshape(side, k, side, k, -1).mean((1, 3)).astype(np.float32)


def relief(side: int, seed: int = 0) -> np.ndarray:
    """A normal map of bumps on flat ground, shape (side, side, 3)."""
    y, x = np.meshgrid(*[(np.arange(side) + 0.5) / side] * 2, indexing="ij")
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4)
    height = np.sin(2 * np.pi * 6 * x + phase[0]) * np.sin(2 * np.pi * 5 * y + phase[1])
    height += 0.5 * np.sin(2 * np.pi * (9 * x + 4 * y) + phase[2])
    height = np.maximum(height, 0) ** 2 * 0.015
    down, right = np.gradient(height, 1 / side)
    out = np.stack([-right, down, np.ones_like(x)], 2)
    return (out / np.linalg.norm(out, axis=2, keepdims=True)).astype(np.float32)


def flat(normal: np.ndarray) -> np.ndarray:
    """A normal map of the same size that says nothing."""
    return np.broadcast_to(np.float32([0, 0, 1]), normal.shape).copy()


def moved(model: ms.Model, amount: float) -> ms.Model:
    """The model with a wave along its normals, of this height in halves of its size."""
    p = model.mesh.positions
    wave = np.sin(4 * p[:, 1]) + np.cos(3 * p[:, 0] + 2 * p[:, 2])
    from mi_simplify.model.topology import vertex_normals

    normals = vertex_normals(p, model.mesh.position_faces)
    return replace(model, mesh=replace(model.mesh, positions=p + amount * wave[:, None] * normals))


def written(model: ms.Model, path: Path) -> Path:
    """The model as a GLB file."""
    from mi_simplify.formats.gltf.write import write_glb

    path.parent.mkdir(parents=True, exist_ok=True)
    return write_glb(model, path)


# The commands ---------------------------------------------------------------------------------------------------------


def main_run(args: argparse.Namespace) -> None:
    """Initial GLB and images, vertices and normal map."""
    from mi_simplify.formats.captured.write import write_captured
    from mi_simplify.scenes.views import goniometer

    truth = opened(args.asset, args.texels)
    truth = replace(truth, normal=relief(args.texels))
    target = ms.load_asset(written(truth, args.out / "truth.glb"))
    start = written(moved(replace(truth, normal=flat(truth.normal)), args.amount), args.out / "start.glb")
    print("| images | loss before | after | | PSNR on the images | validator | names, UVs |")
    print("| ---: | ---: | ---: | ---: | ---: | --- | --- |")
    for n in args.images:
        views = goniometer(n, np.random.default_rng(n), width=args.side, height=args.side)
        images = ms.make_reference(target, spp=args.spp).render(views, 1)
        path = write_captured(args.out / f"images-{n}", views.arrays(), images)
        opt = ms.Optimization(start, path, steps=args.steps, batch=min(n, 4), overrides=args.set)
        opt.requires_grad("positions", "normal")
        before, first = opt.run.fit.judge()[0], opt.run.fit.look()
        for _ in range(args.steps):
            opt.step()
        result = opt.save(args.out / f"result-{n}.glb")
        opt.run.fit.take(opt.run.best)
        after, psnr = opt.run.fit.judge()
        strip(args.out / f"main-{n}.png", opt.run.fit.held_out.images, first, opt.run.fit.look())
        kept = "kept" if same_but_values(start, result) else "CHANGED"
        print(f"| {n} | {before:.4f} | {after:.4f} | {100 * after / before:.1f} % | {psnr:.1f} dB | {valid(result)} "
              f"| {kept} |", flush=True)  # fmt: skip


def same_but_values(before: Path, after: Path) -> bool:
    """Whether names, nodes, triangles and texture coordinates of two GLB files are the same."""
    a, b = ms.load_asset(before), ms.load_asset(after)
    names = lambda x: [p.name for p in x.parts] + [i.name for i in x.instances] + [p.material.name for p in x.parts]  # noqa: E731
    return names(a) == names(b) and all(
        np.array_equal(p.faces, q.faces) and np.array_equal(p.uvs, q.uvs) for p, q in zip(a.parts, b.parts, strict=True)
    )


def valid(path: Path) -> str:
    """What Khronos' validator says of a file; 'not there' without it (``npm i gltf-validator``)."""
    try:
        done = subprocess.run(["node", "-e", KHRONOS], input=path.read_bytes(), capture_output=True, cwd=ROOT)
    except FileNotFoundError:
        return "not there"
    if done.returncode:
        return "not there"
    issues = json.loads(done.stdout)
    return f"{issues['numErrors']} errors, {issues['numWarnings']} warnings"


def bias(args: argparse.Namespace) -> None:
    """Derivatives by hard_soft beside those by direct_edge, along the parameters of a scene, over the RMS of these."""
    from gradients import scenes
    from gradients.finite_difference import along
    from gradients.plugin import Plugin

    scene = scenes.scene(args.scene)
    adjoint = scenes.film_weights(scene, 1)
    exact = Plugin(scene)
    ways = [p for p in scenes.parameters(scene, exact.start) if p.group == "geometry"]

    def measured(plugin: Plugin) -> tuple[np.ndarray, np.ndarray]:
        """Means over seeds, and their standard errors."""
        found = [plugin.gradient(adjoint, args.spp, seed, attach=("positions", "camera")) for seed in range(args.seeds)]
        rows = np.array([[along(g, p.direction) for p in ways] for g in found])
        return rows.mean(0), rows.std(0, ddof=min(1, args.seeds - 1)) / np.sqrt(args.seeds)

    wanted, noise = measured(exact)
    hard = Plugin(scene, type="hard_soft", radius=1e-6).image(exact.start, args.spp, 1)
    yardstick = np.sqrt(np.mean(wanted**2))
    print(f"| r, {args.scene} | image off (mean) | {' | '.join(p.name for p in ways)} |")
    print("| ---: | ---: |" + " ---: |" * len(ways))
    for radius in args.radii:
        soft = Plugin(scene, type="hard_soft", radius=radius)
        found, its_noise = measured(soft)
        image = np.abs(soft.image(exact.start, args.spp, 1) - hard).mean()
        off, error = (found - wanted) / yardstick, np.hypot(noise, its_noise) / yardstick
        cells = " | ".join(f"{100 * x:+.1f} ± {100 * e:.1f} %" for x, e in zip(off, error, strict=True))
        print(f"| {radius:g} | {image:.5f} | {cells} |", flush=True)


def reach(args: argparse.Namespace) -> None:
    """Of random starts that are shifted or turned, how many are found again, and the mean silhouette error."""
    from mi_simplify.config import load_config
    from mi_simplify.fitting import Fit
    from mi_simplify.judging.metrics import silhouette_error
    from mi_simplify.scenes.references.fixed import FixedViews
    from mi_simplify.scenes.views import goniometer

    subject = ms.open_asset(args.asset)
    truth = ms.first_guess(subject, triangles=args.triangles, atlas_size=64)[0]
    views = goniometer(args.views, np.random.default_rng(0), width=args.side, height=args.side, distance=4.5, fov=45)
    images = ms.make_reference(truth.as_asset(), spp=16).render(views, 1)
    soft = ["optimizer.visibility=hard_soft", f"optimizer.hard_soft.radius={args.radius}"]
    ways = {"edge": [], "hard_soft": soft, "soft, then edge": [*soft, "optimizer.hard_soft.until=0.5"]}
    common = [
        "asset=none", f"optimizer.steps={args.steps}", f"optimizer.batch={args.views}", "reference.refresh=0",
        f"optimizer.resolution={args.side}", f"reference.pool={args.views}", "latent.optimize=[vertices]",
        f"optimizer.rates.vertices={args.rate}", "optimizer.large_steps.lambda_=19", "optimizer.tolerance=0",
        f"evaluation.views={args.views}", f"evaluation.resolution={args.side}",
    ]  # fmt: skip
    print(f"| start | {' | '.join(ways)} |\n| --- |" + " ---: |" * len(ways))
    cases = [("shift", x) for x in args.shifts] + [("rotation", x) for x in args.rotations]
    for kind, far in cases:
        cells, shown = [], []
        for overrides in ways.values():
            settings, errors = load_config(overrides=[*common, *overrides, *args.set]), []
            for seed in range(args.starts):
                fit = Fit(displaced(truth, kind, far, seed), FixedViews(_Seen(images, views), views), settings)
                before = fit.look()
                for k in range(args.steps):
                    fit.step(k)
                errors.append(silhouette_error(images[..., 3], fit.look()[..., 3]))
                if seed == 0:
                    shown += [before, fit.look()]
            n_found = int(np.sum(np.array(errors) < args.found))
            cells.append(f"{n_found} of {args.starts}, {np.median(errors):.3f}")
        strip(args.out / f"reach-{kind}-{far:g}.png", images, shown[0], *shown[1::2])
        unit = "of its size" if kind == "shift" else "°"
        print(f"| {kind} {far:g} {unit} | {' | '.join(cells)} |", flush=True)


class _Seen:
    """Images that are there already, of these views."""

    def __init__(self, images: np.ndarray, views):
        self.images, self._origins = images, views.arrays()["origin"]

    def render(self, views, seed: int = 0) -> np.ndarray:
        """Those of these cameras."""
        apart = np.linalg.norm(views.arrays()["origin"][:, None] - self._origins, axis=2)
        return self.images[apart.argmin(1)]


def displaced(model: ms.Model, kind: str, far: float, seed: int) -> ms.Model:
    """The model shifted by multiples of its size 2 in a random direction, or turned about a random axis [degrees]."""
    from scipy.spatial.transform import Rotation

    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    p = model.mesh.positions
    p = p + 2 * far * axis if kind == "shift" else Rotation.from_rotvec(np.radians(far) * axis).apply(p)
    return replace(model, mesh=replace(model.mesh, positions=p))


def sphere(args: argparse.Namespace) -> None:
    """From a sphere, by the recipe as it is and by one that begins with soft outlines."""
    from mi_simplify.judging.comparison import load_comparison

    soft = ["optimizer.visibility=hard_soft", f"optimizer.hard_soft.radius={args.radius}",
            f"optimizer.hard_soft.until={args.until}"]  # fmt: skip
    name, images = Path(args.asset.split(":")[-1]).stem, []
    print("| from a sphere | PSNR / FLIP / silhouette error | fit |\n| --- | --- | ---: |")
    for way, overrides in (("edge", []), ("soft, then edge", soft)):
        folder = args.out / f"sphere-{name}-{way.split(',')[0]}"
        common = [f"asset={args.asset}", "initial.kind=sphere", f"initial.triangles={args.triangles}",
                  "export.formats=glb"]  # fmt: skip
        result = ms.run_job(ms.load_config(overrides=[*common, *overrides, *args.set]), folder, overwrite=True)
        row, seconds = result.figures["candidates"]["result"], result.figures["run"]["seconds"]["fit"]
        print(f"| {name}, {args.triangles:,}: {way} | {row['psnr']:.2f} / {row['flip']:.4f} / "
              f"{row['silhouette_error']:.4f} | {seconds:.0f} s |", flush=True)  # fmt: skip
        seen = load_comparison(folder)
        images = images or [seen.reference]
        images.append(seen.candidates["result"])
    strip(args.out / f"sphere-{name}.png", *images)


def speed(args: argparse.Namespace) -> None:
    """Milliseconds of an image and its derivative: silhouettes by both estimators, and textures alone."""
    model = ms.first_guess(ms.open_asset(args.asset), triangles=args.triangles, atlas_size=args.texels)[0]
    print(f"| {len(model.mesh.faces):,} triangles, samples a pixel | wall | CPU |\n| --- | ---: | ---: |")
    for spp in args.spp:
        for estimator in ("hard_soft", "edge"):
            wall, cpu = timed(_pass(model, estimator, args.views, args.side, spp, True), args.rounds)
            print(f"| {args.views} × {args.side}² silhouettes, {estimator}, {spp} | {wall:.1f} ms | {cpu:.1f} ms |")
        wall, cpu = timed(_pass(model, "edge", args.views * 3 // 4, 2 * args.side, spp, False), args.rounds)
        size = f"{args.views * 3 // 4} × {2 * args.side}²"
        print(f"| {size} textures alone, {spp} | {wall:.1f} ms | {cpu:.1f} ms |", flush=True)


def _pass(model: ms.Model, estimator: str, n_views: int, side: int, spp: int, moving: bool):
    """An image of new positions and its derivative, by positions where these move, by textures where not."""
    import drjit as dr
    import mitsuba as mi

    from mi_simplify.integrators.deferred import DeferredRenderer
    from mi_simplify.integrators.soft.hard_soft import HardSoftRenderer
    from mi_simplify.latent.latent import Latent
    from mi_simplify.scenes.views import goniometer

    latent = Latent(model)
    renderer = (HardSoftRenderer if estimator == "hard_soft" else DeferredRenderer)(latent.topology)
    views = goniometer(n_views, np.random.default_rng(0), width=side, height=side)
    start = mi.Float(model.mesh.positions.ravel())
    by_image = dr.opaque(mi.Float, 0 if moving else 1), dr.opaque(mi.Float, 1)
    renderer.move(start)

    def run(k: int) -> None:
        positions = start * dr.opaque(mi.Float, 1 + 1e-5 * k) if moving else mi.Float(start)
        dr.eval(positions)
        if moving:
            dr.enable_grad(positions)
            renderer.move(dr.detach(positions))
        surface, seed = latent.evaluate(positions), dr.opaque(mi.UInt32, k)
        frame = renderer.render(surface, latent.textures, views, spp=spp, seed=seed)
        grad = mi.Vector4f(by_image[0], by_image[0], by_image[0], by_image[1]) + dr.zeros(mi.Float, n_views * side**2)
        texels = renderer.backward(frame, grad, surface, latent.textures, positions, seed)
        dr.eval(dr.grad(positions) if moving else texels.values)
        dr.sync_thread()

    return run


def timed(call, n_rounds: int, n_warm: int = 4) -> tuple[float, float]:
    """Medians of wall and CPU time [ms]."""
    rows = []
    for k in range(n_warm + n_rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        call(k)
        rows.append((time.perf_counter() - wall, time.process_time() - cpu))
    wall, cpu = 1e3 * np.median(rows[n_warm:], axis=0)
    return float(wall), float(cpu)


def reactive(args: argparse.Namespace) -> None:
    """CPU time of steps from fixed views: everything, normals alone, base colour alone."""
    import drjit as dr

    everything = ["positions", "base_color", "roughness", "metallic", "normal"]
    path = written(opened(args.asset, args.texels), args.out / "reactive.glb")
    print("| optimised | CPU time of a step | share |\n| --- | ---: | ---: |")
    whole = None
    for names in (everything, ["normal"], ["base_color"]):
        opt = ms.Optimization(path, path, views=args.views, batch=args.views, resolution=args.side, overrides=args.set)
        opt.requires_grad(*names)
        fit = opt.run.fit

        def step(k: int, fit=fit) -> None:
            dr.eval(fit.step(k))
            dr.sync_thread()

        cpu = timed(step, args.rounds)[1]
        whole = whole or cpu
        print(f"| {', '.join(names)} | {cpu:.0f} ms | {100 * cpu / whole:.0f} % |", flush=True)


def normals(args: argparse.Namespace) -> None:
    """A normal map from a flat one, the shape as it is, new views all the time."""
    from mi_simplify.judging.metrics import normal_dissimilarity

    truth = opened(args.asset, args.texels)
    if args.relief:
        truth = replace(truth, normal=relief(args.texels))
    shown = covered(truth.mesh, args.texels)
    target = written(truth, args.out / f"{truth.name}-truth.glb")
    start = written(replace(truth, normal=flat(truth.normal)), args.out / f"{truth.name}-flat.glb")
    opt = ms.Optimization(start, target, steps=args.steps, resolution=args.side, batch=args.views, overrides=args.set)
    opt.requires_grad("normal")
    pictures, first = [], None
    print(f"| {truth.name}, {args.texels}² | dissimilarity | |\n| ---: | ---: | ---: |")
    for k in range(args.steps + 1):
        if k % max(1, args.steps // 12) == 0:
            now = opt.run.fit.model().normal
            value = normal_dissimilarity(now, truth.normal, shown)
            first = value if first is None else first
            pictures += [opt.run.fit.look()] if k in (0, args.steps) else []
            print(f"| {k} | {value:.5f} | {100 * (1 - value / first):.1f} % less |", flush=True)
        if k < args.steps:
            opt.step()
    strip(args.out / f"normals-{truth.name}.png", opt.run.fit.held_out.images, *pictures)
    maps = np.concatenate([np.where(shown[..., None], 0.5 + 0.5 * x, 0) for x in (truth.normal, now)], axis=1)
    Image.fromarray(np.uint8(255 * np.clip(maps, 0, 1))).save(args.out / f"normals-{truth.name}-maps.png")


def covered(mesh, side: int) -> np.ndarray:
    """Texels that triangles show, shape (side, side)."""
    from mi_simplify.initial.unwrap.atlas import texel_counts

    return texel_counts(mesh, side) > 0


def strip(path: Path, *rows: np.ndarray) -> None:
    """Four views of each set of images, a row each: the target first."""
    from mi_simplify.judging.pictures import displayed

    path.parent.mkdir(parents=True, exist_ok=True)
    picture = np.concatenate([np.concatenate([image for image in displayed(x[:4])], axis=1) for x in rows])
    Image.fromarray(picture).save(path)


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    spot = str(ROOT.parent / "shared" / "assets" / "spot" / "spot.obj")

    def command(name: str, run, asset: str | None = spot, **options) -> None:
        made = commands.add_parser(name, help=run.__doc__)
        made.set_defaults(run=run)
        if asset is not None:
            made.add_argument("asset", nargs="?", default=asset)
        made.add_argument("--out", type=Path, default=Path("out/dressi"))
        made.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE")
        for option, value in options.items():
            many = isinstance(value, list)
            kind = type(value[0] if many else value)
            if kind is bool:
                made.add_argument(f"--{option}", action="store_true")
            else:
                made.add_argument(f"--{option}", type=kind, default=value, nargs="+" if many else None)

    command("main", main_run, images=[1, 20], steps=1000, side=128, texels=256, spp=64, amount=0.06)
    command("bias", bias, None, scene="two objects", radii=[0.1, 0.03, 0.01, 0.003], spp=64, seeds=12)
    command("reach", reach, triangles=200, views=4, side=32, steps=60, starts=20, radius=0.2, found=0.1,
            rate=0.08, shifts=[0.25, 0.5, 0.75], rotations=[30.0])  # fmt: skip
    command("sphere", sphere, triangles=3000, radius=0.05, until=0.3)
    command("speed", speed, triangles=3000, texels=1024, views=8, side=128, spp=[1, 2], rounds=20)
    command("reactive", reactive, texels=1024, views=8, side=256, rounds=20)
    command("normals", normals, texels=512, views=8, side=256, steps=1200, relief=False)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    ms.ensure_variant()
    args.run(args)


if __name__ == "__main__":
    main()
