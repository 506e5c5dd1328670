"""
The program: its commands, and what becomes of errors.
"""

from __future__ import annotations

import logging
import sys
import traceback

import click

from .. import __version__
from ..errors import Defect, UserError
from .about import config_schema, doctor, version
from .batching import batch
from .faces import face
from .judging import compare, evaluate, inspect, render, report
from .making import bake, fit, forest, lod, run, simplify
from .transfer import transfer


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message="mi-simplify %(version)s")
def cli() -> None:
    """
    Turn a detailed 3D asset into a small textured mesh that looks the same.
    """


for _command in (
    simplify, fit, face, run, lod, bake, forest, batch, evaluate, compare, report, render, inspect, doctor, version,
    config_schema, transfer,
):  # fmt: skip
    cli.add_command(_command)


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
