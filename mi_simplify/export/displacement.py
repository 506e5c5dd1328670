"""
A displaced model for renderers that tessellate: its base mesh, the map, and what the numbers of the map mean.
"""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdShade

from ..formats.gltf.write import write_glb
from ..machine.files import write_atomic
from ..model.model import Model


def write_displacement(model: Model, folder: Path, *, extras: dict | None = None) -> list[Path]:
    """
    Write ``base.glb``, ``base.usdc`` with UsdPreviewSurface's displacement, the map as ``height.exr`` [units of the
    model] and as ``height.png`` (16 bits, 0 the lowest and 65535 the highest), and ``displacement.json``.

    Parameters
    ----------
    model : Model
        With a displacement.
    folder : Path
        Which exists.
    extras : dict, optional
        Facts to keep with the files.

    Returns
    -------
    list of Path

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    from ..formats.usd.write import write_usd

    displacement = model.displacement
    assert displacement is not None
    height = np.asarray(displacement.height, np.float32)
    low, high = float(height.min()), float(height.max())
    levels = np.rint((height - low) / max(high - low, 1e-30) * 65535).astype(np.uint16)
    stream = io.BytesIO()
    Image.fromarray(levels).save(stream, "PNG")
    base = replace(model, displacement=None)
    facts = {
        "subdivisions": displacement.subdivisions, "fitted_for": list(displacement.fitted),
        "normals_of": displacement.framed, "low": low, "high": high, "png": "height.png", "exr": "height.exr",
        "rule": "split every triangle at the midpoints of its edges so many times, positions and normals interpolated, "
        "and move every vertex along its unit normal by what the map holds at its texture coordinate; the mean of all "
        "texture coordinates of a position along seams; the normal map belongs to the normals that the displaced mesh "
        "has after normals_of subdivisions, interpolated to finer ones",
    }  # fmt: skip
    return [
        write_glb(base, folder / "base.glb", extras={**(extras or {}), "displacement": facts}),
        write_usd(base, folder / "base.usdc", extras=extras),
        _with_displacement(folder / "base.usdc", low, high),
        write_atomic(folder / "height.png", stream.getvalue()),
        write_atomic(folder / "height.exr", lambda path: mi.Bitmap(height[..., None]).write(str(path))),
        write_atomic(folder / "displacement.json", json.dumps(facts, indent=2) + "\n"),
    ]


def _with_displacement(path: Path, low: float, high: float) -> Path:
    """The written layer with the map at the surface shader's displacement input."""

    def write(temporary: Path) -> None:
        layer = Sdf.Layer.CreateAnonymous()
        layer.TransferContent(Sdf.Layer.FindOrOpen(str(path)))
        stage = Usd.Stage.Open(layer)
        shader = next(p for p in stage.Traverse() if p.GetName() == "surface" and p.IsA(UsdShade.Shader))
        surface, parent = UsdShade.Shader(shader), shader.GetPath().GetParentPath()
        texture = UsdShade.Shader.Define(stage, parent.AppendChild("displacement"))
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath("./height.png"))
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("raw")
        texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(high - low))
        texture.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(low))
        for axis in ("wrapS", "wrapT"):
            texture.CreateInput(axis, Sdf.ValueTypeNames.Token).Set("repeat")
        reader = UsdShade.Shader.Get(stage, parent.AppendChild("st"))
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.GetOutput("result"))
        surface.CreateInput("displacement", Sdf.ValueTypeNames.Float).ConnectToSource(
            texture.CreateOutput("r", Sdf.ValueTypeNames.Float)
        )
        material = UsdShade.Material.Get(stage, parent)
        material.CreateDisplacementOutput().ConnectToSource(
            surface.CreateOutput("displacement", Sdf.ValueTypeNames.Token)
        )
        if not layer.Export(str(temporary)):
            raise OSError(0, "USD could not write the file")

    return write_atomic(path, write)
