"""
The commands about the program itself.
"""

from __future__ import annotations

import click

from .. import __version__


@click.command()
@click.option("--variant", metavar="NAME", help="Mitsuba variant to try.")
def doctor(variant) -> int:
    """
    Say what is installed, which LLVM is used, and whether a kernel runs.
    """
    from ..machine.diagnosis import doctor as examine

    checks = examine(variant)
    for check in checks:
        mark = "ok" if check.ok else "FAIL" if check.required else "none"
        print(f"{mark:4}  {check.name:24}  {check.detail}")
    return 0 if all(check.ok for check in checks if check.required) else 2


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
