"""
STL triangle soups, text and binary, welded.

The two bytes that follow a facet are nothing by the format, and a colour of five bits a channel by habit: VisCAM and
SolidView set bit 15 where it is one and have red on top, Materialise Magics sets it where it is none, has red at the
bottom, and a colour of the whole object in the header.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import MeshError
from ..model.asset import Asset, Instance, Material, Part
from ..model.color import srgb_to_linear
from ..model.topology import weld
from .images import constant
from .polygons import split_corners, unique_rows
from .resources import read_bytes

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> Asset:
    """
    Read an STL file as one part over welded positions; its facet normals repeat the winding and are dropped.

    Colours of facets, taken as sRGB, become vertex colours, and vertices are split where they differ.

    Raises
    ------
    MeshError
        The file is truncated, or holds no facets.
    """
    data = read_bytes(path, "STL file")
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else None
    colors = None
    is_binary = count is not None and len(data) == 84 + 50 * count
    if not is_binary and data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096].lower():
        corners = _read_text(data, path.name)
    elif count is not None and len(data) >= 84 + 50 * count:
        facets = np.frombuffer(data, _FACET, count, 84)
        corners, colors = facets["corners"].astype(np.float64), _colors(data[:80], facets["attribute"])
    elif count is not None:
        raise MeshError(
            f"{path.name}: the header promises {count} facets, the file holds {(len(data) - 84) // 50}; "
            "it is truncated, copy or export it again"
        )
    else:
        raise MeshError(f"{path.name}: this is no STL file, or it is cut off")
    if not len(corners):
        raise MeshError(f"{path.name}: there are no faces in it; export the file again")
    positions, index = weld(corners.reshape(-1, 3))
    part = Part(positions, index.reshape(-1, 3), name=path.stem)
    if colors is not None:
        values, of_facet = unique_rows(colors)
        of_corner = np.repeat(of_facet, 3)
        first, vertex = split_corners(index, of_corner)
        material = Material("facet colours", base_color=constant(1, 1, 1, 1))
        part = Part(
            positions[index[first]], vertex.reshape(-1, 3), colors=values[of_corner[first]].astype(np.float32),
            material=material, name=path.stem,
        )  # fmt: skip
    return Asset((part,), (Instance(0, name=path.stem),))


def _colors(header: bytes, attribute: np.ndarray) -> np.ndarray | None:
    """Linear colours of facets with opacity, shape (F, 4), or None where the file has none."""
    at = header.find(b"COLOR=")
    of_object = np.frombuffer(header[at + 6 : at + 10], np.uint8) if 0 <= at <= 70 else None
    flag = attribute >> 15 != 0
    bits = np.stack([attribute >> 10, attribute >> 5, attribute], axis=1) & 31
    rgb = srgb_to_linear(bits / 31)
    if of_object is None:  # VisCAM, SolidView
        has_color, rest = flag, Material().base_color[0, 0, :3]
    else:
        # Many writers fill in the header alone; by the letter all their facets were black.
        has_color = ~flag if attribute.any() else np.zeros(len(flag), bool)
        rgb, rest = rgb[:, ::-1], srgb_to_linear(of_object[:3] / 255)
    if of_object is None and not has_color.any():
        return None
    rgb = np.where(has_color[:, None], rgb, rest)
    return np.concatenate([rgb, np.ones((len(rgb), 1))], axis=1)


def _read_text(data: bytes, model: str) -> np.ndarray:
    """Corners, shape (F, 3, 3)."""
    lines = re.findall(rb"(?i)^[ \t]*vertex[ \t]+([^\r\n]*)", data, re.MULTILINE)
    try:
        values = np.fromstring(b" ".join(lines), np.float64, sep=" ")
        return values.reshape(-1, 3, 3)
    except ValueError as error:
        raise MeshError(f"{model}: a facet is incomplete or holds something that is no number; repair it") from error
