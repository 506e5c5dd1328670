"""Files out: glTF, OBJ, USD."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..errors import OutputError
from ..formats.gltf.write import write_glb as write_glb
from ..formats.load import load_asset
from ..formats.obj.write import write_obj as write_obj
from ..machine.files import make_folder
from ..model.asset import Asset
from ..model.model import Model
from .mips import write_mips
from .own_normals import with_own_normals

FORMATS = {"glb": "model.glb", "obj": "model.obj", "usd": "model.usdc"}
"""File name of each format that :func:`export_model` writes."""


def export_model(
    model: Model, folder: str | Path, *, formats: Sequence[str] = ("glb", "obj", "usd"), extras: dict | None = None
) -> dict[str, Path]:
    """
    Write a model in several formats into one folder, which is created where it is missing.

    Mip levels of the model's own go into ``mips/``: what these formats carry is the finest one alone.
    A displaced model is written as the fine mesh that it stands for; base mesh and map go into ``displacement/``. The
    fine mesh's normal map belongs to its own normals, the base mesh's to those that all tessellations share.

    Parameters
    ----------
    model : Model
    folder : str or Path
    formats : sequence of {'glb', 'obj', 'usd'}
    extras : dict, optional
        Facts to keep with the file (transport, versions): strings and numbers.

    Returns
    -------
    dict
        Format to path.

    Raises
    ------
    OutputError
        A format is unknown, or the folder or a file cannot be written.
    MeshError
        The mesh has no faces.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise OutputError(f"unknown export format {unknown[0]!r}: choose from {', '.join(FORMATS)}")
    folder = make_folder(folder)
    paths = {name: folder / FORMATS[name] for name in formats}
    if model.displacement is not None:
        from .displacement import write_displacement

        write_displacement(model, make_folder(folder / "displacement"), extras=extras)
    model = with_own_normals(model)
    if model.mips:
        write_mips(model, make_folder(folder / "mips"))
    for name, path in paths.items():
        if name == "glb":
            write_glb(model, path, extras=extras)
        elif name == "obj":
            write_obj(model, path)
        else:
            from ..formats.usd.write import write_usd  # usd-core takes half a second to load

            write_usd(model, path, extras=extras)
    return paths


def as_exported(model: Model) -> Asset:
    """
    A model as a reader of its GLB file sees it, its textures of 8 bits: FLIP tells them from what they were made of.

    Ambient light, which files do not carry, stays.
    """
    with tempfile.TemporaryDirectory() as folder:
        asset = load_asset(export_model(model, folder, formats=["glb"])["glb"])
    return replace(asset, name=model.name, ambient=model.ambient, source="")  # the file is gone
