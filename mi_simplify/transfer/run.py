"""
Everything in one go: bake, train, judge, report; a run that was stopped goes on where it was.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from ..config.commands.transfer import TransferSettings
from ..errors import OutputError
from ..machine.files import write_atomic
from ..progress import ProgressCallback, silent
from ..record.output import check_writable
from .dataset import Dataset, bake, load_dataset
from .judge import judge
from .linear import LinearModel, fit_linear
from .network import Network, Training, train
from .page import write_page
from .sequences.opening import open_sequence

SETTINGS, DATA, NETWORK, FIGURES, PAGE = "settings.json", "data.npz", "network.onnx", "figures.json", "report.html"


def run_transfer(
    settings: TransferSettings, out: str | Path, progress: ProgressCallback = silent, *, overwrite: bool = False
) -> dict[str, Any]:
    """
    Bake, train, judge and report; what the folder holds of the same settings already is kept.

    Parameters
    ----------
    settings : TransferSettings
    out : str or Path
        Folder: ``data.npz``, ``network.onnx``, ``figures.json`` and ``report.html``.
    progress : callable
    overwrite : bool
        Begin anew.

    Returns
    -------
    dict
        What ``figures.json`` holds: see :func:`measured`.

    Raises
    ------
    OutputError
        The folder holds a run with other settings.
    """
    folder = Path(out)
    check_writable(folder / DATA)
    wanted = json.dumps(settings.model_dump(mode="json"), indent=2) + "\n"
    known = folder / SETTINGS
    if overwrite and known.exists():
        for name in (SETTINGS, DATA, NETWORK, FIGURES, PAGE, str(Path(NETWORK).with_suffix(".pt"))):
            (folder / name).unlink(missing_ok=True)
    if known.exists() and known.read_text(encoding="utf-8") != wanted:
        raise OutputError(f"{folder} holds a run with other settings; choose another -o, or --overwrite")
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(known, wanted)
    if not (folder / DATA).exists():
        _baked(settings, progress).save(folder / DATA)
    data = load_dataset(folder / DATA)  # as it is on disk, in half precision, so that a resumed run is the same one
    network = folder / NETWORK
    if not network.exists():
        wish = settings.train
        training = Training(size=wish.model, epochs=wish.epochs, minutes=wish.minutes, seed=wish.seed)
        train(data, network, training, progress, resume=network.with_suffix(".pt").exists())
    model, linear = Network(network), fit_linear(data)
    figures = measured(data, model, linear) | {"network_bytes": network.stat().st_size}
    write_atomic(folder / FIGURES, json.dumps(figures, indent=2) + "\n")
    write_page(folder / PAGE, data, {"network": model, "linear": linear}, figures, settings.shown, folder.name)
    return figures


def measured(data: Dataset, network: Network, linear: LinearModel) -> dict[str, Any]:
    """
    Figures of a network beside the linear model.

    Returns
    -------
    dict
        ``models``: of :func:`.judge.judge`; ``milliseconds`` of a frame by onnxruntime, median; ``history``: loss at
        the end of each epoch; ``numbers``: how many consist the linear model and all coefficients of the training
        frames of; ``image``: figures of the geometry image.
    """
    frames = data.held_out
    seconds = []
    for k in np.resize(frames, 20):
        start = time.perf_counter()
        network(data.positions[k : k + 1], data.normals[k : k + 1])
        seconds.append(time.perf_counter() - start)
    return {
        "models": judge(data, {"network": network, "linear": linear}),
        "milliseconds": 1e3 * float(np.median(seconds)),
        "history": network.history,
        "numbers": {"linear": linear.n_parameters, "coefficients": int(data.transfer[data.training].size)},
        "image": data.figures,
    }


def _baked(settings: TransferSettings, progress: ProgressCallback) -> Dataset:
    """The data that the settings describe."""
    b = settings.bake
    sequence = open_sequence(settings.source, b.frames, part=b.part, n_vertices=b.vertices, seed=b.seed)
    return bake(
        sequence, b.size, progress,
        close_holes=b.close_holes, order=b.order, n_directions=b.directions, bounces=b.bounces, albedo=b.albedo,
    )  # fmt: skip
