"""
What a model file holds, and what becomes of it in a simplified one.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ..formats.gltf.file import GltfFile
from ..formats.load import load_asset
from ..model.asset import Asset, Material
from ..model.groups import is_see_through

#: What the textures of a material are called in lists, by field.
_TEXTURES = {
    "base_color": "base colour", "specular": "roughness and metalness", "normal": "normal map", "emission": "emission",
    "occlusion": "occlusion",
}  # fmt: skip


def inventory(path: str | Path) -> dict[str, Any]:
    """
    A list of what a model file holds, of plain values.

    Parameters
    ----------
    path : str or Path
        Any file that :func:`..formats.load.load_asset` reads.

    Returns
    -------
    dict
        ``triangles``, ``bounds``, ``parts``, ``nodes`` that can be kept, ``materials``, ``extensions`` (of glTF),
        ``animation``, ``metadata``; then
        ``baked``: what is painted into the textures of the result; ``kept``: what is carried over as it is; and
        ``left_out``: the reader's notes, one line each.

    Raises
    ------
    AssetError, MeshError, MemoryLimitError
        As of :func:`..formats.load.load_asset`.
    """
    asset = load_asset(path)
    materials = list({id(part.material): part.material for part in asset.parts}.values())
    placed = Counter(instance.part for instance in asset.instances)
    out: dict[str, Any] = {
        "file": Path(path).name,
        "triangles": asset.n_triangles,
        "bounds": np.round(asset.bounds, 9).tolist(),
        "parts": [
            {"name": part.name, "triangles": len(part.faces), "placed": placed[k], "material": part.material.name}
            for k, part in enumerate(asset.parts)
        ],
        "materials": [_described(material) for material in materials],
        "nodes": [] if asset.tree is None else asset.tree.paths(),
        "extensions": _extensions(Path(path)),
        "animation": None,
        "metadata": dict(asset.metadata),
    }
    if asset.rig is not None:
        rig = asset.rig
        clips = [name for name, _, _ in rig.clips]
        frames = {"clips": clips, "frames": rig.n_frames, "seconds": round(float(rig.times[-1]), 6)}
        out["animation"] = {"joints": len(rig.names), **frames}
    return out | {"baked": _baked(asset, materials), "kept": _kept(asset, materials), "left_out": list(asset.notes)}


def lines_of(found: dict[str, Any], most: int = 12) -> list[str]:
    """
    An inventory as lines for people; of long lists the first ``most`` entries.
    """
    low, high = found["bounds"]
    size = " x ".join(f"{b - a:.6g}" for a, b in zip(low, high, strict=True))
    out = [f"{found['file']}: {found['triangles']:,} triangles, {size}"]
    parts = [f"{p['name']} ({p['triangles']:,} triangles x {p['placed']}, {p['material']})" for p in found["parts"]]
    looks = [f"{m['name']} ({', '.join([m['alpha_mode'], *m['textures'], *m['lobes']])})" for m in found["materials"]]
    animation = found["animation"]
    moves = [] if animation is None else [f"{key} {value}" for key, value in animation.items()]
    lists = {
        "parts": parts, "nodes": found["nodes"], "materials": looks, "extensions": found["extensions"],
        "animation": moves,
        "baked": found["baked"], "kept": found["kept"], "left out, or not shown": found["left_out"],
    }  # fmt: skip
    for title, entries in lists.items():
        if not entries:
            continue
        out.append(f"{title} ({len(entries)})")
        out += [f"  {entry}" for entry in entries[:most]]
        if len(entries) > most:
            out.append(f"  and {len(entries) - most} more")
    return out


def _described(material: Material) -> dict[str, Any]:
    images = {field: getattr(material, field) for field in _TEXTURES}
    return {
        "name": material.name,
        "alpha_mode": material.alpha_mode,
        "double_sided": material.double_sided,
        "textures": {
            _TEXTURES[field]: f"{image.shape[1]} x {image.shape[0]}"
            for field, image in images.items()
            if image is not None and image.shape[0] * image.shape[1] > 1
        },
        "emission": material.emission is not None,
        "lobes": {name: dict(factors) for name, factors in material.lobes.items()},
    }


def _extensions(path: Path) -> list[str]:
    if path.suffix.lower() not in (".glb", ".gltf"):
        return []
    return sorted(str(name) for name in GltfFile(path, []).json.get("extensionsUsed") or ())


def _baked(asset: Asset, materials: list[Material]) -> list[str]:
    out = [name for field, name in _TEXTURES.items() if any(getattr(m, field) is not None for m in materials)]
    if any(part.colors is not None for part in asset.parts):
        out.append("vertex colours, into the base colour")
    if any(is_see_through(part) for part in asset.parts):
        out.append("opacity")
    return out


def _kept(asset: Asset, materials: list[Material]) -> list[str]:
    out = sorted({f"{name} of '{m.name}': its factors" for m in materials for name in m.lobes})
    modes = {m.alpha_mode for m in materials} - {"OPAQUE"}
    if modes:
        out.append(f"alpha modes: {', '.join(sorted(modes))}")
    if not all(m.double_sided for m in materials):
        out.append("backs that are not shown")
    targets = dict.fromkeys(morph.name for part in asset.parts for morph in part.morphs)
    if targets:
        out.append(f"morph targets: {', '.join(targets)}")
    if asset.rig is not None:
        joints = f"skeleton of {len(asset.rig.names)} joints"
        moving = joints if asset.tree is None else f"{len(asset.tree.moving)} animated nodes"
        out += [moving, *(f"clip '{name}'" for name, _, _ in asset.rig.clips)]
    return [*out, *(f"{key} of the file" for key in asset.metadata)]
