"""
The commands that make something: models, levels of detail, forests.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .console import display, prepare
from .options import (
    BAKE_OCCLUSION,
    DRY_RUN,
    FRAMES,
    GOALS,
    JOB,
    KEEP_UV,
    OUT,
    OVERWRITE,
    PACKING,
    QUIET,
    RESUME,
    TENSORBOARD,
    VARIANT,
    ListOf,
    Triangles,
    animation,
    budget,
    default_folder,
    packing,
    sized,
)


@click.command()
@click.argument("asset")
@click.option("--triangles", "-n", metavar="N|N%", type=Triangles(), help="Triangles of the result: 2000, or 30%.")
@click.option("--vertices", type=click.IntRange(min=8), help="Vertices of the file, instead of triangles.")
@GOALS
@click.option("--init", metavar="MESH", help="Start from this low-poly mesh file, or from a 'sphere'.")
@click.option(
    "--mode",
    type=click.Choice(["mesh", "cards", "auto"]),
    default="mesh",
    show_default=True,
    help="What the result is made of: one surface, textured cards for foliage, or what suits the asset.",
)
@KEEP_UV
@BAKE_OCCLUSION
@click.option("--keep-hidden", is_flag=True, help="Keep parts that cannot be seen from outside.")
@click.option("--keep-nodes", is_flag=True, help="Keep all nodes of a glTF file, not only the animated ones.")
@click.option("--keep", "kept", metavar="NAME", multiple=True, help="Keep the nodes of this name; repeatable.")
@click.option("--drop-extras", is_flag=True, help="Leave out the copyright notice and the extras of the asset's file.")
@FRAMES
@click.option("--transfer", is_flag=True, help="Also write soft self-shadows of the whole clip, as textures.")
@click.option("--bind-pose-only", is_flag=True, help="Fit a character in its bind pose alone.")
@OUT
@click.option("--config", metavar="YAML", help="Settings to start from.")
@JOB
@PACKING
@OVERWRITE
@RESUME
@TENSORBOARD
@DRY_RUN
@QUIET
def simplify(
    asset, triangles, vertices, psnr, flip, screen_size, init, mode, keep_uv, bake_occlusion, keep_hidden,
    keep_nodes, kept, drop_extras, frames, transfer, bind_pose_only, out, config, settings, **options,
) -> None:  # fmt: skip
    """
    Simplify ASSET: a model file, a Mitsuba scene, sample:relic for the embedded one, or package.module:function for
    an implicit surface.
    """
    size = sized(triangles, vertices, psnr=psnr, flip=flip, screen_size=screen_size)
    initial = size["initial"]
    if init is not None:
        initial |= {"kind": "sphere", "mesh": None} if init == "sphere" else {"kind": "mesh", "mesh": init}
    if keep_uv:
        initial["keep_uv"] = True
    if bake_occlusion:
        initial["bake_occlusion"] = True
    if keep_hidden:
        initial["keep_hidden"] = True
    if keep_nodes:
        initial["keep_nodes"] = "all"
    if kept:
        initial["keep"] = list(kept)
    if mode != "mesh":
        if init is not None:
            raise click.UsageError(f"--mode {mode} makes a first guess of its own, so it does not go with --init")
        initial["kind"] = mode
    chosen = {"asset": asset, **size, "animation": animation(frames, bind_pose_only)}
    chosen["export"] = {"metadata": False} if drop_extras else {}
    if transfer:
        chosen["export"]["transfer"] = {"write": True}
    _run(config, out or default_folder(asset), [*settings, chosen], **options)


@click.command()
@click.argument("asset")
@click.option(
    "--triangles", "-n", metavar="N,N,…", type=ListOf(Triangles()), help="Budgets, falling: 9000,3000,1000 or 30%,10%."
)
@click.option(
    "--levels", type=click.Choice(["auto"]), help="Find the budgets: the least for sizes on the screen that halve."
)
@click.option("--vertices", metavar="N,N,…", type=ListOf(click.IntRange(min=8)), help="Vertices of the files, instead.")
@OUT
@click.option("--config", metavar="YAML", help="Settings of every level.")
@click.option("--preset", metavar="NAME", help="fast, balanced or best.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Override a config key; repeatable.")
@click.option(
    "--threshold", type=click.FloatRange(0, 1, min_open=True), default=0.04, show_default=True,
    help="FLIP between two levels, over what they cover, below which a switch is not seen.",
)  # fmt: skip
@click.option("--msft-lod", is_flag=True, help="Also write lods.glb: all levels, with MSFT_lod.")
@click.option("--usd", is_flag=True, help="Also write lods.usda: all levels, with UsdLod and a variant set.")
@VARIANT
@OVERWRITE
@QUIET
def lod(
    asset, triangles, vertices, levels, out, config, preset, settings, threshold, msft_lod, usd, variant, overwrite,
    quiet,
) -> None:  # fmt: skip
    """
    Make a chain of levels of detail from ASSET, each for the size on the screen at which it takes over.
    """
    from ..config import load_config

    budgets, finest = None, None
    if levels is not None:
        if vertices is not None or len(triangles or ()) > 1:
            raise click.UsageError("--levels auto finds the budgets; beside it --triangles names the finest one alone")
        finest = triangles[0] if triangles else None
    elif (triangles is None) == (vertices is None):
        raise click.UsageError("name the levels by --triangles or by --vertices, one of them, or let --levels auto")
    else:
        budgets = [budget(n, None) for n in triangles or ()] or [budget(None, n) for n in vertices]
    chosen: dict[str, Any] = {"asset": asset} if variant is None else {"asset": asset, "variant": variant}

    def configure(keys):
        return load_config(config, [*settings, chosen, keys], preset)

    prepare(configure({}).variant)
    from ..jobs.chain import lod_job

    extras = [name for name, wanted in (("msft_lod", msft_lod), ("usd", usd)) if wanted]
    with display(quiet) as progress:
        chain = lod_job(
            configure, budgets, out or default_folder(asset.removeprefix("sample:")), progress,
            finest=finest, threshold=threshold, extras=extras, overwrite=overwrite,
        )  # fmt: skip
    if not quiet:
        print(chain.summary())


@click.command()
@click.argument("config")
@OUT
@JOB
@PACKING
@OVERWRITE
@RESUME
@TENSORBOARD
@DRY_RUN
@QUIET
def run(config, out, settings, **options) -> None:
    """
    Run the job that the YAML file CONFIG describes.
    """
    _run(config, out or default_folder(config), settings, **options)


def _run(
    config, out, overrides, *,
    preset, variant, fixed_shape, normal_only, skip, time_limit, judged, memory_limit, compress, textures, quality,
    max_bytes, no_tangents, tensorboard, dry_run, overwrite, resume, quiet,
) -> None:  # fmt: skip
    from ..config import load_config, with_fixed
    from ..config.presets import FULL_EVALUATION
    from ..machine.memory import limited, parse_size
    from ..progress import seconds_of

    chosen: dict[str, Any] = {} if variant is None else {"variant": variant}
    packed = packing(
        compress=compress, textures=textures, quality=quality, max_bytes=max_bytes, no_tangents=no_tangents
    )  # fmt: skip
    chosen["export"] = ({"tensorboard": True} if tensorboard else {}) | ({"glb": packed} if packed else {})
    if time_limit is not None:
        chosen["optimizer"] = {"time": seconds_of(time_limit)}
    if judged == "full":
        chosen["evaluation"] = FULL_EVALUATION
    if normal_only:
        chosen["latent"] = {"optimize": ["normal"]}
    names = [name.strip() for text in skip for name in text.split(",")] + ["shape"] * fixed_shape
    settings = with_fixed(load_config(config, [*overrides, chosen], preset), names)
    prepare(settings.variant)
    from ..jobs.forecast import forecast
    from ..jobs.job import run_job

    job: Callable[..., Any] = forecast if dry_run else run_job
    with limited(parse_size(memory_limit) if memory_limit else None), display(quiet) as progress:
        result = job(settings, out, progress, overwrite=overwrite, resume=resume)
    if dry_run or not quiet:
        print(result.summary())
    for line in () if dry_run else result.growth:
        print(f"warning: {line}", file=sys.stderr)
    if not dry_run and result.alarm is not None:
        click.secho(f"warning: {result.alarm}", fg="red", err=True)  # colours are left out where it is no terminal


@click.command()
@click.argument("reference")
@click.argument("lowpoly")
@KEEP_UV
@OUT
@click.option("--atlas-size", type=click.IntRange(16, 8192), help="Texture side; initial.atlas_size if not given.")
@BAKE_OCCLUSION
@VARIANT
@OVERWRITE
@QUIET
def bake(reference, lowpoly, keep_uv, out, atlas_size, bake_occlusion, variant, overwrite, quiet) -> None:
    """
    Bake the look of REFERENCE into textures for LOWPOLY, a mesh of yours in the same place.
    """
    prepare(variant)
    from ..jobs.job import bake_job

    with display(quiet) as progress:
        files = bake_job(
            reference, lowpoly, out or default_folder(lowpoly), progress,
            keep_uv=keep_uv, atlas_size=atlas_size, bake_occlusion=bake_occlusion, variant=variant, overwrite=overwrite,
        )  # fmt: skip
    if not quiet:
        print("\n".join(str(path) for path in files.values()))


@click.command()
@click.argument("initial")
@click.option(
    "--to",
    "targets",
    metavar="TARGETS",
    required=True,
    help="A transforms.json, an image seen by the file's camera, a model file, or package.module:function.",
)
@click.option(
    "--optimize",
    "names",
    metavar="NAMES",
    multiple=True,
    required=True,
    help="What changes, each with a rate if you like: positions,normal=0.02.",
)
@OUT
@click.option("--steps", type=click.IntRange(0), help="How many; 1000.")
@click.option("--resolution", type=click.IntRange(8, 8192), help="Side of the images [px]; 256, or that of TARGETS.")
@click.option("--batch", type=click.IntRange(1, 1024), help="Views of a step; 8, or as many as there are.")
@click.option("--views", type=click.IntRange(1, 1024), help="Fixed views of a model; new ones all the time without it.")
@click.option("--camera", default="0", show_default=True, help="Of an image: number or name of the file's camera.")
@click.option("--texture-size", type=click.IntRange(1, 8192), default=512, show_default=True, help="Of new textures.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Override a config key; repeatable.")
@VARIANT
@OVERWRITE
@RESUME
@QUIET
def fit(
    initial, targets, names, out, steps, resolution, batch, views, camera, texture_size, settings, variant, overwrite,
    resume, quiet,
) -> None:  # fmt: skip
    """
    Fit the glTF file INITIAL in place to what it should look like; all that is not named stays as it is.
    """
    prepare(variant)
    from ..jobs.in_place import fit_job, named
    from ..jobs.optimization import Optimization

    optimization = Optimization(
        initial, targets, steps=steps, resolution=resolution, batch=batch, views=views, camera=camera,
        texture_size=texture_size, overrides=settings,
    )  # fmt: skip
    optimization.requires_grad(**named(names))
    with display(quiet) as progress:
        result = fit_job(optimization, out or default_folder(initial), progress, overwrite=overwrite, resume=resume)
    if not quiet:
        print(result.summary())


@click.command()
@click.argument("config")
@OUT
@click.option("--instances", type=click.IntRange(1, 1_000_000), help="How many copies, instead of what CONFIG says.")
@click.option("--environment", metavar="HDR", help="Environment map, instead of what CONFIG says.")
@click.option("--gpu-instancing", is_flag=True, help="Also write the copies as GLB files (EXT_mesh_gpu_instancing).")
@OVERWRITE
@QUIET
def forest(config, out, instances, environment, gpu_instancing, overwrite, quiet) -> None:
    """
    Path trace thousands of copies of the plants in the YAML file CONFIG, and of their approximations.
    """
    from ..config.commands.forest import load_forest

    wanted = load_forest(config)
    changes = {"instances": instances, "environment": environment and str(Path(environment).resolve())}
    wanted = wanted.model_copy(update={key: value for key, value in changes.items() if value is not None})
    prepare(None)
    from ..jobs.forest import render_forest, summary

    folder = out or default_folder(config)
    with display(quiet) as progress:
        figures = render_forest(wanted, folder, progress, gpu_instancing=gpu_instancing, overwrite=overwrite)
    if not quiet:
        print(summary(figures, folder))
