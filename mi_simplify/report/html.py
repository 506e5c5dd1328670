"""
The report of a run: one HTML file that opens anywhere, without a network.

Every part is a ``<section>`` with an id, every picture a ``<figure>`` that says what it shows, and the figures stand
once more as JSON in ``#report-data``. The two scripts, ``web/page.js`` and ``web/viewer.js``, are in the page, which
permits no others and no connection; without them everything but divider and 3D view is still there.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..formats.textures import to_8bit
from ..judging.comparison import Comparison
from ..judging.pictures import BLUE, DIFFERENCE_GAIN, RED
from ..machine.files import write_atomic
from ..model.asset import Asset
from ..progress import in_words
from .chart import line_chart
from .embed import json_block, script_hash, web_file
from .gallery import MOST_VIEWS, divider, grid, left_out, pictures
from .viewer import texture_sheets, viewer_data

FIGURES = {"psnr": ("PSNR", "{:.2f}", "dB", +1), "flip": ("FLIP", "{:.4f}", "", -1)}
FIGURES |= {"silhouette_error": ("silhouette error", "{:.4f}", "", -1)}
"""Name, format, unit, and the sign of better."""


def _size(n_bytes: float) -> str:
    """Bytes in words: 3.4 MB."""
    return f"{n_bytes / 1e6:,.1f} MB" if n_bytes >= 1e6 else f"{n_bytes / 1e3:,.1f} kB"


COSTS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "triangles": ("triangles", "{:,}".format), "vertices": ("vertices", "{:,}".format),
    "texels": ("texels", "{:,}".format), "bytes": ("file", _size),
}  # fmt: skip
"""Heading and format of what a model costs."""


def write_report(path: str | Path, comparison: Comparison, **parts: Any) -> Path:
    """
    Write the page of :func:`report_page` into a file.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    return write_atomic(path, report_page(comparison, **parts))


def report_page(
    comparison: Comparison,
    *,
    title: str,
    summary: str = "",
    models: Mapping[str, Asset] | None = None,
    maps: Mapping[str, np.ndarray] | None = None,
    settings: str = "",
    log: Sequence[Mapping] = (),
    files: Iterable[str | Path] = (),
    notes: Iterable[str] = (),
) -> str:
    """
    The content of ``report.html``.

    Parameters
    ----------
    comparison : Comparison
        Of :func:`..judging.evaluate.compare_assets`; the last candidate is the result, the first one what it is set
        against.
    title, summary : str
        Heading, and a sentence below it.
    models : mapping of str to Asset, optional
        What turns in 3D, all in one frame; the last one is looked at first, and its textures are shown.
    maps : mapping of str to ndarray, optional
        8-bit pictures, shown with the textures under their names.
    settings : str
        As they stand in ``config.yaml``.
    log : sequence of mapping
        Records with ``step`` and ``loss``, some with ``psnr`` [dB] and ``seconds``; the curves.
    files : iterable of path
        Written files, listed with their sizes.
    notes : iterable of str
        What was repaired or left out, one line each.
    """
    models, figures, columns = models or {}, comparison.figures, pictures(comparison)
    names = list(comparison.candidates)
    beside = _section("side-by-side", "Side by side", divider(columns, len(names)), _DIVIDER_HINT)
    turning = _section("model", "In 3D", _viewer(models), _VIEWER_HINT)
    table = _section("figures", "Figures", _table(figures), _COSTS_HINT)
    is_fit = "run" in figures or len(names) < 2  # the last candidate is what all the others are for
    sections = [
        _cards(figures, log) if is_fit else table,
        f'<div class="pair">{beside}{turning}</div>',
        _section("views", "Held-out views", grid(columns, names), _views_hint(figures) + left_out(comparison)),
        *(
            _section("textures", f"Textures of {name}", texture_sheets(asset, maps or {}))
            for name, asset in [*models.items()][-1:]
        ),
        table if is_fit else "",
        _section("curves", "Course of the fit", _curves(log)),
        _section("notes", "Notes", _notes(notes)),
        _section("files", "Files", _files(files)),
        _section("settings", "Settings", f"<pre>{html.escape(settings)}</pre>" if settings else ""),
    ]
    scripts = [web_file("page.js"), *([web_file("viewer.js")] if models else [])]
    permitted = " ".join(map(script_hash, scripts))
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {permitted}"
    lead = f'<p class="lead">{html.escape(summary)}</p>' if summary else ""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<link rel="icon" href="data:,">
<title>{html.escape(title)}</title>
<style>
{web_file("style.css")}</style>
</head>
<body>
<main>
<header><p class="kind">mi_simplify report</p><h1>{html.escape(title)}</h1>{lead}</header>
{"".join(sections)}
<footer>Made by mi_simplify {html.escape(__version__)}. Everything is in this file, nothing is loaded.</footer>
</main>
<dialog id="enlarged" aria-label="enlarged picture"><img alt=""><p></p></dialog>
{json_block("report-data", figures)}{json_block("viewer-data", viewer_data(models)) if models else ""}\
{"".join(f"<script>{text}</script>{chr(10)}" for text in scripts)}</body>
</html>
"""


_COSTS_HINT = "A file’s size is its own; textures that a format keeps in files beside it come on top."
_DIVIDER_HINT = "Drag the divider, or use the arrow keys: left and right move it, up and down change the view."
_VIEWER_HINT = "Drag to turn, wheel or pinch to come closer; Shift or the right button moves the light."


#: What the 3D view shows, as ``web/viewer.js`` numbers it.
_MODES = {"shaded": 0, "shape alone": 5, "base colour": 1, "roughness": 2, "metallic": 3, "normals": 4}


def _viewer(models: Mapping[str, Asset]) -> str:
    """The canvas and what is chosen above it."""
    if not models:
        return ""
    labels = [f"{html.escape(name)}, {asset.n_triangles:,} triangles" for name, asset in models.items()]
    chosen = ["" for _ in labels[1:]] + [" selected"]
    names = "".join(f'<option value="{k}"{chosen[k]}>{label}</option>' for k, label in enumerate(labels))
    modes = "".join(f'<option value="{k}">{name}</option>' for name, k in _MODES.items())
    return (
        f'<div id="viewer"><div class="bar"><label>model <select name="model">{names}</select></label>'
        f'<label>show <select name="mode">{modes}</select></label>'
        '<label><input type="checkbox" name="wires"> triangles</label></div>'
        '<canvas tabindex="0" aria-label="the model in 3D"></canvas>'
        '<p class="none">The 3D view needs WebGL 2, which this browser has not or not switched on.</p></div>'
    )


def _section(name: str, heading: str, body: str, hint: str = "") -> str:
    """A section with a heading; nothing where there is no body."""
    if not body:
        return ""
    hint = f'<p class="hint">{hint}</p>' if hint else ""
    return f'<section id="{name}"><h2>{html.escape(heading)}</h2>{hint}{body}</section>\n'


def _cards(figures: Mapping, log: Sequence[Mapping]) -> str:
    """The four or five numbers that matter, with what they were before."""
    candidates = list(figures["candidates"].items())
    (first_name, first), (_, last) = candidates[0], candidates[-1]
    source = figures["reference"]["triangles"]
    cards = [
        _card("triangles", f"{last['triangles']:,}", "", f"of {source:,}, {100 * last['triangles'] / source:,.1f} %")
    ]
    for key, (name, pattern, unit, better) in FIGURES.items():
        change = ""
        if len(candidates) > 1:
            now, before = pattern.format(last[key]), pattern.format(first[key])
            kind = "same" if now == before else "good" if better * (last[key] - first[key]) > 0 else "bad"
            change = f'<span class="{kind}">{html.escape(first_name)}: {before}</span>'
        cards.append(_card(name, pattern.format(last[key]), unit, change))
    seconds = [r["seconds"] for r in log if r.get("seconds") is not None]
    if seconds:
        cards.append(_card("time of the fit", in_words(seconds[-1]), "", f"{log[-1]['step']:,} steps"))
    return f'<section id="summary" class="cards">{"".join(cards)}</section>\n'


def _card(name: str, value: str, unit: str, change: str) -> str:
    """One number; ``change`` is markup, the rest text."""
    unit = f" <small>{html.escape(unit)}</small>" if unit else ""
    return (
        f'<div class="card"><div class="name">{html.escape(name)}</div>'
        f'<div class="value">{html.escape(value)}{unit}</div><div class="change">{change}</div></div>'
    )


def _views_hint(figures: Mapping) -> str:
    """What the pictures show; markup."""
    red, blue = (
        f'<i class="key" style="background:rgb({",".join(str(int(v)) for v in to_8bit(color))})"></i>'
        for color in (RED, BLUE)
    )
    s = figures["settings"]
    lit = "under a point light and a dim sky that the fit has not seen" if "sky" in s else "in the light of the fit"
    frames = ", ".join(f"{code:g}" for code in s.get("frames", ())[:MOST_VIEWS])
    return (
        f"{'Path traced' if 'sky' in s else 'Rendered'} at {s['spp']} samples per pixel {lit}. "
        f"Difference × {DIFFERENCE_GAIN:g}: <span>{red} too bright</span>, <span>{blue} too dim</span>. "
        f"Coverage: <span>{red} only the candidate’s</span>, <span>{blue} only the reference’s</span>."
        + (f" The views are of frames {frames}." if frames else "")
    )


def _table(figures: Mapping) -> str:
    """The reference and all candidates, one row each: what they cost, and how alike they are."""
    heads = ["", *(head for head, _ in COSTS.values())]
    heads += [f"{name} [{unit}]" if unit else name for name, _, unit, _ in FIGURES.values()]
    rows = []
    for name, values in {"reference": figures["reference"], **figures["candidates"]}.items():
        cells = [form(values[key]) if values.get(key) is not None else "" for key, (_, form) in COSTS.items()]
        cells += [p.format(values[k]) if k in values else "" for k, (_, p, _, _) in FIGURES.items()]
        rows.append(f'<tr><th scope="row">{html.escape(name)}</th>{"".join(f"<td>{c}</td>" for c in cells)}</tr>')
    head = "".join(f'<th scope="col">{html.escape(h)}</th>' for h in heads)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _curves(log: Sequence[Mapping]) -> str:
    """Loss and PSNR over steps."""
    charts = []
    for key, heading, label, is_log in (
        ("loss", "Loss", "loss", True),
        ("psnr", "PSNR on held-out views", "PSNR [dB]", False),
    ):
        points = [(r["step"], r[key]) for r in log if r.get(key) is not None]
        svg = (
            line_chart(*zip(*points, strict=True), x_label="step", y_label=label, log=is_log) if len(points) > 1 else ""
        )
        if svg:
            charts.append(f'<div class="chart" data-curve="{key}"><h3>{heading}</h3>{svg}</div>')
    return f'<div class="charts">{"".join(charts)}</div>' if charts else ""


def _notes(notes: Iterable[str]) -> str:
    """A list of lines."""
    items = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    return f'<ul class="notes">{items}</ul>' if items else ""


def _files(files: Iterable[str | Path]) -> str:
    """Names and sizes of the files that are there."""
    rows = "".join(
        f"<tr><td>{html.escape(path.name)}</td><td>{_size(path.stat().st_size)}</td></tr>"
        for path in map(Path, files)
        if path.is_file()
    )
    head = '<tr><th scope="col">file</th><th scope="col">size</th></tr>'
    return f"<table><thead>{head}</thead><tbody>{rows}</tbody></table>" if rows else ""
