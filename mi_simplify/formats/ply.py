"""
PLY meshes, text and binary of either byte order, with UVs per vertex or per corner and vertex colours.

Rows of lists have no fixed size, so that where a row begins is known only after the one before it. All possible
beginnings are followed at once: from ``next(i)``, the end of a row that would begin at i, ``next(next(i))`` and so on
by doubling.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import MeshError
from ..machine import memory
from ..model.asset import Asset, Instance, Material, Part
from ..model.color import srgb_to_linear
from .images import constant, join_channels, rgb, to_float
from .polygons import split_corners, unique_rows
from .resources import Resources, read_bytes
from .triangulate import triangulate
from .validate import check_indices

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip

_COLOR_NAMES = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))


def read_ply(path: Path) -> Asset:
    """
    Read a PLY file as one part.

    Colours are sRGB, as scanners and editors write them; a texture comes from ``comment TextureFile``.

    Raises
    ------
    MeshError
        The header is none, the data ends early, or indices are out of range.
    """
    notes: list[str] = []
    resources = Resources(path, notes)
    data = read_bytes(path, "PLY file")
    elements, body, textures = _header(data, path.name)
    for element in elements.values():
        body = element.read(body, path.name)
    vertex, face = elements.get("vertex"), elements.get("face")
    if vertex is None or not {"x", "y", "z"} <= set(vertex.columns):
        raise MeshError(f"{path.name}: the file has no vertices; export it again")
    lists = face.lists if face else {}
    indices = lists.get("vertex_indices", lists.get("vertex_index"))
    if indices is None:
        strips = " (it holds triangle strips; export triangles)" if "tristrips" in elements else ""
        raise MeshError(f"{path.name}: there are no faces in it{strips}; points alone cannot be rendered")
    counts, flat = indices
    if not (np.abs(flat.astype(np.float64)) < 2.0**53).all():
        raise MeshError(f"{path.name}: a face refers to a vertex by something that is no index; repair it")
    flat = flat.astype(np.int64)
    vertices = np.stack([vertex.columns[k] for k in "xyz"], axis=1).astype(np.float64)
    check_indices(flat, len(vertices), path.name, path.stem)
    normals = _columns(vertex, ("nx", "ny", "nz"))
    colors = _colors(vertex)
    face_colors = _colors(face) if face else None
    if colors is not None and face_colors is not None:
        resources.note("colours of faces were left out: the vertices have colours, too")
        face_colors = None
    uvs = next((uv for names in _UV_NAMES if (uv := _columns(vertex, names)) is not None), None)
    keep, columns = flat, [flat]
    wedge, wedge_uvs = lists.get("texcoord"), None
    if wedge is not None and (wedge[0] == 2 * counts).all():
        wedge_uvs, index = unique_rows(wedge[1].reshape(-1, 2).astype(np.float64))
        columns.append(index)
    if face_colors is not None:
        face_values, index = unique_rows(face_colors)
        columns.append(np.repeat(index, counts))
    corners, polygon = triangulate(vertices, flat, counts, path.name)
    if not len(corners):
        raise MeshError(f"{path.name}: there are no faces in it; points alone cannot be rendered")
    first, corner_vertex = split_corners(*(c[corners.reshape(-1)] for c in columns))
    chosen = corners.reshape(-1)[first]
    keep = flat[chosen]
    if wedge_uvs is not None:
        uvs = wedge_uvs[columns[1][chosen]]
    elif uvs is not None:
        uvs = uvs[keep]
    if colors is not None:
        colors = colors[keep]
    elif face_colors is not None:
        colors = face_values[columns[-1][chosen]]
    material = _material(textures, uvs, colors, resources)
    part = Part(
        vertices[keep], corner_vertex.reshape(-1, 3),
        normals=None if normals is None else normals[keep],
        uvs=None if uvs is None else np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1),
        colors=colors,
        material=material, name=path.stem,
    )  # fmt: skip
    return Asset((part,), (Instance(0, name=path.stem),), notes=tuple(notes))


def _material(textures: list[str], uvs, colors, resources: Resources) -> Material:
    if textures and uvs is not None:
        if len(textures) > 1:
            resources.note(f"only the first of {len(textures)} textures is used: '{textures[0]}'")
        image = to_float(rgb(resources.image(textures[0])), srgb=True)
        return Material("texture", base_color=join_channels(image, constant(1)))
    # Vertex colours multiply the base colour, so they want a white one.
    if colors is None:
        return Material()
    mode = "BLEND" if 0 < colors[:, 3].mean() < 1 else "OPAQUE"
    return Material("vertex colours", base_color=constant(1, 1, 1, 1), alpha_mode=mode)


@dataclass
class _Element:
    """One element of the header, and its data once read."""

    n: int
    order: str
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)  # name, type, type of the list's count
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    lists: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # counts, values end to end

    def read(self, body: np.ndarray, model: str) -> np.ndarray:
        """Take this element's rows off the body, uint8 bytes or, of a text file, float64 numbers; return the rest."""
        if not self.n or not self.properties:
            return body
        text = body.dtype == np.float64
        n_min = sum(1 if text else np.dtype(_TYPES[c or t]).itemsize for _, t, c in self.properties)
        if self.n * n_min > len(body):
            raise _truncated(model)
        ends = self._constant_rows(body, text)
        if ends is None:
            ends = self._ragged_rows(body, text, model)
        begins = np.concatenate([[0], ends[:-1]])
        self._take(body, begins, text)
        return body[ends[-1] :]

    def _size(self, type_name: str, text: bool) -> int:
        return 1 if text else np.dtype(_TYPES[type_name]).itemsize

    def _value(self, body: np.ndarray, at: np.ndarray, type_name: str, text: bool) -> np.ndarray:
        """The numbers that begin at places of the body."""
        if text:
            return body[at]
        dtype = np.dtype(self.order + _TYPES[type_name])
        return body[at[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]

    def _follow(self, body: np.ndarray, at: np.ndarray, text: bool, visit=None) -> np.ndarray:
        """Ends of the rows that would begin at ``at``; places beyond the body stay beyond it."""
        last = len(body)
        for name, type_name, count_type in self.properties:
            if count_type is None:
                if visit:
                    visit(name, at, None)
                at = at + self._size(type_name, text)
                continue
            inside = at + self._size(count_type, text) <= last
            counts = np.zeros(len(at), np.int64)
            declared = self._value(body, at[inside], count_type, text)
            counts[inside] = np.clip(np.nan_to_num(declared), 0, last).astype(np.int64)
            at = at + self._size(count_type, text)
            if visit:
                visit(name, at, counts)
            at = at + counts * self._size(type_name, text)
        return at

    def _constant_rows(self, body: np.ndarray, text: bool) -> np.ndarray | None:
        """Ends of the rows where all are as long as the first, else None."""
        size = int(self._follow(body, np.zeros(1, np.int64), text)[0])
        ends = np.arange(1, self.n + 1) * size
        if ends[-1] > len(body) or not (self._follow(body, ends - size, text) == ends).all():
            return None
        return ends

    def _ragged_rows(self, body: np.ndarray, text: bool, model: str) -> np.ndarray:
        memory.require(60 * len(body), f"{model}: a file whose rows differ in length", "export it as GLB")
        stop = len(body) + 1  # a sink for all rows that run over the end
        jump = np.full(stop + 1, stop)
        jump[: len(body)] = np.minimum(self._follow(body, np.arange(len(body)), text), stop)
        begins = np.zeros(1, np.int64)
        while len(begins) <= self.n:
            begins = np.concatenate([begins, jump[begins]])
            jump = jump[jump]
        ends = begins[1 : self.n + 1]
        if ends[-1] > len(body):
            raise _truncated(model)
        return ends

    def _take(self, body: np.ndarray, begins: np.ndarray, text: bool) -> None:
        types = {name: type_name for name, type_name, _ in self.properties}

        def visit(name: str, at: np.ndarray, counts: np.ndarray | None) -> None:
            if counts is None:
                self.columns[name] = self._value(body, at, types[name], text)
                return
            within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
            places = np.repeat(at, counts) + within * self._size(types[name], text)
            self.lists[name] = counts, self._value(body, places, types[name], text)

        self._follow(body, begins, text, visit)


def _truncated(model: str) -> MeshError:
    return MeshError(f"{model}: the file ends before its last vertex or face; it is truncated, copy or export it again")


def _header(data: bytes, model: str) -> tuple[dict[str, _Element], np.ndarray, list[str]]:
    """Elements by name, the body, and the names of textures."""
    found = re.search(rb"(^|\n)end_header[ \t]*(\r\n|\n|\r)", data[: 1 << 20])
    if not data.startswith(b"ply") or not found:
        raise MeshError(f"{model}: this is no PLY file, or its header is cut off")
    elements: dict[str, _Element] = {}
    textures, order = [], None
    for line in data[: found.start()].decode("utf-8", "replace").splitlines():
        words = line.split()
        try:
            if words[:1] == ["format"]:
                order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
            elif words[:1] == ["element"]:
                elements[words[1]] = element = _Element(max(int(words[2]), 0), order or "<")
            elif words[:2] == ["property", "list"]:
                element.properties.append((words[4], words[3], words[2]))
                _ = _TYPES[words[3]], _TYPES[words[2]]
            elif words[:1] == ["property"]:
                element.properties.append((words[2], words[1], None))
                _ = _TYPES[words[1]]
            elif words[:2] == ["comment", "TextureFile"]:
                textures.append(line.split("TextureFile", 1)[1].strip())
        except (KeyError, IndexError, ValueError, UnboundLocalError) as error:
            raise MeshError(f"{model}: the PLY header line '{line[:80]}' cannot be understood") from error
    if order is None:
        raise MeshError(f"{model}: the PLY header names no format; export the file again")
    body = data[found.end() :]
    if order:
        return elements, np.frombuffer(body, np.uint8), textures
    try:
        return elements, np.fromstring(body, np.float64, sep=" "), textures
    except ValueError as error:
        raise MeshError(f"{model}: the file holds something that is no number; repair it") from error


def _columns(element: _Element, names: tuple[str, ...]) -> np.ndarray | None:
    """Columns side by side, float64, or None where one is missing."""
    if not set(names) <= set(element.columns):
        return None
    return np.stack([element.columns[k] for k in names], axis=1).astype(np.float64)


def _colors(vertex: _Element) -> np.ndarray | None:
    """Linear colours and opacity of vertices or faces, shape (N, 4)."""
    names = next((n for n in _COLOR_NAMES if set(n) <= set(vertex.columns)), None)
    if names is None:
        return None
    scale = {name: np.iinfo(_TYPES[t]).max if _TYPES[t][0] in "iu" else 1 for name, t, _ in vertex.properties}
    channels = [np.clip(vertex.columns[k] / scale[k], 0, 1) for k in names]
    alpha = vertex.columns["alpha"] / scale["alpha"] if "alpha" in vertex.columns else np.ones(vertex.n)
    return np.concatenate([srgb_to_linear(np.stack(channels, 1)), alpha[:, None]], axis=1).astype(np.float32)
