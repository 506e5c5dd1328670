"""
One page for all results of a batch: pictures, figures, what failed; to be sorted and searched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ... import __version__
from ...machine.files import write_atomic
from ...report.templates import render, script_hash, web_file
from .entries import Entry
from .ledger import Outcome
from .thumbnail import THUMBNAIL

PAGE = "index.html"

#: Rows that the page shows at first.
_MOST = 500


def write_overview(folder: Path, entries: Sequence[Entry], outcomes: Mapping[str, Outcome]) -> Path:
    """
    Write ``index.html``: a row for each entry, those that failed first, then from the worst PSNR up.

    Pictures stay files beside the page, so that a thousand entries are a page of some hundred kilobytes.
    """
    rows = [_row(folder, entry, outcomes.get(entry.name)) for entry in entries]
    rows.sort(key=lambda row: (row["rank"], row["psnr"] is None, row["psnr"] or 0.0, row["name"]))
    script = web_file("batch.js")
    counts = {state: sum(row["state"] == state for row in rows) for state in ("done", "failed", "waiting")}
    page = render(
        "batch.html",
        rows=rows,
        most=_MOST,
        counts=counts,
        style=Markup(web_file("style.css")),
        script=Markup(script),
        permitted=script_hash(script),
        version=__version__,
    )
    return write_atomic(folder / PAGE, str(page))


def _row(folder: Path, entry: Entry, outcome: Outcome | None) -> dict[str, Any]:
    state = "waiting" if outcome is None else "failed" if outcome.code else "done"
    figures = {} if outcome is None else outcome.figures
    out = folder / entry.name
    return {
        "name": entry.name,
        "asset": Path(entry.asset).name,
        "state": state,
        "rank": ("failed", "done", "waiting").index(state),
        "line": "" if outcome is None else outcome.line,
        "seconds": None if outcome is None else round(outcome.seconds, 1),
        "picture": f"{entry.name}/{THUMBNAIL}" if (out / THUMBNAIL).is_file() else "",
        "report": f"{entry.name}/report.html" if (out / "report.html").is_file() else "",
        **{key: figures.get(key) for key in ("triangles", "vertices", "bytes", "psnr", "flip")},
    }
