"""
The command line: parse, call the functions that Python users call, say what came out.

The only module that prints. Exit codes: 0 done, 2 the user's input is wrong (one line, no
traceback), 1 a defect of ours, 130 interrupted. Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import functools
import logging
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from . import __version__
from .errors import Defect, UserError


def main(argv: list[str] | None = None) -> int:
    """
    Run the command line and return its exit code.

    Parameters
    ----------
    argv : list of str or None
        Arguments without the program's name; None takes those of the process.
    """
    logging.getLogger("mi_simplify").addHandler(_WARNINGS)
    argv = (sys.argv[1:] if argv is None else argv) or ["--help"]
    try:
        code = cli.main(args=argv, prog_name="mi-simplify", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "mi-simplify"
        return _fail(f"{error.format_message()} (see '{command} --help')")
    except click.ClickException as error:
        return _fail(error.format_message())
    except (UserError, Defect) as error:
        return _fail(str(error), error.exit_code)
    except (click.Abort, KeyboardInterrupt, Exception) as error:
        interrupt = _interrupt(error)
        if interrupt is not None:
            print(f"interrupted: {interrupt}" if str(interrupt) else "interrupted", file=sys.stderr)
            return 130
        traceback.print_exc()
        print("this is a defect of mi_simplify, please report it with the lines above", file=sys.stderr)
        return 1


class _Warnings(logging.Handler):
    """Warnings of the stages as plain lines on standard error, above a running bar."""

    def emit(self, record: logging.LogRecord) -> None:
        print(f"{record.levelname.lower()}: {record.getMessage()}", file=sys.stderr)


_WARNINGS = _Warnings(logging.WARNING)


def _fail(message: str, code: int = 2) -> int:
    """One line on stderr, whatever the message holds."""
    print("error:", " ".join(message.split()), file=sys.stderr)
    return code


def _interrupt(error: BaseException | None) -> BaseException | None:
    """The keyboard interrupt behind an error: click and Dr.Jit wrap it into exceptions of their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


def _options(*options: Callable) -> Callable:
    """Several click options as one decorator."""
    return lambda command: functools.reduce(lambda f, option: option(f), reversed(options), command)


_VARIANT = click.option("--variant", metavar="NAME", help="Mitsuba variant: llvm_ad_rgb or cuda_ad_rgb.")
_MEMORY = click.option("--memory-limit", metavar="SIZE", help="Refuse what takes more memory than this, such as 4GB.")
_JOB = _options(
    click.option("--preset", metavar="NAME", help="fast, balanced or best."),
    click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Override a config key; repeatable."),
    click.option("--fixed-shape", is_flag=True, help="Fit textures alone; no vertex moves."),
    click.option("--normal-only", is_flag=True, help="Fit the normal map alone."),
    click.option(
        "--skip",
        metavar="NAMES",
        multiple=True,
        help="Leave these as the first guess has them, such as kd,orm: shape, kd (base_color, opacity), "
        "orm (gamma, roughness, metallic), normal.",
    ),
    _MEMORY,
    _VARIANT,
)
_KEEP_UV = click.option("--keep-uv", is_flag=True, help="Refuse a mesh whose texture coordinates cannot be kept.")
_OUT = click.option("--out", "-o", metavar="FOLDER", help="Where the results go; by default out/NAME.")
_FRAMES = click.option(
    "--frames", metavar="FIRST:LAST[:STEP]", help="Part of a character's clip, in the frame numbers of its file."
)
_OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace the run that OUT holds.")
_DRY_RUN = click.option("--dry-run", is_flag=True, help="Say what would be done, its time and memory; write nothing.")
_TENSORBOARD = click.option("--tensorboard", is_flag=True, help="Also log for TensorBoard, into OUT/tensorboard.")
_RESUME = click.option("--resume", is_flag=True, help="Go on with the unfinished run that OUT holds.")
_QUIET = click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message="mi-simplify %(version)s")
def cli() -> None:
    """
    Turn a detailed 3D asset into a small textured mesh that looks the same.
    """


@cli.command()
@click.argument("asset")
@click.option("--triangles", "-n", type=click.IntRange(min=4), help="Triangle budget of the result.")
@click.option("--init", metavar="MESH", help="Start from this low-poly mesh file, or from a 'sphere'.")
@click.option(
    "--mode",
    type=click.Choice(["mesh", "cards", "auto"]),
    default="mesh",
    show_default=True,
    help="What the result is made of: one surface, textured cards for foliage, or what suits the asset.",
)
@_KEEP_UV
@_FRAMES
@click.option("--bind-pose-only", is_flag=True, help="Fit a character in its bind pose alone.")
@_OUT
@click.option("--config", metavar="YAML", help="Settings to start from.")
@_JOB
@_OVERWRITE
@_RESUME
@_TENSORBOARD
@_DRY_RUN
@_QUIET
def simplify(
    asset, triangles, init, mode, keep_uv, frames, bind_pose_only, out, config, settings, **options
) -> None:  # fmt: skip
    """
    Simplify ASSET: a model file, a Mitsuba scene, sample:relic for the embedded one, or package.module:function for
    an implicit surface.
    """
    initial: dict[str, Any] = {} if triangles is None else {"triangles": triangles}
    if init is not None:
        initial |= {"kind": "sphere", "mesh": None} if init == "sphere" else {"kind": "mesh", "mesh": init}
    if keep_uv:
        initial["keep_uv"] = True
    if mode != "mesh":
        if init is not None:
            raise click.UsageError(f"--mode {mode} makes a first guess of its own, so it does not go with --init")
        initial |= {"kind": _mode(mode, asset, triangles, config, settings, options)}
    chosen = {"asset": asset, "initial": initial, "animation": _animation(frames, bind_pose_only)}
    _run(config, out or _default_folder(asset), [*settings, chosen], **options)


def _animation(frames: str | None, bind_pose_only: bool = False) -> dict[str, Any]:
    """What the options say of a character."""
    out: dict[str, Any] = {} if frames is None else {"frames": frames}
    return out | ({"bind_pose_only": True} if bind_pose_only else {})


def _mode(mode: str, asset: str, triangles: int | None, config, settings, options) -> str:
    """The kind of first guess for a mode; says what was found where that decides."""
    if mode == "cards":
        return "cards"
    from .config import load_config

    given: dict[str, Any] = {} if triangles is None else {"initial": {"triangles": triangles}}
    wanted = load_config(config, [*settings, {"asset": asset}, given], options["preset"])
    _prepare(options["variant"])
    from .initial import is_aggregate
    from .subjects import open_subject

    why = is_aggregate(open_subject(wanted).geometry, wanted.initial.triangles or 3000)
    if not options["quiet"]:
        print(f"aggregate geometry: {why}: cards" if why else "no aggregate geometry: one surface")
    return "cards" if why else "decimate"


@cli.command()
@click.argument("asset")
@click.option("--triangles", "-n", metavar="N,N,…", required=True, help="Budgets, falling, such as 9000,3000,1000.")
@_OUT
@click.option("--config", metavar="YAML", help="Settings of every level.")
@click.option("--preset", metavar="NAME", help="fast, balanced or best.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Override a config key; repeatable.")
@click.option(
    "--threshold", type=click.FloatRange(0, 1, min_open=True), default=0.04, show_default=True,
    help="FLIP between two levels, over what they cover, below which a switch is not seen.",
)  # fmt: skip
@click.option("--msft-lod", is_flag=True, help="Also write lods.glb: all levels, with MSFT_lod.")
@click.option("--usd", is_flag=True, help="Also write lods.usda: all levels, with UsdLod and a variant set.")
@_VARIANT
@_OVERWRITE
@_QUIET
def lod(asset, triangles, out, config, preset, settings, threshold, msft_lod, usd, variant, overwrite, quiet) -> None:
    """
    Make a chain of levels of detail from ASSET, each for the size on the screen at which it takes over.
    """
    from .config import load_config
    from .errors import ConfigError

    try:
        budgets = [int(text) for text in triangles.split(",")]
    except ValueError:
        raise ConfigError(f"--triangles: '{triangles}' is no list of numbers such as 9000,3000,1000") from None
    chosen: dict[str, Any] = {"asset": asset} if variant is None else {"asset": asset, "variant": variant}

    def configure(keys):
        return load_config(config, [*settings, chosen, keys], preset)

    _prepare(configure({}).variant)
    from .jobs.chain import lod_job

    extras = [name for name, wanted in (("msft_lod", msft_lod), ("usd", usd)) if wanted]
    with _progress(quiet) as progress:
        chain = lod_job(
            configure, budgets, out or _default_folder(asset.removeprefix("sample:")), progress,
            threshold=threshold, extras=extras, overwrite=overwrite,
        )  # fmt: skip
    if not quiet:
        print(chain.summary())


@cli.command()
@click.argument("config")
@_OUT
@_JOB
@_OVERWRITE
@_RESUME
@_TENSORBOARD
@_DRY_RUN
@_QUIET
def run(config, out, settings, **options) -> None:
    """
    Run the job that the YAML file CONFIG describes.
    """
    _run(config, out or _default_folder(config), settings, **options)


def _default_folder(name: str) -> Path:
    """Of an asset: out/NAME; images are called as their folder is."""
    from .config import code_of

    name = code_of(name) or name.removeprefix("sample:")
    path = Path(name)
    return Path("out", path.absolute().parent.name if path.name.startswith("transforms") else path.stem)


def _run(
    config, out, overrides, *,
    preset, variant, fixed_shape, normal_only, skip, memory_limit, tensorboard, dry_run, overwrite, resume, quiet,
) -> None:  # fmt: skip
    from .config import load_config, without
    from .machine.memory import limited, parse_size

    chosen: dict[str, Any] = {} if variant is None else {"variant": variant}
    if tensorboard:
        chosen["export"] = {"tensorboard": True}
    if normal_only:
        chosen["latent"] = {"optimize": ["normal"]}
    names = [name.strip() for text in skip for name in text.split(",")] + ["shape"] * fixed_shape
    settings = without(load_config(config, [*overrides, chosen], preset), names)
    _prepare(settings.variant)
    from .jobs.forecast import forecast
    from .jobs.job import run_job

    job: Callable[..., Any] = forecast if dry_run else run_job
    with limited(parse_size(memory_limit) if memory_limit else None), _progress(quiet) as progress:
        result = job(settings, out, progress, overwrite=overwrite, resume=resume)
    if dry_run or not quiet:
        print(result.summary())


@cli.command()
@click.argument("reference")
@click.argument("lowpoly")
@_KEEP_UV
@_OUT
@click.option("--atlas-size", type=click.IntRange(16, 8192), default=1024, show_default=True, help="Texture side.")
@_VARIANT
@_OVERWRITE
@_QUIET
def bake(reference, lowpoly, keep_uv, out, atlas_size, variant, overwrite, quiet) -> None:
    """
    Bake the look of REFERENCE into textures for LOWPOLY, a mesh of yours in the same place.
    """
    _prepare(variant)
    from .jobs.job import bake_job

    with _progress(quiet) as progress:
        files = bake_job(
            reference, lowpoly, out or _default_folder(lowpoly), progress,
            keep_uv=keep_uv, atlas_size=atlas_size, variant=variant, overwrite=overwrite,
        )  # fmt: skip
    if not quiet:
        print("\n".join(str(path) for path in files.values()))


_JUDGED = _options(
    click.argument("reference"),
    click.argument("candidates", nargs=-1, required=True),
    click.option("--views", type=click.IntRange(1, 1024), default=8, show_default=True, help="Held-out views."),
    click.option("--resolution", type=click.IntRange(16, 8192), default=256, show_default=True, help="Side [px]."),
    click.option("--spp", type=click.IntRange(1, 65536), default=64, show_default=True, help="Samples per pixel."),
    click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Views and noise."),
    _FRAMES,
    _VARIANT,
    _OVERWRITE,
    _QUIET,
)


@cli.command()
@_JUDGED
@click.option("--out", "-o", metavar="FOLDER", help="Also write figures, pictures and the report there.")
def evaluate(**options) -> None:
    """
    Measure how much each of CANDIDATES looks like REFERENCE: PSNR, FLIP, silhouette error.
    """
    _judge(**options)


@cli.command()
@_JUDGED
@click.option("--out", "-o", metavar="FOLDER", required=True, help="Where report.html, figures and pictures go.")
def compare(**options) -> None:
    """
    Set CANDIDATES beside REFERENCE in a report: pictures with a divider, models in 3D, figures.
    """
    _judge(**options)
    if not options["quiet"]:
        print(Path(options["out"], "report.html"))


def _judge(reference, candidates, out, views, resolution, spp, seed, frames, variant, overwrite, quiet) -> None:
    _prepare(variant)
    from .jobs.job import evaluate_job, figure_rows
    from .report.evaluate import Judging

    with _progress(quiet) as progress:
        figures = evaluate_job(
            reference, candidates, out, progress,
            judging=Judging(views, resolution, spp, seed), animation=_animation(frames), variant=variant,
            overwrite=overwrite,
        )  # fmt: skip
    print("\n".join(figure_rows(figures)))


@cli.command()
@click.argument("out")
def report(out) -> None:
    """
    Build report.html again from what the folder OUT of a finished run or comparison holds.
    """
    _prepare(None)
    from .report import report_folder

    print(report_folder(out))


@cli.command()
@click.argument("asset")
@click.option("--out", "-o", metavar="IMAGE", required=True, help="A .png (sRGB) or .exr (linear) file.")
@click.option("--resolution", type=click.IntRange(16, 8192), default=512, show_default=True, help="Image side [px].")
@click.option("--spp", type=click.IntRange(1, 65536), default=64, show_default=True, help="Samples per pixel.")
@click.option("--azimuth", type=float, default=30.0, show_default=True, help="Camera direction around +Y [degrees].")
@click.option("--elevation", type=float, default=20.0, show_default=True, help="Camera height [degrees].")
@click.option("--frame", type=float, help="Frame of a character's clip, in the numbers of its file; else the first.")
@_VARIANT
def render(asset, out, resolution, spp, azimuth, elevation, frame, variant) -> None:
    """
    Render ASSET once: whatever simplify takes, or the asset of a YAML config under its transport.
    """
    from .config import load_config

    is_config = Path(asset).suffix.lower() in (".yaml", ".yml")
    named = [] if is_config else [{"asset": asset, "reference": {"transport": "baked"}}]
    config = load_config(asset if is_config else None, named)
    _prepare(variant or config.variant)
    from .record.output import check_writable
    from .report import portrait
    from .subjects import open_subject

    check_writable(portrait.check_picture_path(out))
    subject = open_subject(config)
    image = subject.picture(frame, spp=spp, resolution=resolution, azimuth=azimuth, elevation=elevation)
    portrait.save_picture(image, out)
    print(out)


@cli.command()
@click.argument("config")
@_OUT
@click.option("--instances", type=click.IntRange(1, 1_000_000), help="How many copies, instead of what CONFIG says.")
@click.option("--environment", metavar="HDR", help="Environment map, instead of what CONFIG says.")
@click.option("--gpu-instancing", is_flag=True, help="Also write the copies as GLB files (EXT_mesh_gpu_instancing).")
@_OVERWRITE
@_QUIET
def forest(config, out, instances, environment, gpu_instancing, overwrite, quiet) -> None:
    """
    Path trace thousands of copies of the plants in the YAML file CONFIG, and of their approximations.
    """
    from .config.forest import load_forest

    wanted = load_forest(config)
    changes = {"instances": instances, "environment": environment and str(Path(environment).resolve())}
    wanted = wanted.model_copy(update={key: value for key, value in changes.items() if value is not None})
    _prepare(None)
    from .jobs.forest import render_forest, summary

    folder = out or _default_folder(config)
    with _progress(quiet) as progress:
        figures = render_forest(wanted, folder, progress, gpu_instancing=gpu_instancing, overwrite=overwrite)
    if not quiet:
        print(summary(figures, folder))


@cli.command()
@click.option("--variant", metavar="NAME", help="Mitsuba variant to try.")
def doctor(variant) -> int:
    """
    Say what is installed, which LLVM is used, and whether a kernel runs.
    """
    from .machine.diagnosis import doctor as examine

    checks = examine(variant)
    for check in checks:
        mark = "ok" if check.ok else "FAIL" if check.required else "none"
        print(f"{mark:4}  {check.name:24}  {check.detail}")
    return 0 if all(check.ok for check in checks if check.required) else 2


@cli.command()
def version() -> None:
    """
    Print the version.
    """
    print(f"mi-simplify {__version__}")


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="JSON Schema, for editors, instead of Markdown.")
def config_schema(as_json) -> None:
    """
    Print every config key with its type, default and meaning.
    """
    from . import config

    if as_json:
        import json

        print(json.dumps(config.json_schema(), indent=2))
    else:
        print(config.markdown(), end="")


def _prepare(variant: str | None) -> None:
    """Set the variant before anything imports Dr.Jit, which would load whichever LLVM it finds."""
    from .machine.runtime import ensure_variant

    ensure_variant(variant)


def _progress(quiet: bool) -> Any:
    """The display that fits: none, a bar on a terminal, plain lines elsewhere."""
    from .display import Bar, Lines, Silent

    if quiet:
        return Silent()
    if sys.stdout.isatty():
        from rich.console import Console

        return Bar(Console())
    return Lines(functools.partial(print, flush=True))
