"""
What a command needs around its work: the variant before it, a display while it runs.
"""

from __future__ import annotations

import functools
import sys
from typing import Any


def prepare(variant: str | None) -> None:
    """
    Set the variant before anything imports Dr.Jit, which would load whichever LLVM it finds.
    """
    from ..machine.runtime import ensure_variant

    ensure_variant(variant)


def display(quiet: bool) -> Any:
    """
    The display that fits: none, a bar on a terminal, plain lines elsewhere.
    """
    from ..display import Bar, Lines, Silent

    if quiet:
        return Silent()
    if sys.stdout.isatty():
        from rich.console import Console

        return Bar(Console())
    return Lines(functools.partial(print, flush=True))
