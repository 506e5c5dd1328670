"""
Wavefront OBJ with its material libraries.

The file is taken apart as one array of bytes: lines are sorted by keyword, and each kind is parsed at once.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import MeshError
from ...model.asset import Asset, Instance, Material, Part
from ...model.color import srgb_to_linear
from ..mapping import Mapping, placed
from ..polygons import smooth_normals, split_corners
from ..resources import Resources, as_utf8, read_bytes
from ..triangulate import triangulate
from ..validate import check_indices
from .mtl import read_mtl


def read_obj(path: Path) -> Asset:
    """
    Read an OBJ file: one part for each object and material, vertices split where UVs or normals differ.

    Positions are float64, so that what stands far from the origin keeps its digits; a file of ours may say in its head
    where its own origin is. Vertex colours (three numbers after the position) are sRGB and used where the material has
    no ``map_Kd``.

    Raises
    ------
    MeshError
        Numbers that are none, indices out of range.
    AssetError
        A texture is missing or cannot be read.
    """
    notes: list[str] = []
    resources = Resources(path, notes)
    data = as_utf8(read_bytes(path, "OBJ file"))
    lines = _Lines(data, path.name)
    v, n_v = lines.table(b"v")
    vt, n_vt = lines.table(b"vt")
    vn, _ = lines.table(b"vn")
    has_colors = bool(len(v)) and bool((n_v >= 6).all())
    uvs = np.stack([vt[:, 0], 1 - np.where(n_vt > 1, vt[:, 1], 0)], axis=1) if len(vt) else np.zeros((0, 2))
    colors = _vertex_colors(v[:, 3:6]) if has_colors else None
    faces = lines.faces()
    for keyword, meaning in ((b"l", "line"), (b"p", "point"), (b"curv", "curve"), (b"surf", "surface")):
        if count := int(lines.of(keyword).sum()):
            notes.append(f"{count} {meaning} elements were left out")
    if int((faces.counts < 3).sum()):
        notes.append(f"{int((faces.counts < 3).sum())} faces with fewer than three corners were left out")
    materials, owner, keys = _owners(lines, faces, resources)

    table = {"v": v[:, :3] + _origin(data), "uvs": uvs, "vn": vn[:, :3], "colors": colors}
    for column, (values, what) in enumerate(((v, "vertex"), (uvs, "texture coordinate"), (vn, "normal"))):
        index = faces.index[:, column]
        # A missing position is as wrong as one out of range; the other two may be missing.
        index = index if column == 0 else index[index >= 0]
        check_indices(index, len(values), path.name, path.stem, what, first=1)
    corners, polygon = triangulate(v[:, :3], faces.index[:, 0], faces.counts, path.name)
    owner = owner[polygon]
    order = np.argsort(owner, kind="stable")
    by_key = np.split(corners[order], np.searchsorted(owner[order], np.arange(1, len(keys))))
    objects: dict[int, list[int]] = {}
    for k, key in enumerate(keys):
        if len(by_key[k]):
            objects.setdefault(key[0], []).append(k)
    parts = []
    for members in objects.values():
        index, normals = _fill_normals(faces.index, [by_key[k] for k in members], table)
        for k in members:
            material, places = materials.get(keys[k][2], (Material(), ()))
            part = _part(keys[k][1], by_key[k], index, {**table, "vn": normals}, material, notes)
            if part.uvs is not None and places:
                first, *more = placed(places, [part.uvs] * len(places))
                part = replace(part, uvs=first, more_uvs=tuple(more))
            parts.append(part)
    instances = tuple(Instance(i, name=part.name) for i, part in enumerate(parts))
    return Asset(tuple(parts), instances, notes=tuple(notes))


def _origin(data: bytes) -> np.ndarray:
    """Where the file's origin stands, if its head says so as ours do, shape (3,)."""
    found = re.match(rb"# mi_simplify [^\n]*\n# origin: (\S+) (\S+) (\S+)\r?\n", data)
    try:
        return np.zeros(3) if found is None else np.array([float(x) for x in found.groups()])
    except ValueError:
        return np.zeros(3)


def _fill_normals(index: np.ndarray, triangles: list[np.ndarray], table: dict) -> tuple[np.ndarray, np.ndarray]:
    """
    Corner indices and normals of one object; an object of several materials without normals gets smooth ones.
    """
    faces = np.concatenate(triangles)
    if len(triangles) < 2 or (index[faces, 2] >= 0).any():
        return index, table["vn"]
    return index[:, [0, 1, 0]], smooth_normals(table["v"], index[faces, 0])


def _part(name: str, corners: np.ndarray, index: np.ndarray, table: dict, material: Material, notes: list[str]) -> Part:
    """Corners, shape (F, 3), of one object and material as a part."""
    v, vt, vn = index[corners.reshape(-1)].T
    first, vertex = split_corners(v, vt, vn)
    v, vt, vn = v[first], vt[first], vn[first]
    uvs = normals = colors = None
    if (vt >= 0).any():
        uvs = np.where((vt >= 0)[:, None], table["uvs"][vt], 0.0)
        if (vt < 0).any():
            notes.append(f"{int((vt < 0).sum())} vertices of part '{name}' have no texture coordinates; set to 0")
    elif material.base_color.size > 4 or material.normal is not None or material.specular.size > 3:
        notes.append(f"part '{name}' has textures but no texture coordinates; they show one texel")
    if (vn >= 0).any():
        # Rows without a normal become 0 and are filled in by the validation.
        normals = np.where((vn >= 0)[:, None], table["vn"][vn], 0.0)
    if table["colors"] is not None:
        if material.base_color.size > 4:
            notes.append(f"vertex colours of part '{name}' were left out: its material has a texture")
        else:
            colors = np.concatenate([table["colors"][v], np.ones((len(v), 1))], axis=1)
            material = _white(material)
    return Part(table["v"][v], vertex.reshape(-1, 3), normals, uvs, colors, material, name)


def _white(material: Material) -> Material:
    """The material with a white base colour, for vertex colours to multiply."""
    base = material.base_color.copy()
    base[..., :3] = 1
    return replace(material, base_color=base)


def _vertex_colors(colors: np.ndarray) -> np.ndarray:
    scale = 255 if len(colors) and np.nanmax(colors) > 1.5 else 1
    return srgb_to_linear(np.nan_to_num(colors / scale, nan=1.0)).astype(np.float32)


def _owners(lines: _Lines, faces: _Faces, resources: Resources) -> tuple[dict, np.ndarray, list]:
    """
    Materials by name, an index into the keys for every face, and the keys (object number, part name, material name).
    """
    materials: dict[str, tuple[Material, tuple[Mapping, ...]]] = {}
    libraries: set[str] = set()
    obj, obj_name, material = 0, resources.model.stem, ""
    keys: dict[tuple, int] = {(0, obj_name, ""): 0}
    at, owner = [-1], [0]
    for line, keyword, value in lines.state():
        if keyword == "mtllib":
            if value not in libraries:
                materials.update(read_mtl(value, resources))
            libraries.add(value)
            continue
        if keyword == "o":
            obj, obj_name = obj + 1, value or f"object_{obj + 1}"
        else:
            material = value
        name = f"{obj_name}:{material}" if material else obj_name
        at.append(line)
        owner.append(keys.setdefault((obj, name, material), len(keys)))
    which = np.asarray(owner)[np.searchsorted(at, faces.line, side="right") - 1]
    names = list(keys)
    for missing in sorted({names[k][2] for k in np.unique(which)} - set(materials) - {""}):
        resources.note(f"material '{missing}' is not defined; the default grey is used")
    return materials, which, names


@dataclass
class _Faces:
    """Polygons: 0-based (position, UV, normal) of every corner, -1 where missing; corners and line of each face."""

    index: np.ndarray  # (C, 3)
    counts: np.ndarray  # (N,)
    line: np.ndarray  # (N,)


class _Lines:
    """
    The lines of an OBJ file, sorted by keyword.
    """

    def __init__(self, data: bytes, model: str):
        self.model = model
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b"  ")
        if re.search(rb"(?m)^[ \t]", data):
            data = re.sub(rb"(?m)^[ \t]+", b"", data)
        self._bytes = np.frombuffer(data + b"\n", np.uint8)
        self._stop = np.flatnonzero(self._bytes == 10) + 1
        self._start = np.concatenate([[0], self._stop[:-1]])

    def of(self, keyword: bytes) -> np.ndarray:
        """Mask of the lines that begin with a keyword."""
        last = len(self._bytes) - 1
        mask = np.ones(len(self._start), bool)
        for k, char in enumerate(keyword):
            mask &= self._bytes[np.minimum(self._start + k, last)] == char
        return mask & (self._bytes[np.minimum(self._start + len(keyword), last)] <= 32)

    def _select(self, keyword: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bytes of the lines of a keyword (blanked), their starts therein, and their line numbers."""
        mask = self.of(keyword)
        lengths = self._stop - self._start
        text = self._bytes[np.repeat(mask, lengths)]
        starts = np.cumsum(lengths[mask]) - lengths[mask]
        for k in range(len(keyword)):
            text[starts + k] = 32
        if (text == ord("#")).any():  # comments behind the numbers
            text = re.sub(rb"#[^\n]*", lambda m: b" " * len(m[0]), text.tobytes())
            text = np.frombuffer(text, np.uint8).copy()
        return text, starts, np.flatnonzero(mask)

    def _parse(self, text: np.ndarray, dtype, n_expected: int, keyword: bytes) -> np.ndarray:
        try:
            values = np.fromstring(text.tobytes(), dtype, sep=" ")
        except ValueError:
            values = None
        if values is None or len(values) != n_expected:
            raise MeshError(f"{self.model}: a '{keyword.decode()}' line holds something that is no number; repair it")
        return values

    def table(self, keyword: bytes) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of all lines of a keyword, shape (N, K >= 3), short lines filled with 0; numbers per line."""
        text, starts, _ = self._select(keyword)
        if not len(starts):
            return np.zeros((0, 3)), np.zeros(0, np.int64)
        begins = _token_starts(text > 32)
        counts = np.add.reduceat(begins, starts, dtype=np.int64)
        values = self._parse(text, np.float64, int(counts.sum()), keyword)
        if keyword != b"vt" and counts.min() < 3 or counts.min() < 1:
            raise MeshError(f"{self.model}: a '{keyword.decode()}' line has fewer numbers than it needs; repair it")
        width = min(max(3, int(counts.max())), 8)
        k = np.arange(width)
        first = np.cumsum(counts) - counts
        at = np.minimum(first[:, None] + k, len(values) - 1)
        return np.where(k < counts[:, None], values[at], 0.0), counts

    def faces(self) -> _Faces:
        """All ``f`` lines; relative indices are made absolute."""
        text, starts, line = self._select(b"f")
        if not (text > 32).any():
            line = line[:0]
            return _Faces(np.zeros((0, 3), np.int64), np.zeros(0, np.int64), line)
        slash = text == ord("/")
        solid = text > 32
        corner_begins = _token_starts(solid)
        number_begins = _token_starts(solid & ~slash)
        counts = np.add.reduceat(corner_begins, starts, dtype=np.int64)
        corner = np.cumsum(corner_begins) - 1
        slashes = np.cumsum(slash)
        slot = slashes - (slashes - slash)[corner_begins][np.maximum(corner, 0)]
        text[slash] = 32
        numbers = self._parse(text, np.int64, int(number_begins.sum()), b"f")
        slot, corner = slot[number_begins], corner[number_begins]
        if len(slot) and slot.max() > 2:
            raise MeshError(f"{self.model}: a face corner has more than three indices; export the file again")
        index = np.zeros((int(counts.sum()), 3), np.int64)
        index[corner, slot] = numbers
        relative = index < 0
        if relative.any():
            corner_line = np.repeat(line, counts)
            for column, keyword in enumerate((b"v", b"vt", b"vn")):
                so_far = np.cumsum(self.of(keyword))[corner_line]
                resolved = np.where(relative[:, column], index[:, column] + so_far + 1, 1)
                if resolved.min() < 1:
                    kind = keyword.decode()
                    raise MeshError(f"{self.model}: a face counts back beyond the first '{kind}'; export it again")
                index[:, column] = np.where(relative[:, column], resolved, index[:, column])
        return _Faces(index - 1, counts, line)

    def state(self) -> list[tuple[int, str, str]]:
        """Line number, keyword and value of the lines that change what faces belong to."""
        out = []
        for keyword in ("mtllib", "usemtl", "o"):
            for line in np.flatnonzero(self.of(keyword.encode())):
                raw = self._bytes[self._start[line] : self._stop[line]].tobytes().decode("utf-8", "replace")
                out.append((int(line), keyword, raw[len(keyword) :].strip()))
        return sorted(out)


def _token_starts(solid: np.ndarray) -> np.ndarray:
    """Where a run of True begins."""
    begins = solid.copy()
    begins[1:] &= ~solid[:-1]
    return begins
