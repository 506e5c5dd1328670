"""Files out: glTF, OBJ, USD."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..config.schema import GlbSettings
from ..formats.gltf.write import glb_bytes
from ..formats.gltf.write import write_glb as write_glb
from ..formats.load import load_asset
from ..formats.obj.write import write_obj as write_obj
from ..formats.packing import TexturePacker
from ..formats.pixels.png import SOON
from ..machine.files import make_folder, write_atomic
from ..model.asset import Asset
from ..model.model import Model
from ..model.nodes.placing import expanded
from ..registry import Registry
from .mips import write_mips
from .own_normals import with_own_normals

Writer = Callable[[Model, Path, dict | None], object]


@dataclass(frozen=True)
class _Format:
    """The file that a format is written to, and what writes it."""

    file: str
    write: Writer


WRITERS: Registry[_Format] = Registry("export format (export.formats)")


def register_writer(name: str, file: str, write: Writer, *, replace: bool = False) -> None:
    """
    Make a format known to :func:`export_model` and ``export.formats``.

    Parameters
    ----------
    name : str
    file : str
        Name of its file in the folder of results.
    write : callable
        ``write(model, path, extras)``; what it cannot write it raises as ``OutputError``.

    Raises
    ------
    ValueError
        The name is taken.
    """
    WRITERS.register(name, _Format(file, write), replace=replace)


def _usd(model: Model, path: Path, extras: dict | None) -> None:
    from ..formats.usd.write import write_usd  # usd-core takes half a second to load

    write_usd(model, path, extras=extras)


register_writer("glb", "model.glb", lambda model, path, extras: write_glb(model, path, extras=extras))
register_writer("obj", "model.obj", lambda model, path, extras: write_obj(model, path))
register_writer("usd", "model.usdc", _usd)


def export_model(
    model: Model,
    folder: str | Path,
    *,
    formats: Sequence[str] = ("glb", "obj", "usd"),
    extras: dict | None = None,
    glb: GlbSettings = GlbSettings(),
) -> dict[str, Path]:
    """
    Write a model in several formats into one folder, which is created where it is missing.

    Mip levels of the model's own go into ``mips/``: what these formats carry is the finest one alone.
    A displaced model is written as the fine mesh that it stands for; base mesh and map go into ``displacement/``. The
    Nodes are kept in GLB files alone: others have one mesh with all instances. The
    fine mesh's normal map belongs to its own normals, the base mesh's to those that all tessellations share.

    Parameters
    ----------
    model : Model
    folder : str or Path
    formats : sequence of {'glb', 'obj', 'usd'}, or what is registered
    extras : dict, optional
        Facts to keep with the file (transport, versions): strings and numbers.
    glb : GlbSettings
        How the GLB file is packed.

    Returns
    -------
    dict
        Format to path.

    Raises
    ------
    ConfigError
        A format is unknown.
    OutputError
        The folder or a file cannot be written.
    MeshError
        The mesh has no faces.
    """
    files = {name: WRITERS[name].file for name in formats}
    folder = make_folder(folder)
    paths = {name: folder / file for name, file in files.items()}
    if model.displacement is not None:
        from .displacement import write_displacement

        write_displacement(model, make_folder(folder / "displacement"), extras=extras)
    model = with_own_normals(model)
    if model.mips:
        write_mips(model, make_folder(folder / "mips"))
    for name, path in paths.items():
        if name == "glb":
            write_glb(model, path, extras=extras, settings=glb)
        else:
            WRITERS[name].write(expanded(model), path, extras)
    return paths


def as_exported(model: Model) -> Asset:
    """
    A model as a reader of its GLB file sees it, its textures of 8 bits: FLIP tells them from what they were made of.

    Ambient light, which files do not carry, stays.
    """
    model = with_own_normals(model)
    with tempfile.TemporaryDirectory() as folder:
        textures = TexturePacker(model, SOON).pack(GlbSettings())
        asset = load_asset(write_atomic(Path(folder) / "model.glb", glb_bytes(model, textures=textures)))
    return replace(asset, name=model.name, ambient=model.ambient, source="")  # the file is gone
