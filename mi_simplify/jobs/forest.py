"""
Thousands of copies of plants and of their approximations, path traced side by side under light that no fit has seen.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from ..config.commands.forest import ForestSettings
from ..errors import Defect
from ..formats.gltf.instancing import write_instanced
from ..formats.textures import png, to_8bit
from ..judging.metrics import flip, psnr, tonemap
from ..machine.files import write_atomic
from ..progress import Progress, ProgressCallback, silent
from ..record.output import RunFolder
from ..subjects import open_asset
from ..subjects.subject import require_environment
from .scatter import scatter


def render_forest(
    forest: ForestSettings,
    out: str | Path,
    progress: ProgressCallback = silent,
    *,
    gpu_instancing: bool = False,
    overwrite: bool = False,
) -> dict:
    """
    Render a forest of originals, twice with other noise, and one of approximations; compare pictures and costs.

    Parameters
    ----------
    forest : ForestSettings
    out : str or Path
        Folder: ``original.png``, ``approximation.png``, ``forest.json``.
    progress : callable
    gpu_instancing : bool
        Also write ``forest_K.glb`` for each species K: its approximation with all its placements
        (EXT_mesh_gpu_instancing).
    overwrite : bool
        Replace what is there.

    Returns
    -------
    dict
        In ``forest.json``: ``psnr`` [dB] and ``flip`` of the approximation, ``noise_psnr`` and ``noise_flip`` of
        the original's second picture, by kind of forest ``seconds`` of load, build and render and peak ``memory``
        [bytes], and ``ratios`` original / approximation.

    Raises
    ------
    UserError
        A model cannot be read, or the folder not be written.
    """
    folder = RunFolder(out, overwrite=overwrite)
    require_environment(forest.environment)
    progress(Progress("load"))
    originals = [open_asset(plant.original) for plant in forest.plants]
    shown = [open_asset(plant.approximation) for plant in forest.plants]
    side = forest.side * max(float(np.ptp(a.bounds[:, 1])) for a in originals)
    rng = np.random.default_rng(forest.seed)
    placements = scatter(forest.instances, side, forest.least_size, rng)
    species = rng.integers(len(originals), size=forest.instances)
    names = {
        "original": [p.original for p in forest.plants],
        "approximation": [p.approximation for p in forest.plants],
    }
    runs = [("original", 0), ("original", 1), ("approximation", 2)]
    with folder.opened(), folder.staged() as stage, tempfile.TemporaryDirectory() as scratch:
        np.save(Path(scratch, "placements.npy"), placements)
        np.save(Path(scratch, "species.npy"), species)
        images, costs = [], {}
        for k, (kind, seed) in enumerate(runs):
            progress(Progress("render", k + 1, len(runs), message=kind))
            job = forest.model_dump(mode="json") | {
                "assets": names[kind], "side": side, "seed": forest.seed + seed,
                "placements": f"{scratch}/placements.npy", "species": f"{scratch}/species.npy",
                "out": f"{scratch}/image.npy",
            }  # fmt: skip
            costs[kind] = _rendered(job, Path(scratch, "job.json"))
            images.append(np.load(f"{scratch}/image.npy"))
        figures = _figures(forest, images, costs, [originals, shown], species)
        write_atomic(stage / "forest.json", json.dumps(figures, indent=2) + "\n")
        for name, image in (("original", images[0]), ("approximation", images[2])):
            write_atomic(stage / f"{name}.png", png(to_8bit(tonemap(image))))
        if gpu_instancing:
            for k, plant in enumerate(forest.plants):
                write_instanced(plant.approximation, placements[species == k], stage / f"forest_{k}.glb")
    return figures


def _rendered(job: dict, path: Path) -> dict[str, float]:
    """Render in a process of its own; what that cost."""
    path.write_text(json.dumps(job), encoding="utf-8")
    command = [sys.executable, "-m", "mi_simplify.jobs.forest_worker", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        raise Defect(f"the forest could not be rendered: {last[0]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def _figures(
    forest: ForestSettings, images: list[np.ndarray], costs: dict, assets: list[list], species: np.ndarray
) -> dict:
    original, again, approximation = (image[None] for image in images)
    triangles = [int(sum(kinds[s].n_triangles for s in species.tolist())) for kinds in assets]
    a, b = costs["original"], costs["approximation"]
    return {
        "instances": forest.instances,
        "triangles": {"original": triangles[0], "approximation": triangles[1]},
        "psnr": float(psnr(original, approximation)[0]),
        "noise_psnr": float(psnr(original, again)[0]),
        "flip": float(flip(original, approximation)[0]),
        "noise_flip": float(flip(original, again)[0]),
        "costs": costs,
        "ratios": {key: a[key] / max(b[key], 1e-9) for key in a},
    }


def summary(figures: dict, folder: str | Path) -> str:
    """
    A few lines for a person.
    """
    a, b = (figures["costs"][kind] for kind in ("original", "approximation"))
    lines = [
        f"{name:8}  original {a[key]:8.1f} s   approximation {b[key]:8.1f} s   ratio {figures['ratios'][key]:.1f}"
        for key, name in (("load", "load"), ("build", "build"), ("render", "render"))
    ]
    mib = 2**20
    return "\n".join([
        f"{figures['instances']} copies, PSNR {figures['psnr']:.2f} dB (noise alone {figures['noise_psnr']:.2f} dB), "
        f"FLIP {figures['flip']:.4f} ({figures['noise_flip']:.4f})",
        *lines,
        f"memory    original {a['memory'] / mib:8.0f} MiB approximation {b['memory'] / mib:8.0f} MiB "
        f"ratio {figures['ratios']['memory']:.1f}",
        f"{folder}: done",
    ])  # fmt: skip
