"""
What one step of a fit costs: against the bare forward rendering, against Mitsuba's ``direct_projective``, and as
triangles, texels and pixels grow.

    python benchmarks/gradients.py                 # tables on the terminal, plots and docs/performance.md
    python benchmarks/gradients.py --row 1 64      # one row, nothing written

A step is ``Fit.step`` itself, on a bumpy sphere made here, with one sample per pixel and gradients to vertices, base
colour, roughness, metalness and normals. Every row runs in a process of its own, so that its peak memory is its own.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import resource
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT, IMAGES = ROOT / "docs" / "performance.md", ROOT / "docs" / "images"

#: Views, resolution, triangles, side of the textures.
PIXELS = [(1, 64, 3000, 1024), (1, 256, 3000, 1024), (2, 256, 3000, 1024), (8, 256, 3000, 1024), (4, 512, 3000, 1024)]
TRIANGLES = [(8, 256, n, 1024) for n in (1000, 3000, 10_000, 100_000)]
TEXELS = [(v, 256, 3000, n) for v in (1, 8) for n in (256, 1024, 2048)]

#: Stages of a step, in its order, and what they are: an attribute of the ``Fit``, or its module, and a function.
STAGES = {
    "views": ("pool", "batch"),
    "vertices": ("vertices", "positions"),
    "BVH": ("renderer", "move"),
    "mesh operations": ("latent", "evaluate"),
    "forward": ("renderer", "render"),
    "loss": ("module", "frame_loss"),
    "backward": ("renderer", "backward"),
    "boundary": ("boundary", "backward"),
    "regulariser": ("laplacian", "loss"),
    "texel optimiser": ("texels", "step"),
    "vertex optimiser": ("vertices", "step"),
}
#: What the issue of gradients counts: all but drawing views, regulariser and optimisers.
GRADIENT = ("BVH", "mesh operations", "forward", "loss", "backward", "boundary")


def bumpy_sphere(n_triangles: int, n_texels: int, seed: int = 0):
    """
    A model of one closed surface with 54 charts, smooth relief and smooth random textures.
    """
    import numpy as np
    from scipy.ndimage import zoom

    from mi_simplify.initial.sphere import sphere
    from mi_simplify.model.mesh import Mesh
    from mi_simplify.model.model import Model

    rng = np.random.default_rng(seed)
    p, faces = sphere(n_triangles)
    faces = faces[np.argsort(faces.min(1), kind="stable")]  # the hull comes in no order, real meshes do not
    corner, centre = p[faces], p[faces].mean(1)
    axis = np.argmax(np.abs(centre), axis=1)
    row = np.arange(len(faces))
    sign = np.sign(centre[row, axis])
    side = np.stack([(axis + 1) % 3, (axis + 2) % 3], 1)
    # Cube map of the sphere, each side in 3x3 cells; a corner may lie a little outside of its triangle's cell.
    depth = np.take_along_axis(corner, axis[:, None, None], 2) * sign[:, None, None]
    place = np.take_along_axis(corner, side[:, None, :], 2) / depth  # (F, 3, 2) in [-1, 1]
    cell = np.clip(np.floor((place.mean(1) + 1) * 1.5), 0, 2)
    chart = ((axis * 2 + (sign > 0)) * 3 + cell[:, 0]) * 3 + cell[:, 1]
    local = (place + 1) * 1.5 - cell[:, None]
    margin = 0.5 * np.sqrt(12 / n_triangles) * 3 + 0.02
    uv = (np.stack([chart % 8, chart // 8], 1)[:, None] + 0.5 + (local - 0.5) / (1 + 2 * margin)) / 8
    key = faces.ravel() * 64 + np.repeat(chart, 3).astype(np.int64)
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    radius = 0.85 + 0.06 * np.sin(rng.normal(size=(6, 3)) @ p.T * 6 + rng.uniform(0, 6, (6, 1))).sum(0)
    uvs = uv.reshape(-1, 2)[first].astype(np.float32)
    mesh = Mesh(p * radius[:, None], faces.ravel()[first], uvs, index.reshape(-1, 3))

    def smooth(channels: int, low: float, high: float):
        coarse = rng.uniform(low, high, (32, 32, channels)).astype(np.float32)
        return zoom(coarse, (n_texels / 32, n_texels / 32, 1), order=1, grid_mode=True, mode="grid-wrap")

    one = np.ones((n_texels, n_texels, 1), np.float32)
    base = np.concatenate([smooth(3, 0.1, 0.9), one], 2)
    specular = np.concatenate([0 * one, smooth(1, 0.3, 0.8), smooth(1, 0, 0.6)], 2)
    normal = np.concatenate([smooth(2, -0.3, 0.3), one], 2)
    return Model(mesh, base, specular, normal / np.linalg.norm(normal, axis=2, keepdims=True))


class Target:
    """
    Reference images of another bumpy sphere, by our own renderer: no step waits for them.
    """

    def __init__(self, n_triangles: int, n_texels: int):
        import drjit as dr
        import mitsuba as mi
        import numpy as np

        from mi_simplify.integrators.deferred import DeferredRenderer
        from mi_simplify.latent.latent import Latent
        from mi_simplify.machine.upload import upload

        model = bumpy_sphere(n_triangles, n_texels, seed=1)
        self._latent = Latent(model)
        self._renderer = DeferredRenderer(self._latent.topology)
        positions = upload(mi.Float, np.ravel(bumpy_sphere(n_triangles, 32).mesh.positions * 1.01))
        self._renderer.move(positions)
        with dr.suspend_grad():
            self._surface = self._latent.evaluate(positions)

    def render(self, views, seed: int = 0):
        import drjit as dr
        import mitsuba as mi

        with dr.suspend_grad():
            seed = dr.opaque(mi.UInt32, seed % 2**31)
            frame = self._renderer.render(self._surface, self._latent.textures, views, spp=4, seed=seed)
        return frame.images()


class Clock:
    """
    Times calls, with the device idle before and after.
    """

    def __init__(self, cpu: bool):
        self._now = time.process_time if cpu else time.perf_counter

    def __call__(self, call, *args, **kwargs):
        """
        Result of a call, and the milliseconds that it took.
        """
        import drjit as dr

        dr.sync_thread()
        start = self._now()
        result = call(*args, **kwargs)
        dr.eval(result)
        dr.sync_thread()
        return result, (self._now() - start) * 1e3


def run_row(views: int, resolution: int, n_triangles: int, n_texels: int, options) -> dict:
    """
    Measure one configuration in this process; milliseconds and megabytes.
    """
    from mi_simplify.machine import runtime

    runtime.ensure_variant()
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    from mi_simplify.config import Config
    from mi_simplify.fitting import Fit

    if options.cpu:
        dr.set_thread_count(1)
    clock = Clock(options.cpu)
    idle = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    model = bumpy_sphere(n_triangles, n_texels)
    optimizer = {"batch": views, "resolution": resolution, "spp": 1, "steps": 10**6}
    settings = {"asset": "none", "reference": {"refresh": 0, "pool": 3 * views}, "optimizer": optimizer}
    if options.gamma:
        settings["latent"] = {"optimize": ["vertices", "base_color", "gamma", "roughness", "metallic", "normal"]}
    fit = Fit(model, Target(n_triangles, n_texels), Config.model_validate(settings))
    for k in range(1, 5):
        fit.step(k)
    steps = [clock(fit.step, k)[1] for k in range(5, 5 + options.steps)]

    batch = fit.pool.batch(views)[0]
    with dr.suspend_grad():
        surface = fit.latent.evaluate(fit.shape.still(batch).positions)
        dr.eval(surface.packets)

        def bare(seed: int):
            seed = dr.opaque(mi.UInt32, seed)
            return fit.renderer.render(surface, fit.latent.textures, batch, spp=1, seed=seed).image

        bare = [clock(bare, k)[1] for k in range(3 + options.steps)][3:]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    row = {
        "views": views, "resolution": resolution, "triangles": len(model.mesh.faces), "texels": n_texels,
        "step": float(np.median(steps)), "bare": float(np.median(bare)), "memory": (peak - idle) / 1024,
    }  # fmt: skip
    row["stages"] = stages(fit, clock, options.steps)
    row["gradient"] = sum(row["stages"][name] for name in GRADIENT)
    if options.reference:
        row["stages"] = {"reference": reference(resolution, clock, options.steps)} | row["stages"]
    if options.projective:
        row["projective"] = projective(model, batch, clock, options.steps)
    return row


def reference(resolution: int, clock: Clock, n_steps: int) -> float:
    """
    What a step's share of reference images costs at the default settings: direct light, 100,000 triangles.
    """
    import numpy as np

    from mi_simplify.config import Config
    from mi_simplify.scenes.references.path_traced import make_reference
    from mi_simplify.scenes.views import goniometer

    settings = Config(asset="none").reference
    renderer = make_reference(bumpy_sphere(100_000, 1024).as_asset(), transport="direct", spp=settings.spp)
    rng = np.random.default_rng(0)

    def render(k: int) -> None:
        renderer.render(goniometer(settings.refresh, rng, width=resolution, height=resolution, irradiance=np.pi), k)

    return float(np.median([clock(render, k)[1] for k in range(2 + n_steps // 2)][2:]))


def stages(fit, clock: Clock, n_steps: int) -> dict[str, float]:
    """
    Medians of the stages of a step; the device idles between them, so that they add up to more than a step.
    """
    import numpy as np

    times: dict[str, list[float]] = {name: [] for name in STAGES}
    owners = {
        "module": sys.modules[type(fit).__module__], "vertices": fit.shape.vertices, "boundary": fit.renderer.boundary,
    }  # fmt: skip

    def timed(name: str, call):
        def wrapped(*args, **kwargs):
            result, elapsed = clock(call, *args, **kwargs)
            times[name].append(elapsed)
            return result

        return wrapped

    for name, (owner, function) in STAGES.items():
        owner = owners.get(owner) or getattr(fit, owner)
        setattr(owner, function, timed(name, getattr(owner, function)))
    for k in range(n_steps + 1):
        fit.step(100 + k)
    out = {name: float(np.median(t[1:])) for name, t in times.items()}
    out["backward"] -= out["boundary"]  # which is called by it
    return out


def projective(model, views, clock: Clock, n_steps: int) -> float:
    """
    A step of Mitsuba's `direct_projective`: BVH, forward, L1, and derivatives by vertices alone, primary edges only.

    One continuous and one primary-edge sample per pixel and no indirect ones (``sppi: 0``), one view after the other.
    """
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    from mi_simplify.machine.meshes import POSITIONS
    from mi_simplify.scenes.references.mitsuba import view_sensor
    from mi_simplify.scenes.shapes import asset_shapes

    arrays = views.arrays()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct_projective", "sppc": 1, "sppp": 1, "sppi": 0, "hide_emitters": True},
            "light": {
                "type": "point", "position": arrays["light_position"][0].tolist(),
                "intensity": {"type": "rgb", "value": arrays["light_intensity"][0].tolist()},
            },
            **{f"s{k}": view_sensor(arrays, k, views.width, views.height) for k in range(len(views))},
            **asset_shapes(model.as_asset()),
        },
        optimize=False,
    )  # fmt: skip
    params, key = mi.traverse(scene), f"part_0.{POSITIONS}"
    start = mi.Float(params[key])

    def step(k: int):
        moved = start + dr.opaque(mi.Float, 1e-6 * k)
        dr.enable_grad(moved)
        params[key] = moved
        params.update()
        for view in range(len(views)):
            image = mi.render(scene, params, sensor=view, spp=0, spp_grad=0, seed=k * len(views) + view)
            dr.backward(dr.mean(dr.abs(image - 0.3), axis=None))
        return dr.grad(moved)

    return float(np.median([clock(step, k)[1] for k in range(4 + n_steps)][4:]))


def measure(rows: list[tuple], options) -> list[dict]:
    """
    Every distinct row once, each in a process of its own.
    """
    out = {}
    for row in rows:
        if row not in out:
            flags = [name for name, on in (("--cpu", options.cpu), ("--gamma", options.gamma)) if on]
            flags += ["--projective"] if row[3] == 1024 and row[2] <= 10_000 else []
            flags += ["--reference"] if row in PIXELS else []
            command = [sys.executable, __file__, "--json", "--steps", str(options.steps), *flags, "--row"]
            command += map(str, row)
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                sys.exit(f"{' '.join(command)} failed:\n{done.stderr}")
            out[row] = json.loads(re.search(r"\{.*\}", done.stdout)[0])  # Mitsuba logs there too
            print(f"{describe(out[row])}: {out[row]['step']:.1f} ms", file=sys.stderr)
    return [out[row] for row in rows]


def describe(row: dict) -> str:
    """Views, resolution, triangles and texels in words."""
    return f"{row['views']}x{row['resolution']}², {row['triangles']:,} triangles, {row['texels']}² texels"


def table(rows: list[dict]) -> list[str]:
    """
    Markdown lines: a row a configuration.
    """
    out = [
        "| views | triangles | textures | step | of it gradients | bare forward | step / bare | gradients / bare "
        "| `direct_projective` / gradients | peak memory |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for r in rows:
        other = f"{r['projective'] / r['gradient']:.1f}" if "projective" in r else ""
        out.append(
            f"| {r['views']} × {r['resolution']}² | {r['triangles']:,} | {r['texels']}² | {r['step']:.1f} ms "
            f"| {r['gradient']:.1f} ms | {r['bare']:.1f} ms | {r['step'] / r['bare']:.1f} "
            f"| {r['gradient'] / r['bare']:.1f} | {other} | {r['memory']:.0f} MB |"
        )
    return out


def stage_table(rows: list[dict]) -> list[str]:
    """
    Markdown lines: a column a configuration, a row a stage.
    """
    head = " | ".join(f"{r['views']} × {r['resolution']}²" for r in rows)
    out = [f"| stage | {head} |", "| --- |" + " ---: |" * len(rows)]
    for name in rows[0]["stages"]:
        out.append(f"| {name} | " + " | ".join(f"{r['stages'][name]:.1f} ms" for r in rows) + " |")
    return out


def plot(groups: dict[str, tuple[list[dict], str]], path: Path) -> None:
    """
    Cost of a step against one size each, beside a straight proportion.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(groups), figsize=(4 * len(groups), 3.4), sharey=True)
    size = {
        "pixels": lambda r: r["views"] * r["resolution"] ** 2,
        "triangles": lambda r: r["triangles"],
        "texels": lambda r: r["texels"] ** 2,
    }
    for axis, (name, (rows, kind)) in zip(axes, groups.items(), strict=True):
        for views in sorted({r["views"] for r in rows}) if kind != "pixels" else [None]:
            some = sorted((r for r in rows if views in (None, r["views"])), key=size[kind])
            x = [size[kind](r) for r in some]
            label = f"{views} × 256²" if views else "a step"
            (line,) = axis.loglog(x, [r["step"] for r in some], "o-", label=label)
            axis.loglog(x, [some[-1]["step"] * v / x[-1] for v in x], ":", color=line.get_color(), lw=1)
        axis.set_xlabel(kind)
        axis.set_title(name)
        axis.legend()
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("ms; dotted: in proportion")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def machine(options) -> str:
    """The processor and what was timed, in a sentence."""
    cpuinfo = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    timed = "CPU time of one thread" if options.cpu else f"wall-clock time on {cores} cores"
    return f"{(names or [platform.processor()])[0]}, {timed}, medians over {options.steps} steps."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--steps", type=int, default=12, help="steps that medians are taken over")
    parser.add_argument("--cpu", action="store_true", help="one thread and its CPU time: for machines that are busy")
    parser.add_argument("--gamma", action="store_true", help="fit γ as well: twelve channels instead of eight")
    parser.add_argument("--projective", action="store_true", help="measure direct_projective, with --row")
    parser.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--reference", action="store_true", help="measure reference images, with --row")
    parser.add_argument("--row", type=int, nargs="+", metavar="N", help="views, resolution, triangles, texture side")
    options = parser.parse_args()
    if options.row:
        row = run_row(*(options.row + [3000, 1024][len(options.row) - 2 :])[:4], options=options)
        print(json.dumps(row) if options.json else "\n".join([describe(row), *table([row]), "", *stage_table([row])]))
        return
    rows = measure(PIXELS + TRIANGLES + TEXELS, options)
    pixels, triangles, texels = rows[: len(PIXELS)], rows[len(PIXELS) : -len(TEXELS)], rows[-len(TEXELS) :]
    lines = [f"Measured on: {machine(options)}", ""]
    for name, part in (("Pixels", pixels), ("Triangles", triangles), ("Texels", texels)):
        lines += [f"### {name}", "", *table(part), ""]
    lines += ["### Stages", "", *stage_table(pixels), ""]
    print("\n".join(lines))
    plot(
        {"pixels": (pixels, "pixels"), "triangles, 8 × 256²": (triangles, "triangles"), "texels": (texels, "texels")},
        IMAGES / "performance.png",
    )
    text = DOCUMENT.read_text()
    block = "<!-- figures: benchmarks/gradients.py -->\n" + "\n".join(lines) + "<!-- end of figures -->"
    DOCUMENT.write_text(re.sub(r"<!-- figures.*?<!-- end of figures -->", lambda _: block, text, flags=re.S))


if __name__ == "__main__":
    main()
