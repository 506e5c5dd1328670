"""
The command that makes many things.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from .console import display
from .options import QUIET


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE…")
@click.option("--out", "-o", metavar="FOLDER", required=True, help="Where a folder for each asset and the page go.")
@click.option("--glob", "patterns", multiple=True, metavar="GLOB", help="Model files of a folder, such as '**/*.glb'.")
@click.option("--command", type=click.Choice(["simplify", "lod", "bake", "evaluate", "none"]), help="What is done.")
@click.option("--triangles", "-n", metavar="N", help="Budget of each, or budgets of lod.")
@click.option("--preset", metavar="NAME", help="fast, balanced or best.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Override a config key; repeatable.")
@click.option("--jobs", "-j", type=click.IntRange(min=1), help="How many run at once; by default one a core.")
@click.option("--threads", type=click.IntRange(min=1), default=1, show_default=True, help="Cores for each of them.")
@click.option("--address", metavar="HOST:PORT", help="A Ray cluster that runs, or 'auto'; by default this machine.")
@click.option("--memory", metavar="SIZE", help="What one asset may take at most, such as 4GB.")
@click.option("--timeout", type=click.FloatRange(min=0, min_open=True), help="What one asset may take at most [s].")
@click.option("--retries", type=click.IntRange(min=0), default=1, show_default=True, help="Of what failed by itself.")
@click.option("--fail-fast", is_flag=True, help="End with the first asset that fails.")
@click.option("--shard", metavar="I/N", default="1/1", help="Every N-th asset from the I-th on, for other schedulers.")
@QUIET
def batch(
    sources, out, patterns, command, triangles, preset, settings, jobs, threads, address, memory, timeout, retries,
    fail_fast, shard, quiet,
) -> int:  # fmt: skip
    """
    Simplify all models of SOURCE: folders, model files, and manifests in YAML, JSON or CSV.

    Run again, it goes on: what is done and unchanged is skipped, what is half done is resumed.
    """
    from ..config.layers import parse_override
    from ..errors import ConfigError
    from ..jobs.batch.batch import batch_job
    from ..jobs.batch.entries import read_entries
    from ..jobs.batch.work import Limits
    from ..machine.memory import parse_size

    found = re.fullmatch(r"(\d+)/(\d+)", shard)
    part = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= part[0] <= part[1]:
        raise ConfigError(f"--shard: expected I/N with I from 1 to N, such as 2/8, got '{shard}'")
    defaults: dict[str, Any] = {"command": command, "triangles": triangles, "preset": preset}
    defaults = {key: value for key, value in defaults.items() if value is not None}
    if settings:
        for text in settings:
            parse_override(text)
        defaults["set"] = {key.strip(): value for key, _, value in (text.partition("=") for text in settings)}
    entries = read_entries(sources, patterns, defaults)
    limits = Limits(None if memory is None else parse_size(memory), timeout, threads)
    with display(quiet) as progress:
        made = batch_job(
            entries, Path(out), progress, address=address, jobs=jobs, limits=limits, retries=retries,
            fail_fast=fail_fast, shard=part,
        )  # fmt: skip
    if not quiet:
        print(made.summary())
    return made.exit_code
