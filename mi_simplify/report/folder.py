"""
The report of a folder that a run or a comparison has written, from nothing but what lies in it.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..config import SAMPLE_PREFIX
from ..errors import OutputError, UserError
from ..formats.images import decode_image
from ..formats.load import load_asset
from ..formats.mitsuba.read import SceneAsset
from ..judging.comparison import Comparison, load_comparison
from ..model.asset import Asset
from ..scenes.samples.catalogue import sample_asset
from .html import write_report
from .viewer import MOST_TRIANGLES

log = logging.getLogger("mi_simplify")

PLAYER = "player.json"
"""What a report plays under a turning sky, in the folder ``transfer`` of a run."""

MOST_MODELS = 6
"""So many models are put into the page, which carries their textures."""


def report_folder(folder: str | Path, assets: Mapping[str, Asset] | None = None) -> Path:
    """
    Write ``report.html`` into a folder that holds ``metrics.json`` and ``views.npz``.

    ``config.yaml``, ``log.jsonl`` and the models are shown where they are there. Reference and candidates are read from
    the files that ``metrics.json`` names, or files of the same name in the folder.

    Parameters
    ----------
    folder : str or Path
    assets : mapping of str to Asset, optional
        Models by their name in ``metrics.json``, "reference" included, which then are not read again.

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        The folder holds no finished run, a file in it is damaged, or it cannot be written.
    AssetError, MeshError
        A model cannot be read.
    """
    folder = Path(folder)
    comparison = load_comparison(folder)
    figures, labels = comparison.figures, _labels(list(comparison.candidates))
    models = _models(figures, folder, assets or {})
    missing = [name for name in figures["candidates"] if name not in models and figures["candidates"][name].get("file")]
    if missing:
        log.warning("not shown in 3D, as too large or too many, or because the file is gone: %s", ", ".join(missing))
    return write_report(
        folder / "report.html",
        Comparison(
            comparison.reference,
            {labels[name]: images for name, images in comparison.candidates.items()},
            figures | {"candidates": {labels[name]: row for name, row in figures["candidates"].items()}},
        ),
        title=figures["reference"]["name"],
        models={labels.get(name, name): asset for name, asset in models.items()},
        settings=_text(folder / "config.yaml"),
        log=_log(folder / "log.jsonl"),
        maps=_displacement(folder / "displacement"),
        files=sorted(path for path in folder.iterdir() if path.name.startswith("model")),
        notes=figures.get("run", {}).get("notes", ()),
        player=_player(folder / "transfer" / PLAYER),
    )


def _labels(names: list[str]) -> dict[str, str]:
    """Candidates are named by their files: what tells these apart, without the folders that they have in common."""
    if not all(Path(name).suffix for name in names):
        return {name: name for name in names}
    places = [Path(name).absolute() for name in names]
    common = os.path.commonpath([place.parent for place in places])
    return {name: place.relative_to(common).as_posix() for name, place in zip(names, places, strict=True)}


def _models(figures: dict, folder: Path, assets: Mapping[str, Asset]) -> dict[str, Asset]:
    """Reference and candidates that can be shown, in this order; the last candidate comes first where it is tight."""
    rows = {"reference": figures["reference"], **figures["candidates"]}
    shown: dict[str, Asset] = {}
    left = MOST_TRIANGLES
    for name in sorted(rows, key=lambda name: name != list(rows)[-1]):
        if rows[name]["triangles"] > left or len(shown) == MOST_MODELS:
            continue
        asset = assets[name] if name in assets else _load(rows[name].get("file"), folder)
        if asset is not None and not isinstance(asset, SceneAsset):  # whose shapes need not be triangles
            shown[name] = asset
            left -= asset.n_triangles
    return {name: shown[name] for name in rows if name in shown}


def _load(source: str | None, folder: Path) -> Asset | None:
    """The model of a file, beside the report or where it was; None where there is none."""
    if source and source.startswith(SAMPLE_PREFIX):
        return sample_asset(source.removeprefix(SAMPLE_PREFIX))
    places = [folder / Path(source).name, Path(source)] if source else []
    return next((load_asset(path) for path in places if path.is_file()), None)


def _displacement(folder: Path) -> dict[str, np.ndarray]:
    """The map of a displaced model, from black to white; nothing where there is none."""
    if not (folder / "displacement.json").is_file():
        return {}
    try:
        facts = json.loads(_text(folder / "displacement.json"))
        height = decode_image((folder / "height.png").read_bytes(), "height.png", "the displacement map")
        label = f"displacement, {facts['low']:.3g} (black) to {facts['high']:.3g} (white)"
    except (UserError, OSError, ValueError, LookupError, TypeError):
        raise OutputError(f"{folder} is damaged; remove it to have a report without it") from None
    return {label: (height[..., 0] >> 8).astype(np.uint8)}


def _player(path: Path) -> dict | None:
    """What plays under a turning sky; None where there is nothing."""
    try:
        return json.loads(_text(path)) if path.is_file() else None
    except ValueError:
        raise OutputError(f"{path} is damaged; remove it to have a report without it") from None


def _text(path: Path) -> str:
    """What a file says, nothing where there is none."""
    try:
        return path.read_text(encoding="utf-8") if path.is_file() else ""
    except (OSError, UnicodeDecodeError):
        raise OutputError(f"{path} is damaged; remove it to have a report without it") from None


def _log(path: Path) -> list[dict]:
    """The records of a fit; a line that a full disk has cut off is left out, and that is said."""
    records = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        try:
            record = json.loads(line)
            records.append({"step": record["step"] + 0, "loss": record["loss"]} | record)
        except (ValueError, LookupError, TypeError):
            log.warning("%s, line %d is damaged and left out", path, number)
    return records
