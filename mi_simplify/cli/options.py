"""
Options that several commands share, and what they stand for.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


class Triangles(click.ParamType):
    """
    A budget: a number, or a share of the asset's.
    """

    name = "triangles"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See click; as the configuration keeps it."""
        from ..config.amounts import triangles

        try:
            return triangles(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class ListOf(click.ParamType):
    """
    Values with commas between them.
    """

    def __init__(self, kind: click.ParamType):
        self.kind, self.name = kind, f"list of {kind.name}"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See click."""
        return value if isinstance(value, list) else [self.kind.convert(x, param, ctx) for x in value.split(",")]


def combined(*parts: Callable) -> Callable:
    """
    Several click options as one decorator.
    """
    return lambda command: functools.reduce(lambda f, option: option(f), reversed(parts), command)


VARIANT = click.option("--variant", metavar="NAME", help="Mitsuba variant: llvm_ad_rgb or cuda_ad_rgb.")
MEMORY = click.option("--memory-limit", metavar="SIZE", help="Refuse what takes more memory than this, such as 4GB.")
JOB = combined(
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
    click.option(
        "--time",
        "time_limit",
        metavar="TIME",
        help="End the fit after this long, such as 30s or 5min, best model by then.",
    ),
    click.option(
        "--evaluate",
        "judged",
        type=click.Choice(["quick", "full"]),
        default="quick",
        show_default=True,
        help="How closely the result is judged; full also sets quadric decimation beside it.",
    ),
    MEMORY,
    VARIANT,
)
GOALS = combined(
    click.option("--psnr", type=float, help="Instead of a budget: the least model of so many dB on held-out views."),
    click.option("--flip", type=float, help="Instead of a budget: the least model of at most this FLIP."),
    click.option(
        "--screen-size", type=float, help="Instead of a budget: the least model that looks the same at so many pixels."
    ),
)
PACKING = combined(
    click.option(
        "--compress",
        type=click.Choice(["none", "quantize", "meshopt"]),
        help="Geometry of the GLB file: exact, rounded to 8 and 16 bits, or compressed as well.",
    ),
    click.option(
        "--textures",
        type=click.Choice(["png", "jpeg", "webp", "ktx2"]),
        help="Images of the GLB file; ktx2 needs the program basisu.",
    ),
    click.option("--quality", type=click.IntRange(1, 100), help="Of images of colours that are not PNG; 90."),
    click.option(
        "--max-bytes",
        metavar="SIZE",
        help="Of the GLB file, such as 500kB: format, quality and sizes are chosen by what pictures lose.",
    ),
    click.option("--no-tangents", is_flag=True, help="Leave tangents out of the GLB file: 16 bytes a vertex."),
)
KEEP_UV = click.option("--keep-uv", is_flag=True, help="Refuse a mesh whose texture coordinates cannot be kept.")
BAKE_OCCLUSION = click.option(
    "--bake-occlusion", is_flag=True, help="Cast rays on the asset for its occlusion, which a small mesh has less of."
)
OUT = click.option("--out", "-o", metavar="FOLDER", help="Where the results go; by default out/NAME.")
FRAMES = click.option(
    "--frames", metavar="FIRST:LAST[:STEP]", help="Part of a character's clip, in the frame numbers of its file."
)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace the run that OUT holds.")
DRY_RUN = click.option("--dry-run", is_flag=True, help="Say what would be done, its time and memory; write nothing.")
TENSORBOARD = click.option("--tensorboard", is_flag=True, help="Also log for TensorBoard, into OUT/tensorboard.")
RESUME = click.option("--resume", is_flag=True, help="Go on with the unfinished run that OUT holds.")
QUIET = click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")


def budget(triangles: int | str | None, vertices: int | None) -> dict[str, Any]:
    """
    What the options say of the size of the result; each stands for the other, whatever a file says.
    """
    if triangles is not None and vertices is not None:
        raise click.UsageError("--triangles and --vertices are two budgets for one thing; name one of them")
    return {} if triangles is vertices is None else {"triangles": triangles, "vertices": vertices}


def sized(triangles: int | str | None, vertices: int | None, **goals: float | None) -> dict[str, dict[str, Any]]:
    """
    What the options say of the size of the result and of what it should reach, as sections of the configuration; each
    stands for all others, whatever a file says.
    """
    named, initial = [name for name, value in goals.items() if value is not None], budget(triangles, vertices)
    if len(named) + bool(initial) > 1:
        all_named = [*(["vertices" if triangles is None else "triangles"] if initial else []), *named]
        a, b = (f"--{name.replace('_', '-')}" for name in all_named[:2])
        raise click.UsageError(f"{a} and {b} both say how large the result is; name one of them")
    if not named:
        return {"initial": initial} | ({"goal": dict.fromkeys(goals)} if initial else {})
    return {"initial": {"triangles": None, "vertices": None}, "goal": goals}


def animation(frames: str | None, bind_pose_only: bool = False) -> dict[str, Any]:
    """
    What the options say of a character.
    """
    out: dict[str, Any] = {} if frames is None else {"frames": frames}
    return out | ({"bind_pose_only": True} if bind_pose_only else {})


def packing(*, no_tangents: bool, **stated: Any) -> dict[str, Any]:
    """
    What the options say of the GLB file: those of ``PACKING`` by name.
    """
    out = {name: value for name, value in stated.items() if value is not None}
    return out | ({"tangents": False} if no_tangents else {})


def default_folder(name: str) -> Path:
    """
    Of an asset: out/NAME; images are called as their folder is.
    """
    from ..config import code_of

    name = code_of(name) or name.removeprefix("sample:")
    path = Path(name)
    return Path("out", path.absolute().parent.name if path.name.startswith("transforms") else path.stem)
