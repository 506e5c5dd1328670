"""
The report of a run: one HTML file that opens anywhere, without a network and without scripts.

Every part is a ``<section>`` with an id, every picture a ``<figure>`` that says which view and column
it shows, and the figures stand once more as JSON in ``#report-data``: what a script would want to
build on later.
"""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from .. import __version__
from ..export.files import write_atomic
from ..export.textures import VISIBLE_GAMMA, encode_textures, png, to_8bit
from ..latent.model import Model
from .chart import line_chart
from .evaluate import Comparison
from .pictures import BLUE, DIFFERENCE_GAIN, RED, comparison_columns
from .style import CSS

TEXTURE_SIZE = 512
"""Texture sheets are embedded at most this large [pixels]; the files beside the report have all texels."""

FIGURES = {"psnr": ("PSNR", "{:.2f}", "dB", +1), "flip": ("FLIP", "{:.4f}", "", -1)}
FIGURES |= {"silhouette_error": ("silhouette error", "{:.4f}", "", -1)}
"""Name, format, unit, and the sign of better."""


def write_report(
    path: str | Path,
    comparison: Comparison,
    *,
    title: str,
    summary: str = "",
    model: Model | None = None,
    settings: Mapping | None = None,
    log: Sequence[Mapping] = (),
    files: Iterable[str | Path] = (),
    notes: Iterable[str] = (),
) -> Path:
    """
    Write ``report.html``.

    Parameters
    ----------
    path : str or Path
    comparison : Comparison
        Of :func:`.evaluate.compare_assets`; the last candidate is the result, the first one what it is set against.
    title, summary : str
        Heading, and a sentence below it.
    model : Model, optional
        Its textures are shown.
    settings : mapping, optional
        Resolved settings, shown as YAML; plain Python values.
    log : sequence of mapping
        Records with ``step`` and ``loss``, some with ``psnr`` [dB] and ``seconds``; the curves.
    files : iterable of path
        Written files, listed with their sizes.
    notes : iterable of str
        What was repaired or left out, one line each.

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    sections = [
        _cards(comparison.figures, log),
        _section("views", "Held-out views", _views(comparison), _views_hint(comparison.figures)),
        _section("figures", "Figures", _table(comparison.figures)),
        _section("curves", "Course of the fit", _curves(log)),
        _section("textures", "Textures", "" if model is None else _textures(model)),
        _section("notes", "Notes", _notes(notes)),
        _section("files", "Files", _files(files)),
        _section("settings", "Settings", _settings(settings)),
    ]
    lead = f'<p class="lead">{html.escape(summary)}</p>' if summary else ""
    page = f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{html.escape(title)}</title>
<style>{CSS}</style>
</head>
<body>
<main>
<header><p class="kind">mi_simplify report</p><h1>{html.escape(title)}</h1>{lead}</header>
{"".join(sections)}
<footer>Made by mi_simplify {html.escape(__version__)}. Everything is in this file, nothing is loaded.</footer>
</main>
<script type="application/json" id="report-data">{_json(comparison.figures)}</script>
</body>
</html>
"""
    return write_atomic(path, page)


def data_uri(image: np.ndarray) -> str:
    """An 8-bit image as a PNG data URI."""
    return "data:image/png;base64," + base64.b64encode(png(image)).decode()


def _json(value: object) -> str:
    """JSON that cannot end the script element that it stands in."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


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
        cards.append(_card("time of the fit", _duration(seconds[-1]), "", f"{log[-1]['step']:,} steps"))
    return f'<section id="summary" class="cards">{"".join(cards)}</section>\n'


def _card(name: str, value: str, unit: str, change: str) -> str:
    """One number; ``change`` is markup, the rest text."""
    unit = f" <small>{html.escape(unit)}</small>" if unit else ""
    return (
        f'<div class="card"><div class="name">{html.escape(name)}</div>'
        f'<div class="value">{html.escape(value)}{unit}</div><div class="change">{change}</div></div>'
    )


def _duration(seconds: float) -> str:
    """Seconds in words: 41 s, 3 min 05 s."""
    if seconds < 60:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def _views_hint(figures: Mapping) -> str:
    """What the pictures show; markup."""
    red, blue = (
        f'<i class="key" style="background:rgb({",".join(str(int(v)) for v in to_8bit(color))})"></i>'
        for color in (RED, BLUE)
    )
    s = figures["settings"]
    return (
        f"Path traced at {s['spp']} samples per pixel under a point light and a dim sky that the fit has not seen. "
        f"Difference × {DIFFERENCE_GAIN:g}:{red} too bright,{blue} too dim. "
        f"Coverage:{red} covered only by the candidate,{blue} only by the reference. "
        f"The last three columns are those of “{html.escape(list(figures['candidates'])[-1])}”."
    )


def _views(comparison: Comparison) -> str:
    """A grid of pictures: one row per view."""
    columns = comparison_columns(comparison.reference, comparison.candidates)
    small = ' style="image-rendering: pixelated"' if comparison.reference.shape[2] < 160 else ""
    cells = ['<div class="head"></div>', *(f'<div class="head">{html.escape(c.name)}</div>' for c in columns)]
    for view in range(len(comparison.reference)):
        cells.append(f'<div class="row">{view + 1}</div>')
        for column in columns:
            name = html.escape(column.name)
            caption = html.escape(column.captions[view]) if column.captions else ""
            cells.append(
                f'<figure data-view="{view}" data-column="{name}"><img alt="{name}, view {view + 1}"{small} '
                f'src="{data_uri(column.images[view])}"><figcaption>{caption}</figcaption></figure>'
            )
    return f'<div class="scroll"><div class="views" style="--columns:{len(columns)}">{"".join(cells)}</div></div>'


def _table(figures: Mapping) -> str:
    """All candidates, one row each."""
    heads = ["", "triangles", *(f"{name} [{unit}]" if unit else name for name, _, unit, _ in FIGURES.values())]
    rows = []
    for name, values in figures["candidates"].items():
        cells = [f"{values['triangles']:,}", *(p.format(values[k]) for k, (_, p, _, _) in FIGURES.items())]
        rows.append(f'<tr><th scope="row">{html.escape(name)}</th>{"".join(f"<td>{c}</td>" for c in cells)}</tr>')
    head = "".join(f'<th scope="col">{html.escape(h)}</th>' for h in heads)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _curves(log: Sequence[Mapping]) -> str:
    """Loss and PSNR over steps."""
    charts = []
    for key, heading, label, is_log in (
        ("loss", "Loss", "loss", True),
        ("psnr", "PSNR on a held-out view", "PSNR [dB]", False),
    ):
        points = [(r["step"], r[key]) for r in log if r.get(key) is not None]
        svg = (
            line_chart(*zip(*points, strict=True), x_label="step", y_label=label, log=is_log) if len(points) > 1 else ""
        )
        if svg:
            charts.append(f'<div class="chart" data-curve="{key}"><h3>{heading}</h3>{svg}</div>')
    return f'<div class="charts">{"".join(charts)}</div>' if charts else ""


def _textures(model: Model) -> str:
    """Sheets of what the files hold."""
    encoded = encode_textures(model)
    sheets = {"base colour": encoded.base_color[..., :3], "roughness": encoded.orm[..., 1]}
    sheets |= {"metallic": encoded.orm[..., 2], "normal": encoded.normal}
    if model.alpha_mode != "OPAQUE":
        sheets["opacity"] = encoded.base_color[..., 3]
    if np.max(model.specular[..., 0]) > VISIBLE_GAMMA:
        sheets["gamma"] = to_8bit(model.specular[..., 0])
    figures = []
    for name, sheet in sheets.items():
        height, width = sheet.shape[:2]
        picture = Image.fromarray(np.ascontiguousarray(sheet))
        picture.thumbnail((TEXTURE_SIZE, TEXTURE_SIZE), Image.Resampling.BOX)
        figures.append(
            f'<figure data-texture="{name}"><img alt="{name}" src="{data_uri(np.asarray(picture))}">'
            f"<figcaption>{name}, {width} × {height}</figcaption></figure>"
        )
    return f'<div class="textures">{"".join(figures)}</div>'


def _notes(notes: Iterable[str]) -> str:
    """A list of lines."""
    items = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    return f'<ul class="notes">{items}</ul>' if items else ""


def _files(files: Iterable[str | Path]) -> str:
    """Names and sizes of the files that are there."""
    rows = "".join(
        f"<tr><td>{html.escape(path.name)}</td><td>{path.stat().st_size / 1000:,.1f}</td></tr>"
        for path in map(Path, files)
        if path.is_file()
    )
    head = '<tr><th scope="col">file</th><th scope="col">kB</th></tr>'
    return f"<table><thead>{head}</thead><tbody>{rows}</tbody></table>" if rows else ""


def _settings(settings: Mapping | None) -> str:
    """Settings as YAML."""
    if not settings:
        return ""
    stream = io.StringIO()
    yaml.safe_dump(dict(settings), stream, sort_keys=False, allow_unicode=True)
    return f"<pre>{html.escape(stream.getvalue())}</pre>"
