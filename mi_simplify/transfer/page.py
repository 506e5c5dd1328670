"""
The report of a network: the object plays its frames under a sky that the viewer turns, from rays and from both models.

``report/web/transfer.html`` says how it looks, :mod:`.player` what its script draws. Pictures and curves
below are for those who only look.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from .. import __version__
from ..formats.textures import to_8bit
from ..judging.metrics import tonemap
from ..machine.files import write_atomic
from ..model.color import linear_to_srgb
from ..report.chart import line_chart
from ..report.embed import data_uri
from ..report.templates import render, script_hash, web_file
from .cast import unshadowed
from .dataset import Dataset
from .judge import Model
from .light import SKIES, sky
from .picture import Camera, seen
from .player import VIEW, Surface, player_data

#: Side of the pictures [px].
SIZE = 192


def write_page(
    path: str | Path, data: Dataset, models: Mapping[str, Model], figures: Mapping[str, Any], shown: int, title: str
) -> Path:
    """
    Write the page.

    Parameters
    ----------
    path : str or Path
    data : Dataset
    models : mapping of str to Model
        ``network`` and ``linear``.
    figures : mapping
        Of :func:`.run.measured`.
    shown : int
        Held-out frames in it; a frame at 64² takes about 350 kB.
    title : str

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    held = data.held_out
    frames = held[:shown]
    order = round(data.transfer.shape[2] ** 0.5) - 1
    errors = {name: _errors(data, model, held) for name, model in models.items()}
    transfers = {"rays": data.transfer[frames]}
    transfers |= {name: model(data.positions[frames], data.normals[frames]) for name, model in models.items()}
    script = web_file("webgl.js") + web_file("transfer.js")
    return write_atomic(
        path,
        render(
            "transfer.html",
            title=title,
            version=__version__,
            permitted=Markup(script_hash(script)),
            style=Markup(web_file("style.css")),
            rows=_pictures(data, frames, transfers, order),
            table=_table(figures),
            curves=_curves(figures, held, errors),
            data=player_data([Surface(data.positions[frames], data.faces, transfers)]),
            script=Markup(script),
        ),
    )


def _errors(data: Dataset, model: Model, frames: np.ndarray) -> np.ndarray:
    """Mean absolute error of each frame."""
    guess = model(data.positions[frames], data.normals[frames])
    return np.abs(guess - data.transfer[frames]).mean((1, 2))


def _pictures(data: Dataset, frames: np.ndarray, transfers: Mapping[str, np.ndarray], order: int) -> list[dict]:
    """One row a sky, one picture a model, of the frame in the middle."""
    k = len(frames) // 2
    hits = seen(data.positions[frames[k]], data.faces, Camera.around(data.positions[frames], *VIEW), SIZE)
    shown = {name: t[k] for name, t in transfers.items()}
    shown["no shadows"] = unshadowed(data.normals[frames[k]], order, data.albedo)
    rows = []
    for name in SKIES:
        light = sky(name, order)
        truth = hits.shaded(shown["rays"], light)
        cells = []
        for who, transfer in shown.items():
            radiance = hits.shaded(transfer, light)
            image = to_8bit(linear_to_srgb(np.clip(radiance[..., :3], 0, 1)))
            error = float(((tonemap(radiance) - tonemap(truth))[hits.covered] ** 2).mean()) if hits.covered.any() else 0
            text = "" if who == "rays" else f"{-10 * np.log10(max(error, 1e-10)):.1f} dB"
            cells.append({"name": who, "uri": data_uri(image), "text": text})
        rows.append({"sky": name, "cells": cells})
    return rows


def _table(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Error and size of every model."""
    sizes = {
        "network": figures["network_bytes"],
        "linear": 4 * figures["numbers"]["linear"],
        "rays, all training frames": 4 * figures["numbers"]["coefficients"],
    }
    rows = []
    for name in (*figures["models"], "rays, all training frames"):
        own = figures["models"].get(name)
        errors = [f"{own['l1']:.5f}", f"{own['psnr']:.2f}"] if own else ["", ""]
        rows.append((name, [*errors, f"{sizes[name] / 1e6:.2f}" if name in sizes else ""]))
    return {"heads": ["", "L1 of coefficients", "PSNR [dB]", "size [MB]"], "rows": rows}


def _curves(figures: Mapping[str, Any], held: np.ndarray, errors: Mapping[str, np.ndarray]) -> list[dict[str, Any]]:
    """Course of the training, and the error of each held-out frame."""
    history = figures["history"]
    out = []
    if history:
        svg = line_chart(range(1, len(history) + 1), history, x_label="epoch", y_label="L1", log=True)
        out.append({"key": "loss", "heading": "L1 on frames set aside in training", "svg": svg})
    for name, values in errors.items():
        svg = line_chart(range(len(held)), values.tolist(), x_label="held-out frame", y_label="L1")
        out.append({"key": f"error-{name}", "heading": f"L1 of held-out frames: {name}", "svg": svg})
    return out
