"""
Several levels of detail in one file: glTF with MSFT_lod, USD with UsdLod and a variant set.
"""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pxr import Gf, Usd, UsdGeom, UsdLod, Vt

from ..machine.files import write_atomic

SCREEN = (1920, 1080)
"""Width and height of the screen that shares of it are reckoned for [pixels]."""


def coverage(size: float) -> float:
    """
    Share of the screen that a bounding sphere of this diameter [pixels] covers.
    """
    return min(1.0, 3.14159265 / 4 * size**2 / (SCREEN[0] * SCREEN[1]))


def join_glb(files: Sequence[Path], sizes: Sequence[float], path: Path) -> Path:
    """
    Put levels into one GLB by MSFT_lod: a viewer without it shows the finest.

    Parameters
    ----------
    files : sequence of Path
        GLB of one node each, the finest first, not compressed.
    sizes : sequence of float
        Diameter of the bounding sphere up to which each level but the first is meant to be seen [pixels].
    path : Path

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    joined: dict[str, Any] = {}
    data, roots = b"", []
    for file in files:
        document, binary = _read(file)
        roots.append(len(joined.get("nodes", [])) + document["scenes"][0]["nodes"][0])
        joined = _merged(joined, document, len(data))
        data += binary + bytes(-len(binary) % 4)
    joined["buffers"] = [{"byteLength": len(data)}]
    joined["scene"], joined["scenes"] = 0, [{"nodes": roots[:1]}]
    root = joined["nodes"][roots[0]]
    root["extensions"] = {"MSFT_lod": {"ids": roots[1:]}}
    # The least share of the screen at which each level is shown: of the last one, any.
    root["extras"] = {"MSFT_screencoverage": [*(coverage(size) for size in sizes), 0.0]}
    joined["extensionsUsed"] = sorted({*joined.get("extensionsUsed", ()), "MSFT_lod"})
    text = json.dumps(joined, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return write_atomic(path, struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _read(file: Path) -> tuple[dict, bytes]:
    """JSON and binary chunk of a GLB that we wrote."""
    content = file.read_bytes()
    n = struct.unpack_from("<I", content, 12)[0]
    return json.loads(content[20 : 20 + n]), content[28 + n :]


#: What refers to an entry of which list.
_REFERENCES = {
    "bufferView": "bufferViews", "mesh": "meshes", "material": "materials", "source": "images", "sampler": "samplers",
    "indices": "accessors", "index": "textures",
}  # fmt: skip
_LISTS = ("accessors", "bufferViews", "images", "materials", "meshes", "nodes", "samplers", "textures")


def _merged(one: dict, other: dict, offset: int) -> dict:
    """Two documents in one, the second one's buffer at ``offset`` of the first one's."""
    first = {name: len(one.get(name, ())) for name in _LISTS}
    other = copy.deepcopy(other)
    for view in other["bufferViews"]:
        view["byteOffset"] = view.get("byteOffset", 0) + offset

    def shifted(item):
        if isinstance(item, list):
            return [shifted(x) for x in item]
        if not isinstance(item, dict):
            return item
        out: dict[str, Any] = {}
        for key, value in item.items():
            if key in _REFERENCES and isinstance(value, int):
                out[key] = value + first[_REFERENCES[key]]
            elif key == "attributes":
                out[key] = {name: index + first["accessors"] for name, index in value.items()}
            elif key == "children":
                out[key] = [index + first["nodes"] for index in value]
            else:
                out[key] = shifted(value)
        return out

    joined = {**other, **one}
    for name in _LISTS:
        joined[name] = one.get(name, []) + shifted(other.get(name, []))
    for name in ("extensionsUsed", "extensionsRequired"):
        if both := {*one.get(name, ()), *other.get(name, ())}:
            joined[name] = sorted(both)
    return joined


def join_usd(files: Sequence[str], sizes: Sequence[float], bounds, path: Path) -> Path:
    """
    Refer to levels from one USD layer: children of a prim with LODRootAPI and a screen size heuristic.

    For what does not know UsdLod there is a variant set ``LOD``, each of whose variants holds one level alone, at first
    the finest; ``automatic`` has all of them and leaves the choice to the renderer.

    Parameters
    ----------
    files : sequence of str
        Paths of the levels' layers relative to this one, the finest first.
    sizes : sequence of float
        As of :func:`join_glb`.
    bounds : ndarray, shape (2, 3)
        Box of the finest level.
    path : Path
    """

    def build(temporary: Path) -> None:
        # In the folder of the file: references are looked up while they are made.
        stage = Usd.Stage.CreateNew(str(temporary))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/model").GetPrim())
        root = UsdGeom.Xform.Define(stage, "/model/levels")  # whose children are levels and nothing else
        heuristic = UsdLod.ScreenSizeHeuristic.Define(stage, "/model/screen_size")
        heuristic.CreateThresholdsAttr(Vt.FloatArray([size / SCREEN[1] for size in sizes]))
        heuristic.CreateProjectionMethodAttr(UsdLod.Tokens.projectedSphere)
        heuristic.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, corner)) for corner in bounds]))
        heuristic.CreateLodDomainAttr(UsdLod.Tokens.imaging)
        lod = UsdLod.RootAPI.Apply(root.GetPrim())
        lod.CreateLodDefaultIndexAttr(0)
        lod.CreateLodHeuristicsRel().SetTargets([heuristic.GetPath()])
        names = [f"lod{k}" for k in range(len(files))]
        for name, file in zip(names, files, strict=True):
            level = UsdGeom.Xform.Define(stage, root.GetPath().AppendChild(name))
            level.GetPrim().GetReferences().AddReference(f"./{file}")
        variants = root.GetPrim().GetVariantSets().AddVariantSet("LOD")
        for chosen in ("automatic", *names):
            variants.AddVariant(chosen)
            variants.SetVariantSelection(chosen)
            with variants.GetVariantEditContext():
                for name in names:
                    if chosen not in ("automatic", name):
                        stage.OverridePrim(root.GetPath().AppendChild(name)).SetActive(False)
        variants.SetVariantSelection(names[0])
        stage.Save()

    return write_atomic(path, build)
