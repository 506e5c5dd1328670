"""
The commands about the program itself.
"""

from __future__ import annotations

import click

from .. import __version__


@click.command()
@click.option("--variant", metavar="NAME", help="Mitsuba variant to try.")
@click.option("--explain", metavar="CONFIG", help="Say instead what each step of this job's fit computes anew.")
def doctor(variant, explain) -> int:
    """
    Say what is installed, which LLVM is used, and whether a kernel runs.
    """
    if explain is not None:
        return _explain(explain)
    from ..machine.diagnosis import doctor as examine

    checks = examine(variant)
    for check in checks:
        mark = "ok" if check.ok else "FAIL" if check.required else "none"
        print(f"{mark:4}  {check.name:24}  {check.detail}")
    return 0 if all(check.ok for check in checks if check.required) else 2


def _explain(path: str) -> int:
    """The stages of a step, and which of them are computed in each."""
    from ..config import load_config
    from .console import prepare

    config = load_config(path)
    prepare(config.variant)
    from ..fitting.stages import explained

    for name, is_computed, what in explained(config):
        print(f"{'every step' if is_computed else 'once':10}  {name:20}  {what}")
    return 0


@click.command()
def version() -> None:
    """
    Print the version.
    """
    print(f"mi-simplify {__version__}")


@click.command()
@click.option("--json", "as_json", is_flag=True, help="JSON Schema, for editors, instead of Markdown.")
def config_schema(as_json) -> None:
    """
    Print every config key with its type, default and meaning.
    """
    from .. import config

    if as_json:
        import json

        print(json.dumps(config.json_schema(), indent=2))
    else:
        print(config.markdown(), end="")
