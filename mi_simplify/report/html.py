"""
The report of a run: one HTML file that opens anywhere, without a network.

This module says what is in it, ``web/report.html`` how it looks. Every part is a ``<section>`` with an id, every
picture a ``<figure>`` that says what it shows, and the figures stand once more as JSON in ``#report-data``. The
scripts, ``page.js``, ``viewer.js``, ``layout.js`` and ``transfer.js`` of ``web``, are in the page, which permits no
others and no connection; without them everything but divider, 3D view, UV layout and player is still there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from .. import __version__
from ..formats.textures import to_8bit
from ..judging.comparison import Comparison
from ..judging.normal_maps import FIGURE as NORMALS
from ..judging.pictures import BLUE, DIFFERENCE_GAIN, RED
from ..machine.files import write_atomic
from ..model.asset import Asset
from ..progress import in_words
from .chart import line_chart
from .gallery import MOST_VIEWS, divider, grid, left_out, pictures
from .templates import render, script_hash, web_file
from .viewer import texture_sheets, viewer_data

FIGURES = {"psnr": ("PSNR", "{:.2f}", "dB", +1), "flip": ("FLIP", "{:.4f}", "", -1)}
FIGURES |= {"silhouette_error": ("silhouette error", "{:.4f}", "", -1)}
FIGURES |= {NORMALS: ("normal map's dissimilarity", "{:.5f}", "", -1)}
"""Name, format, unit, and the sign of better."""


def _size(n_bytes: float) -> str:
    """Bytes in words: 3.4 MB."""
    return f"{n_bytes / 1e6:,.1f} MB" if n_bytes >= 1e6 else f"{n_bytes / 1e3:,.1f} kB"


COSTS: dict[str, tuple[str, Callable[[Any], str], int]] = {
    "triangles": ("triangles", "{:,}".format, -1), "vertices": ("vertices", "{:,}".format, -1),
    "charts": ("charts", "{:,}".format, -1), "fill": ("atlas filled", "{:.0%}".format, +1),
    "texels": ("texels", "{:,}".format, -1), "bytes": ("file", _size, -1),
}  # fmt: skip
"""Heading and format of what a model costs, and the sign of better."""

MODES = {"shaded": 0, "shape alone": 5, "base colour": 1, "roughness": 2, "metallic": 3, "normals": 4}
"""What the 3D view shows, as ``web/viewer.js`` numbers it."""


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
    player: Mapping[str, Any] | None = None,
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
    player : mapping, optional
        Surfaces with transfer coefficients, which play under a turning sky: see ``web/transfer.js``.
    """
    models, figures, columns = models or {}, comparison.figures, pictures(comparison)
    names, turning = list(comparison.candidates), viewer_data(models) if models else {}
    is_fit = "run" in figures or len(names) < 2  # the last candidate is what all the others are for
    drawing = [*(["viewer.js", "layout.js"] if models else []), *(["transfer.js"] if player else [])]
    scripts = [web_file("page.js"), *(["".join(map(web_file, ["webgl.js", *drawing]))] if drawing else [])]
    return render(
        "report.html",
        title=title,
        summary=summary,
        version=__version__,
        permitted=Markup(" ".join(map(script_hash, scripts))),
        style=Markup(web_file("style.css")),
        cards=_cards(figures, log) if is_fit else [],
        divider=divider(columns, right=len(names)),
        models=turning.get("models", []),
        clip=turning.get("clip"),
        modes=MODES,
        shown=_shown(figures) | {"left_out": left_out(comparison)},
        grid=grid(columns, names),
        textures=texture_sheets([*models.values()][-1], maps or {}) if models else [],
        table=_table(figures),
        player=player,
        carried=_carried(figures),
        curves=_curves(log),
        notes=list(notes),
        files=[(path.name, _size(path.stat().st_size)) for path in map(Path, files) if path.is_file()],
        settings=settings,
        data={"report-data": figures}
        | ({"viewer-data": turning} if models else {})
        | ({"player-data": player} if player else {}),
        scripts=[Markup(script) for script in scripts],
    )


def _cards(figures: Mapping, log: Sequence[Mapping]) -> list[dict[str, str]]:
    """The numbers that matter, with what they were before, and what the result costs beside the asset."""
    candidates = list(figures["candidates"].items())
    (first_name, first), (_, last) = candidates[0], candidates[-1]
    source = figures["reference"]["triangles"]
    share = f"of {source:,}, {100 * last['triangles'] / source:,.1f} %"
    cards = [{"name": "triangles", "value": f"{last['triangles']:,}", "unit": "", "verdict": "", "note": share}]
    for key, (head, shown, better) in list(COSTS.items())[1:]:
        now, before = last.get(key), figures["reference"].get(key)
        if now is None:
            continue
        verdict, note = "", ""
        if before is not None:
            verdict = "same" if now == before else "good" if better * (now - before) > 0 else "bad"
            note = f"asset: {shown(before)}"
        cards.append({"name": head, "value": shown(now), "unit": "", "verdict": verdict, "note": note})
    for key, (name, pattern, unit, better) in FIGURES.items():
        if key not in first or key not in last:
            continue
        now, before, verdict, note = pattern.format(last[key]), pattern.format(first[key]), "", ""
        if len(candidates) > 1:
            verdict = "same" if now == before else "good" if better * (last[key] - first[key]) > 0 else "bad"
            note = f"{first_name}: {before}"
        cards.append({"name": name, "value": now, "unit": unit, "verdict": verdict, "note": note})
    seconds = [r["seconds"] for r in log if r.get("seconds") is not None]
    if seconds:
        steps = f"{log[-1]['step']:,} steps"
        cards.append(
            {"name": "time of the fit", "value": in_words(seconds[-1]), "unit": "", "verdict": "", "note": steps}
        )
    return cards


def _shown(figures: Mapping) -> dict:
    """How the pictures were made, and what their colours mean."""
    settings = figures["settings"]
    red, blue = ([int(v) for v in to_8bit(color)] for color in (RED, BLUE))
    frames = ", ".join(f"{code:g}" for code in settings.get("frames", ())[:MOST_VIEWS])
    return {
        "sky": "sky" in settings, "spp": settings["spp"], "gain": f"{DIFFERENCE_GAIN:g}", "red": red, "blue": blue,
        "frames": frames, "renderer": settings.get("renderer", ""),
    }  # fmt: skip


def _table(figures: Mapping) -> dict:
    """The reference and all candidates, one row each: what they cost, and how alike they are."""
    heads = ["", *(head for head, _, _ in COSTS.values())]
    measured = {k: v for k, v in FIGURES.items() if any(k in row for row in figures["candidates"].values())}
    heads += [f"{name} [{unit}]" if unit else name for name, _, unit, _ in measured.values()]
    rows = []
    for name, values in {"reference": figures["reference"], **figures["candidates"]}.items():
        cells = [form(values[key]) if values.get(key) is not None else "" for key, (_, form, _) in COSTS.items()]
        cells += [p.format(values[k]) if k in values else "" for k, (_, p, _, _) in measured.items()]
        rows.append((name, cells))
    return {"heads": heads, "rows": rows}


def _carried(figures: Mapping) -> dict | None:
    """How close transfer in textures comes to rays, and what it would be without; nothing where there is none."""
    own = figures.get("run", {}).get("transfer")
    if own is None:
        return None
    asset, places = own["psnr"]["asset"], own["psnr"]["places"]
    rows = [(name, [f"{asset[name]:.2f}", f"{places[name]:.2f}", _size(own["bytes"][name])]) for name in asset]
    return {"heads": ["", "PSNR, asset [dB]", "PSNR, same places [dB]", "size"], "rows": rows}


def _curves(log: Sequence[Mapping]) -> list[dict[str, str]]:
    """Loss, PSNR and what else the log has over steps."""
    curves = []
    for key, heading, label, is_log in (
        ("loss", "Loss", "loss", True),
        ("psnr", "PSNR on held-out views", "PSNR [dB]", False),
        (NORMALS, "Normal map", "dissimilarity", True),
    ):
        points = [(r["step"], r[key]) for r in log if r.get(key) is not None]
        if len(points) > 1:
            svg = line_chart(*zip(*points, strict=True), x_label="step", y_label=label, log=is_log)
            curves += [{"key": key, "heading": heading, "svg": svg}] if svg else []
    return curves
