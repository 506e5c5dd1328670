"""
A model file as the latent model that it already is: its meshes, coordinates and materials, nothing made anew.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AssetError
from ..formats.images import constant, join_channels
from ..model.asset import PLAIN, Asset, Material, Part
from ..model.mesh import Mesh
from ..model.model import Model, Morphs
from ..model.topology import weld
from .morphing import MorphedModel
from .placing import PlacedModel, Placements

#: Normals of one place that are this alike are one [cosine].
_ALIKE = np.cos(np.radians(2.0))

_TEXTURES = ("base_color", "opacity", "roughness", "metallic", "normal")


@dataclass(frozen=True)
class FileModel:
    """
    The model of a file, and where everything in it comes from.

    Parameters
    ----------
    model : PlacedModel
    parts : tuple of Part
        Each once, as they are in the file.
    first : ndarray, shape (parts + 1,)
        First vertex of each part in the model's mesh.
    to_model : tuple of ndarray, shape (4, 4)
        From the frame of each part into that of the model.
    cell_of : tuple of int
        Which cell of the textures each part reads.
    targets : tuple of (int, int)
        Of every morph target of the model, the mesh of the file and which of those of its targets that move positions
        it is.
    notes : tuple of str
    """

    model: PlacedModel
    parts: tuple[Part, ...]
    first: np.ndarray
    to_model: tuple[np.ndarray, ...]
    cell_of: tuple[int, ...]
    targets: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]

    def geometry(self, fitted: Model) -> list[tuple[Part, np.ndarray, np.ndarray]]:
        """
        Vertices and unit normals of every part, shape (V, 3) each, in the part's own frame.
        """
        mesh = fitted.mesh
        vertices, normals = mesh.vertices, mesh.normals()[mesh.normal_groups]
        out = []
        for k, (part, matrix) in enumerate(zip(self.parts, self.to_model, strict=True)):
            rows, back = slice(self.first[k], self.first[k + 1]), np.linalg.inv(matrix)
            turned = normals[rows] @ matrix[:3, :3]  # the inverse of the inverse transposed
            turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-20)
            out.append((part, vertices[rows] @ back[:3, :3].T + back[:3, 3], turned))
        return out

    def normals(self, fitted: Model) -> list[np.ndarray]:
        """
        The normal map that every part reads, shape (H, W, 3).
        """
        whole = fitted.normal
        if fitted.cells is None:
            return [whole] * len(self.parts)
        cells = [fitted.cells[cell] for cell in self.cell_of]
        return [whole[top : top + h, left : left + w] for left, top, w, h in cells]

    def images(self, fitted: Model) -> list[tuple[Part, dict[str, np.ndarray]]]:
        """
        ``base_color`` (H, W, 4), ``specular`` (H, W, 3) and ``normal`` (H, W, 3) of every material, with a part of it.
        """
        whole = {name: getattr(fitted, name) for name in ("base_color", "specular", "normal")}
        height, width = whole["normal"].shape[:2]
        cells = np.array([[0, 0, width, height]]) if fitted.cells is None else fitted.cells
        owners = {cell: part for part, cell in zip(self.parts, self.cell_of, strict=True)}
        out = []
        for k, (left, top, w, h) in enumerate(cells):
            out.append((owners[k], {n: x[top : top + h, left : left + w] for n, x in whole.items()}))
        return out


def file_model(asset: Asset, fitted: Collection[str], texture_size: int = 512) -> FileModel:
    """
    The latent model of an asset as it is.

    Vertices of one place in one mesh move together, and normals that were one stay one. Textures keep their sizes; a
    material whose textures differ in size has all of them in the largest.

    Parameters
    ----------
    asset : Asset
        In the normalised frame.
    fitted : collection of str
        What is to be optimised: a material that has no texture for it gets one where its parts have coordinates, and
        normals that do not move are those of the file.
    texture_size : int
        Side of the textures of a material that has none at all.

    Raises
    ------
    AssetError
        A skeleton, vertex colours, or textures that are not all looked up with the same coordinates and repeating.
    """
    if any(part.skin is not None for part in asset.parts):
        raise AssetError(f"{asset.name}: it has a skeleton; what is fitted in place is at rest, so export it without")
    placed = [(instance.part, instance.to_world) for instance in asset.instances]
    numbers = list(dict.fromkeys(part for part, _ in placed))
    first_place = {part: matrix for part, matrix in reversed(placed)}
    parts = tuple(asset.parts[number] for number in numbers)
    places = [part.place for part in parts]
    if len(set(places)) < len(places):
        raise AssetError(f"{asset.name}: a mesh is placed with several weights of its morph targets; export it as two")
    materials, cell_of = _materials(parts)
    notes = tuple(_check(asset.name, parts))
    has_uvs = [
        any(part.uvs is not None for part, c in zip(parts, cell_of, strict=True) if c == k)
        for k in range(len(materials))
    ]
    images = [_images(material, fitted, texture_size, uvs) for material, uvs in zip(materials, has_uvs, strict=True)]
    cells, sheets = _sheet(images)
    moving = not {"vertices", "weights"}.isdisjoint(fitted)
    matrices = [first_place[n] for n in numbers]
    mesh, first = _mesh(parts, matrices, cell_of, len(materials) > 1, moving, "weights" in fitted)
    morphs, targets = _morphs(parts, matrices, mesh, first) if "weights" in fitted else (None, ())
    mode, cutoff = _alpha(materials, sheets, cells)
    model = (PlacedModel if morphs is None else MorphedModel)(
        mesh=mesh, base_color=sheets[..., :4], specular=sheets[..., 4:7], normal=sheets[..., 7:],
        alpha_mode=mode, alpha_cutoff=cutoff, name=asset.name, cells=cells if len(materials) > 1 else None,
        ambient=asset.ambient, placements=_placements(parts, numbers, placed, first_place),
        morphs=morphs,
    )  # fmt: skip
    return FileModel(model, parts, first, tuple(matrices), tuple(cell_of), targets, notes)


def _materials(parts: tuple[Part, ...]) -> tuple[list[Material], list[int]]:
    """Distinct materials, and which of them each part has."""
    materials: dict[tuple, Material] = {}
    cell_of = []
    for part in parts:
        key = part.place[2:] if part.place[2:] not in ((), (-1,)) else (id(part.material), part.place[:2])
        materials.setdefault(key, part.material)
        cell_of.append(list(materials).index(key))
    return list(materials.values()), cell_of


def _check(name: str, parts: tuple[Part, ...]) -> list[str]:
    """Raise where a part's look is none that textures in cells can have; notes on what is not shown."""
    notes = []
    for part in parts:
        material = part.material
        if part.colors is not None and not (part.colors > 0.999).all():
            raise AssetError(f"{name}: '{part.name}' has vertex colours, which no fit sees; bake them into a texture")
        for texture in ("base_color", "specular"):
            lookup = material.lookup(texture)
            beyond = part.uvs is not None and (part.uvs.min() < -1e-4 or part.uvs.max() > 1 + 1e-4)
            if lookup.uvs != PLAIN.uvs:
                raise AssetError(
                    f"{name}: the textures of material '{material.name}' have coordinates of their own each; export it "
                    "with one set for all"
                )
            if beyond and lookup.wraps != PLAIN.wraps:
                raise AssetError(
                    f"{name}: a texture of material '{material.name}' is clamped or mirrored beyond its image; export "
                    "it with coordinates that stay inside"
                )
        if material.emission is not None:
            notes.append(f"the emission of material '{material.name}' stays in the file, but is not seen by the fit")
        if material.lobes:
            notes.append(f"{', '.join(material.lobes)} of material '{material.name}' is not seen by the fit")
    return list(dict.fromkeys(notes))


def _images(material: Material, fitted: Collection[str], size: int, has_uvs: bool) -> np.ndarray:
    """All textures of a material side by side in their channels, shape (H, W, 10)."""
    normal = constant(0, 0, 1) if material.normal is None else material.normal
    color = material.base_color
    if material.alpha_mode == "OPAQUE":
        color = np.concatenate([color[..., :3], np.ones_like(color[..., 3:])], axis=2)
    out = join_channels(color, material.specular, normal)
    if out.shape[:2] == (1, 1) and has_uvs and any(name in _TEXTURES for name in fitted):
        out = np.broadcast_to(out, (size, size, out.shape[2]))
    return np.ascontiguousarray(out, np.float32)


def _sheet(images: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """
    All images on one sheet, row after row of falling heights.

    Returns
    -------
    cells : ndarray, shape (M, 4), int64
        Left, top, width, height.
    sheet : ndarray, shape (H, W, C)
    """
    area = sum(image.shape[0] * image.shape[1] for image in images)
    width = max(max(image.shape[1] for image in images), int(np.ceil(np.sqrt(area))))
    cells = np.zeros((len(images), 4), np.int64)
    left = top = row = 0
    for k in sorted(range(len(images)), key=lambda k: -images[k].shape[0]):
        h, w = images[k].shape[:2]
        if left + w > width:
            left, top, row = 0, top + row, 0
        cells[k] = left, top, w, h
        left, row = left + w, max(row, h)
    height = top + row
    sheet = np.zeros((height, width, images[0].shape[2]), np.float32)
    sheet[..., 3] = sheet[..., 9] = 1
    for (x, y, w, h), image in zip(cells, images, strict=True):
        sheet[y : y + h, x : x + w] = image
    return cells, sheet if len(images) > 1 else images[0]


def _alpha(materials: list[Material], sheet: np.ndarray, cells: np.ndarray) -> tuple[str, float]:
    """
    One mode and cutoff for all: where masks and blends meet, masks are cut in the sheet beforehand.
    """
    modes = {material.alpha_mode for material in materials}
    cutoffs = {material.alpha_cutoff for material in materials if material.alpha_mode == "MASK"}
    if "BLEND" not in modes and len(cutoffs) <= 1:
        return ("MASK", cutoffs.pop()) if cutoffs else ("OPAQUE", 0.5)
    for material, (x, y, w, h) in zip(materials, cells, strict=True):
        if material.alpha_mode == "MASK":
            cell = sheet[y : y + h, x : x + w, 3]
            cell[...] = cell >= material.alpha_cutoff
    return "BLEND", 0.5


def _mesh(
    parts: tuple[Part, ...],
    to_model: list[np.ndarray],
    cell_of: list[int],
    in_cells: bool,
    moving: bool,
    morphing: bool,
) -> tuple[Mesh, np.ndarray]:
    """Every part once, at its first place; and the first vertex of each."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    meshes: dict[tuple[int, ...], list[int]] = {}
    for k, part in enumerate(parts):
        meshes.setdefault(part.place[:1] or (-1 - k,), []).append(k)
    position_index, normals = np.zeros(first[-1], np.int64), np.zeros((first[-1], 3))
    groups = np.zeros(first[-1], np.int64)
    positions: list[np.ndarray] = []
    n_positions = n_groups = 0
    for members in meshes.values():
        own = np.concatenate([np.arange(first[k], first[k + 1]) for k in members])
        keys = np.concatenate([_welding_keys(parts[k]) if morphing else parts[k].vertices for k in members])
        welded, index = weld(keys)
        welded = welded[:, :3]
        matrix = to_model[members[0]]
        positions.append(welded @ matrix[:3, :3].T + matrix[:3, 3])
        position_index[own] = index + n_positions
        given = [parts[k].normals for k in members]
        group = index
        if all(n is not None for n in given):
            normals[own] = np.concatenate([n for n in given if n is not None])
            group = _normal_groups(index, normals[own], exact=not moving)
        groups[own] = group + n_groups
        n_positions, n_groups = n_positions + len(welded), n_groups + int(group.max()) + 1
    faces, cells, world = [], [], np.zeros_like(normals)
    for k, (part, matrix) in enumerate(zip(parts, to_model, strict=True)):
        linear = matrix[:3, :3]
        mirrored = np.linalg.det(linear) < 0
        faces.append((part.faces[:, ::-1] if mirrored else part.faces) + first[k])
        cells.append(np.full(len(part.faces), cell_of[k]))
        cofactors = np.cross(np.roll(linear, -1, axis=0), np.roll(linear, -2, axis=0))
        rows = slice(first[k], first[k + 1])
        world[rows] = normals[rows] @ cofactors.T * (-1 if mirrored else 1)
    uvs = [np.zeros((len(part.vertices), 2), np.float32) if part.uvs is None else part.uvs for part in parts]
    mesh = Mesh(
        positions=np.concatenate(positions), position_index=position_index, uvs=np.concatenate(uvs),
        faces=np.concatenate(faces), normal_index=groups, cell_index=np.concatenate(cells) if in_cells else None,
    )  # fmt: skip
    if not moving and all(part.normals is not None for part in parts):
        total = np.zeros((n_groups, 3))
        np.add.at(total, groups, world)
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)
        mesh = replace(mesh, own_normals=total)
    return mesh, first


def _welding_keys(part: Part) -> np.ndarray:
    """
    Places of vertices, shape (V, 3 + 3), with a number for how morph targets move them: closed lips are not one.
    """
    rng, moved = np.random.default_rng(0), np.zeros_like(part.vertices, np.float64)
    for morph in part.morphs:
        moved += rng.normal() * morph.offsets
    return np.concatenate([part.vertices, moved], axis=1)


def _morphs(
    parts: tuple[Part, ...], to_model: list[np.ndarray], mesh: Mesh, first: np.ndarray
) -> tuple[Morphs | None, tuple[tuple[int, int], ...]]:
    """The targets of all meshes one behind the other, and which of which mesh each is."""
    owners = [(part.place[0], j) for part in parts for j in range(len(part.morphs))]
    targets = tuple(dict.fromkeys(owners))
    if not targets:
        return None, ()
    offsets = np.zeros((len(targets), len(mesh.positions), 3))
    names, weights = [""] * len(targets), [0.0] * len(targets)
    for k, (part, matrix) in enumerate(zip(parts, to_model, strict=True)):
        place = mesh.position_index[first[k] : first[k + 1]]
        for j, morph in enumerate(part.morphs):
            t = targets.index((part.place[0], j))
            offsets[t, place] = morph.offsets @ matrix[:3, :3].T
            names[t], weights[t] = morph.name, morph.weight
    return Morphs(tuple(names), tuple(weights), offsets), targets


def _normal_groups(index: np.ndarray, normals: np.ndarray, exact: bool) -> np.ndarray:
    """
    Which vertices share a normal: those of one place whose normals are alike, or the same; numbered from 0.
    """
    _, representative = np.unique(index, return_index=True)
    own = normals[representative[index]]
    alike = np.einsum("vi,vi->v", own, normals) >= (1 - 1e-7 if exact else _ALIKE)
    key = np.where(alike[:, None], 0, np.round(normals * (1e4 if exact else 16)) + 1e5)
    _, group = np.unique(np.column_stack([index, key]), axis=0, return_inverse=True)
    return group.reshape(-1)


def _placements(
    parts: tuple[Part, ...], numbers: list[int], placed: list[tuple[int, np.ndarray]], first: dict[int, np.ndarray]
) -> Placements | None:
    """All places but the first of each part."""
    start = np.cumsum([0, *(len(part.faces) for part in parts)])
    seen: set[int] = set()
    faces, matrices = [], []
    for number, matrix in placed:
        if number in seen:
            k = numbers.index(number)
            faces.append(np.arange(start[k], start[k + 1]))
            matrices.append(matrix @ np.linalg.inv(first[number]))
        seen.add(number)
    return Placements(tuple(faces), tuple(matrices)) if faces else None
