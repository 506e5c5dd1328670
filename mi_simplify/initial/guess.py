"""
The first guess: a small textured model made from the asset itself, before anything is optimised.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import MeshError
from ..machine.runtime import ensure_variant
from ..model.asset import Asset
from ..model.mesh import Mesh
from ..model.mips import filtered_levels, halved
from ..model.model import Displacement, Model, tessellated
from ..model.tessellation import Tessellation
from ..model.topology import area_vectors
from .bake.baker import bake
from .cards.cards import cards, is_aggregate
from .closest import ClosestPoints
from .reduce.cleanup import clean
from .reduce.decimate import decimate
from .repair.kept import keep_mesh
from .soup import merge
from .sphere import sphere
from .unwrap.charting import unwrap

log = logging.getLogger("mi_simplify")

KINDS = ("decimate", "cards", "sphere", "mesh")
TEXTURES = ("bake", "constant", "random")


def first_guess(
    asset: Asset,
    *,
    triangles: int | None = None,
    atlas_size: int = 1024,
    textures: str = "bake",
    seed: int = 0,
    kind: str = "decimate",
    init: Asset | None = None,
    keep_uv: bool = False,
    repair: bool = False,
    samples: int = 2,
    oversample: int = 1,
    padding: int = 4,
    time_limit: float = 60.0,
    crease_angle: float = 20.0,
    output: str = "mask",
    subdivisions: int = 0,
    tessellations: tuple[int, ...] = (),
) -> tuple[Model, list[str]]:
    """
    A model to start from.

    Parameters
    ----------
    asset : Asset
        The reference; the result is in the same frame.
    triangles : int
        Budget, at least 4 and at most the asset's own count; without it ``kind="mesh"`` keeps all that it has.
    atlas_size : int
        Side of the textures [texels].
    textures : {'bake', 'constant', 'random'}
        Ray-cast from the asset; its mean; uniform noise. The last two have a flat normal map.
    seed : int
        Of the noise.
    kind : {'decimate', 'cards', 'sphere', 'mesh'}
        Quadric edge collapse of the asset; textured quads, see :func:`.cards.cards.cards`; an ellipsoid in its
        bounding box;
        the mesh of ``init``.
    init : Asset, optional
        Low-poly mesh in the frame of ``asset``, for ``kind="mesh"``. UVs without overlap are kept.
    keep_uv : bool
        Refuse ``init`` where its UVs cannot be kept.
    repair : bool
        Mend ``init`` where it is damaged: pieces that came off, stray vertices, lost volume.
    samples : int
        ``samples``² points are baked for every texel.
    oversample : int
        Power of two: bake textures of so many times the side, and filter them down as ``mips.filtered_levels`` does,
        the spread of normals becoming roughness.
    padding : int
        Empty texels between charts.
    time_limit : float
        Seconds that the unwrapping may take.
    crease_angle : float
        Edges of the reduced mesh that turn by more get two normals [degrees]; 180 has none.
    output : {'mask', 'blend', 'opaque'}
        How cards are transparent.
    subdivisions : int
        Split the faces so many times, and displace what comes of it onto the asset.
    tessellations : tuple of int
        Subdivisions that it is to be fitted for at once, whose coarsest the normal map belongs to.

    Returns
    -------
    model : Model
    notes : list of str
        What was cleaned up, and warnings, one line each.

    Raises
    ------
    MeshError
        The budget or one of the meshes cannot be used.
    """
    if kind not in KINDS or textures not in TEXTURES:
        raise ValueError(f"kind must be one of {KINDS}, textures one of {TEXTURES}; got {kind!r}, {textures!r}")
    notes = list(asset.notes)
    if kind == "cards":
        model, more = cards(asset, _budget(triangles), atlas_size=atlas_size, samples=samples, output=output)
        return model, _logged(notes + more)
    if kind == "mesh":
        if init is None:
            raise MeshError("a start from a mesh needs one: name the file")
        n = init.n_triangles
        if triangles is not None and triangles < n:
            raise MeshError(
                f"{init.name} has {n} triangles ({_n_positions(init)} vertices), above the budget of {triangles}; "
                "ask for as many, or decimate it first"
            )
        if (init.bounds[0] > asset.bounds[1]).any() or (init.bounds[1] < asset.bounds[0]).any():
            raise MeshError(
                f"{init.name} does not stand where {asset.name} does: their boxes do not meet; export both in the same "
                "place and unit"
            )
        soup = clean(merge(asset))[0] if repair else None
        mesh, more = keep_mesh(
            init, reference=None if soup is None else ClosestPoints(soup.positions, soup.position_faces),
            keep_uv=keep_uv, atlas_size=atlas_size, padding=padding, time_limit=time_limit, crease_angle=crease_angle,
        )  # fmt: skip
    else:
        if kind == "decimate":
            why = is_aggregate(asset, _budget(triangles))
            if why:
                notes.append(f"{why}: textured cards (--mode cards) may show them better than one surface")
                log.warning("%s", notes[-1])
            positions, faces, more = reduced(asset, _budget(triangles))
            notes += more
        else:
            low, high = asset.bounds
            half = np.maximum((high - low) / 2, 0.05 * (high - low).max())
            positions, faces = sphere(_budget(triangles))
            positions = positions * half + (low + high) / 2
        mesh, more = unwrap(
            positions, faces, atlas_size=atlas_size, padding=padding, time_limit=time_limit, crease_angle=crease_angle
        )
    notes += more
    model = replace(_plain(asset, mesh, atlas_size, textures, seed), name=asset.name)
    if subdivisions:
        model = displaced_onto(asset, model, subdivisions, tessellations)
        mesh = tessellated(model).mesh
        notes.append(f"{len(model.mesh.faces)} triangles of a base mesh are split in {4**subdivisions} and displaced")
    if textures == "bake":
        baked = bake(asset, mesh, size=atlas_size * oversample, samples=samples if oversample == 1 else 1)
        if baked.missed > 0.05:
            notes.append(
                f"{baked.missed:.0%} of the baked points saw no surface along their normal and took the closest"
            )
        mode, cutoff = alpha_of(asset, baked.base_color)
        images: dict[str, Any] = {"base_color": baked.base_color, "specular": baked.specular, "normal": baked.normal}
        if oversample > 1:
            images = filtered_levels(**images)[oversample.bit_length() - 2]
        model = replace(model, alpha_mode=mode, alpha_cutoff=cutoff, **images)
    return model, _logged(notes)


def _budget(triangles: int | None) -> int:
    if triangles is None:
        raise MeshError("a budget of triangles is needed: name it")
    return triangles


def _logged(notes: list[str]) -> list[str]:
    for line in notes:
        log.info("first guess: %s", line)
    return notes


def displaced_onto(asset: Asset, model: Model, subdivisions: int, tessellations: tuple[int, ...] = ()) -> Model:
    """
    The model with a displacement map that brings its base mesh, subdivided, onto the asset: heights by ray casting.

    The map has about two texels for every position that reads it.
    """
    tessellation = Tessellation.of(model.mesh, subdivisions)
    size = model.base_color.shape[0]
    height = bake(asset, tessellation.base, size=size, samples=1).height
    while size % 2 == 0 and (size // 2) ** 2 >= 2 * len(tessellation.mesh.positions):
        height, size = halved(height), size // 2
    displacement = Displacement(height[..., 0].astype(np.float32), subdivisions, tessellations)
    return replace(model, mesh=tessellation.base, displacement=displacement)


def quadrics_only(asset: Asset, triangles: int, *, atlas_size: int = 1024) -> tuple[Model, list[str]]:
    """
    What a user would take instead: fast-simplification, colours carried over by closest point, no normal map.

    The baseline of the reports. Smooth normals; ``triangles`` may exceed the asset's, which then stays as it is.
    """
    positions, faces, notes = fast_quadrics(asset, triangles)
    mesh, more = unwrap(positions, faces, atlas_size=atlas_size)
    baked = bake(asset, mesh, size=atlas_size, samples=1, reach=0.0)
    mode, cutoff = alpha_of(asset, baked.base_color)
    flat = np.broadcast_to(np.array([0, 0, 1], np.float32), baked.normal.shape).copy()
    model = Model(mesh, baked.base_color, baked.specular, flat, mode, cutoff, name=asset.name)
    return model, notes + more


def fast_quadrics(asset: Asset, triangles: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """
    As :func:`reduced`, by fast-simplification: what others have for free.
    """
    import fast_simplification

    soup, notes = clean(merge(asset))
    positions, faces = soup.positions, soup.position_faces
    if triangles < len(faces):
        low = positions.min(0)
        scale = 100 / np.ptp(positions, axis=0).max()  # fast-simplification compares errors with absolute thresholds
        points, faces = fast_simplification.simplify(
            ((positions - low) * scale).astype(np.float32), faces.astype(np.int32), target_count=triangles
        )
        positions, faces = points.astype(np.float64) / scale + low, faces.astype(np.int64)
    return positions, faces, notes


def reduced(asset: Asset, triangles: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """
    Positions (P, 3) and faces (F, 3) of the cleaned and decimated asset, and what the clean-up did.
    """
    if triangles > asset.n_triangles:
        raise MeshError(
            f"a budget of {triangles} triangles is above the input's own {asset.n_triangles} "
            f"({_n_positions(asset)} vertices); ask for fewer, as with --triangles {max(4, asset.n_triangles // 2)}"
        )
    soup, notes = clean(merge(asset))
    ensure_variant()
    from .reduce.visibility import visibility  # traces rays

    opaque = np.array([m.alpha_mode == "OPAQUE" for m in soup.materials])[soup.material_index]
    seen = visibility(soup.positions, soup.position_faces, opaque)
    positions, faces = decimate(soup.positions, soup.position_faces, triangles, seen)
    return positions, faces, notes


def _n_positions(asset: Asset) -> int:
    """Vertices as a modelling program counts them: one where parts or seams meet."""
    return len(merge(asset).positions)


def _plain(asset: Asset, mesh: Mesh, size: int, textures: str, seed: int) -> Model:
    """The asset's mean colour, or noise; the normal map is flat either way."""
    base, specular = mean_material(asset)
    base = np.broadcast_to(base, (size, size, 4)).copy()
    specular = np.broadcast_to(specular, (size, size, 3)).copy()
    if textures == "random":
        rng = np.random.default_rng(seed)
        base[..., :3] = rng.random((size, size, 3), np.float32)
        specular[..., 1:] = rng.random((size, size, 2), np.float32) * [0.9, 0.2] + [0.1, 0]
    base[..., 3] = 1
    normal = np.zeros((size, size, 3), np.float32)
    normal[..., 2] = 1
    return Model(mesh, base, specular, normal)


def mean_material(asset: Asset) -> tuple[np.ndarray, np.ndarray]:
    """
    Mean base colour and opacity (4,) and mean (gamma, roughness, metallic) (3,) of an asset's textures, by area.
    """
    total, base, specular = 1e-30, np.zeros(4), np.zeros(3)
    for instance in asset.instances:
        part = asset.parts[instance.part]
        c = (part.vertices @ instance.to_world[:3, :3].T)[part.faces]
        area = np.linalg.norm(area_vectors(c), axis=1).sum()
        tint = 1.0 if part.colors is None else part.colors.mean(0, dtype=np.float64)
        base += area * part.material.base_color.mean((0, 1), dtype=np.float64) * tint
        specular += area * part.material.specular.mean((0, 1), dtype=np.float64)
        total += area
    return (base / total).astype(np.float32), (specular / total).astype(np.float32)


def alpha_of(asset: Asset, base_color: np.ndarray) -> tuple[str, float]:
    """
    Alpha mode and cutoff for textures baked from an asset: OPAQUE where no texel is transparent, MASK unless it blends.
    """
    modes = {asset.parts[i.part].material.alpha_mode for i in asset.instances}
    if modes <= {"OPAQUE"} or float(base_color[..., 3].min()) > 0.999:
        return "OPAQUE", 0.5
    return ("BLEND" if "BLEND" in modes else "MASK"), 0.5
