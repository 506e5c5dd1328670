"""
The commands that look at what is there: figures, reports, pictures.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from .console import display, prepare
from .options import FRAMES, OVERWRITE, QUIET, VARIANT, animation, combined

_JUDGED = combined(
    click.argument("reference"),
    click.argument("candidates", nargs=-1, required=True),
    click.option("--views", type=click.IntRange(1, 1024), default=8, show_default=True, help="Held-out views."),
    click.option("--resolution", type=click.IntRange(16, 8192), default=256, show_default=True, help="Side [px]."),
    click.option("--spp", type=click.IntRange(1, 65536), default=64, show_default=True, help="Samples per pixel."),
    click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Views and noise."),
    click.option(
        "--renderer",
        type=click.Choice(["mitsuba", "three"]),
        default="mitsuba",
        show_default=True,
        help="Mitsuba's path tracer, or three.js in an installed Chromium (extra `browser`, and npm's package three).",
    ),
    FRAMES,
    VARIANT,
    OVERWRITE,
    QUIET,
)


@click.command()
@_JUDGED
@click.option("--out", "-o", metavar="FOLDER", help="Also write figures, pictures and the report there.")
def evaluate(**options) -> None:
    """
    Measure how much each of CANDIDATES looks like REFERENCE: PSNR, FLIP, silhouette error.
    """
    _judge(**options)


@click.command()
@_JUDGED
@click.option("--out", "-o", metavar="FOLDER", required=True, help="Where report.html, figures and pictures go.")
def compare(**options) -> None:
    """
    Set CANDIDATES beside REFERENCE in a report: pictures with a divider, models in 3D, figures.
    """
    _judge(**options)
    if not options["quiet"]:
        print(Path(options["out"], "report.html"))


def _judge(
    reference, candidates, out, views, resolution, spp, seed, renderer, frames, variant, overwrite, quiet
) -> None:
    prepare(variant)
    from ..jobs.job import evaluate_job, figure_rows
    from ..judging.evaluate import Judging

    with display(quiet) as progress:
        figures = evaluate_job(
            reference, candidates, out, progress,
            judging=Judging(views, resolution, spp, seed, renderer), animation=animation(frames), variant=variant,
            overwrite=overwrite,
        )  # fmt: skip
    if not quiet and "renderer" in figures["settings"]:
        print(f"judged by {figures['settings']['renderer']}")
    print("\n".join(figure_rows(figures)))


@click.command()
@click.argument("out")
def report(out) -> None:
    """
    Build report.html again from what the folder OUT of a finished run or comparison holds.
    """
    prepare(None)
    from ..report import report_folder

    print(report_folder(out))


@click.command()
@click.argument("file")
@click.option("--json", "as_json", is_flag=True, help="JSON instead of lines.")
def inspect(file, as_json) -> None:
    """
    List what FILE, a model, holds: parts, materials, animation; what would be baked, kept, and left out.
    """
    from ..report.inventory import inventory, lines_of

    found = inventory(file)
    print(json.dumps(found, indent=2) if as_json else "\n".join(lines_of(found)))


@click.command()
@click.argument("asset")
@click.option("--out", "-o", metavar="IMAGE", required=True, help="A .png (sRGB) or .exr (linear) file.")
@click.option("--resolution", type=click.IntRange(16, 8192), default=512, show_default=True, help="Image side [px].")
@click.option("--spp", type=click.IntRange(1, 65536), default=64, show_default=True, help="Samples per pixel.")
@click.option("--azimuth", type=float, default=30.0, show_default=True, help="Camera direction around +Y [degrees].")
@click.option("--elevation", type=float, default=20.0, show_default=True, help="Camera height [degrees].")
@click.option("--frame", type=float, help="Frame of a character's clip, in the numbers of its file; else the first.")
@VARIANT
def render(asset, out, resolution, spp, azimuth, elevation, frame, variant) -> None:
    """
    Render ASSET once: whatever simplify takes, or the asset of a YAML config under its transport.
    """
    from ..config import load_config

    is_config = Path(asset).suffix.lower() in (".yaml", ".yml")
    named = [] if is_config else [{"asset": asset, "reference": {"transport": "baked"}}]
    config = load_config(asset if is_config else None, named)
    prepare(variant or config.variant)
    from ..record.output import check_writable
    from ..report import portrait
    from ..subjects import open_subject

    check_writable(portrait.check_picture_path(out))
    subject = open_subject(config)
    image = subject.picture(frame, spp=spp, resolution=resolution, azimuth=azimuth, elevation=elevation)
    portrait.save_picture(image, out)
    print(out)
