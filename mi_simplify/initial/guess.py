"""
The first guess: a small textured model made from the asset itself, before anything is optimised.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np

from ..config import InitialSettings, validated
from ..errors import MeshError
from ..model.asset import Asset
from ..model.groups import overall
from ..model.mesh import Mesh
from ..model.mips import coarser, filtered_levels, halved
from ..model.model import Displacement, Model, tessellated
from ..model.tessellation import Tessellation
from ..model.topology import area_vectors
from ..model.tree import Nodes
from .bake.baker import bake
from .budget import budget, settled, within_budget
from .cards.cards import cards as card_model
from .cards.cards import is_aggregate
from .closest import ClosestPoints
from .creases import hard_edges
from .groups import grouped
from .morphs import carried_morphs
from .nodes import kept_nodes
from .reduce.cleanup import clean
from .reduce.reduced import reduced, reduced_apart
from .reduce.visibility import visibility
from .repair.kept import keep_mesh
from .soup import merge
from .sphere import sphere
from .unwrap.charting import unwrap

log = logging.getLogger("mi_simplify")

#: Points a side that are baked for every texel.
_SAMPLES = 2
_UNSEEN = 0.02
"""What the normals of a hidden face count against those of one on a convex body."""


def first_guess(
    asset: Asset,
    settings: InitialSettings | None = None,
    *,
    mesh: Asset | None = None,
    seed: int = 0,
    cards: str = "mask",
    resolution: int = 256,
    **changes: Any,
) -> tuple[Model, list[str]]:
    """
    A model to start from: :func:`decimated`, :func:`on_cards`, :func:`inflated` or :func:`from_mesh`, by the settings.

    Parameters
    ----------
    asset : Asset
        The reference; the result is in the same frame.
    settings : InitialSettings, optional
        Section ``initial`` of the configuration; its defaults if not given.
    mesh : Asset, optional
        Low-poly mesh in the frame of ``asset``, for :func:`from_mesh`.
    seed : int
        Of the noise of random textures.
    cards : {'mask', 'blend', 'opaque'}
        How cards are transparent.
    resolution : int
        Side of the pictures in which a part is large enough to be missed [pixels].
    changes
        Settings by name, as in ``first_guess(asset, triangles=500)``; they win over ``settings``.

    Returns
    -------
    model : Model
    notes : list of str
        What was cleaned up, and warnings, one line each.

    Raises
    ------
    MeshError
        The budget or one of the meshes cannot be used.
    ConfigError
        There is no such setting, or its value is out of range.
    """
    if settings is None or changes:
        stated = {} if settings is None else settings.model_dump(exclude_unset=True)
        named = {} if mesh is None else {"kind": "mesh", "mesh": mesh.source or mesh.name}
        settings = validated(InitialSettings, {**named, **stated, **changes})
    settings = settled(settings, asset)
    if settings.kind == "auto":
        settings = settings.model_copy(
            update={"kind": "cards" if is_aggregate(asset, budget(settings)) else "decimate"}
        )
    if settings.kind == "cards":
        return on_cards(asset, settings, cards=cards)
    if settings.kind == "mesh":
        if mesh is None:
            raise MeshError("a start from a mesh needs one: name the file")
        return from_mesh(asset, mesh, settings, seed=seed)
    if settings.kind == "decimate":
        return decimated(asset, settings, seed=seed, resolution=resolution)
    return inflated(asset, settings, seed=seed)


def decimated(
    asset: Asset, settings: InitialSettings, *, seed: int = 0, resolution: int = 256
) -> tuple[Model, list[str]]:
    """
    Quadric edge collapse of the asset, unwrapped and baked; parameters, results and errors as of :func:`first_guess`.
    """
    why = is_aggregate(asset, budget(settings))
    if why:
        why += ": textured cards (--mode cards) may show them better than one surface"
        log.warning("%s", why)
    kept = kept_nodes(asset, settings)
    shown = asset if kept is None else kept.single
    tried: list[tuple[Mesh, Nodes | None]] = []

    def made(triangles: int) -> tuple[Mesh, list[str]]:
        if kept is None:
            positions, faces, notes = reduced(
                asset, triangles, keep_hidden=settings.keep_hidden, resolution=resolution
            )  # fmt: skip
        else:
            positions, faces, of_position, notes = reduced_apart(asset, kept, triangles, resolution=resolution)
        hard = hard_edges(shown, positions, faces) if settings.creases == "asset" else None
        mesh, charted = unwrapped(positions, faces, settings, hard)
        tried.append((mesh, None if kept is None else kept.nodes(of_position)))
        return mesh, notes + charted

    mesh, notes = within_budget(made, settings, asset.n_triangles)
    model, notes = _textured(shown, mesh, settings, seed, [*asset.notes, *([why] if why else []), *notes])
    return replace(model, nodes=next(nodes for other, nodes in tried if other is mesh)), notes


def on_cards(asset: Asset, settings: InitialSettings, *, cards: str = "mask") -> tuple[Model, list[str]]:
    """
    Textured quads for foliage, see :func:`.cards.cards.cards`; results and errors as of :func:`first_guess`.

    Parameters
    ----------
    cards : {'mask', 'blend', 'opaque'}
        How they are transparent.
    """
    model, notes = card_model(
        asset, budget(settings), atlas_size=settings.atlas_side, samples=_SAMPLES, output=cards
    )  # fmt: skip
    return replace(model, metadata=asset.metadata), _logged([*asset.notes, *notes])


def inflated(asset: Asset, settings: InitialSettings, *, seed: int = 0) -> tuple[Model, list[str]]:
    """
    An ellipsoid in the asset's box, the paper's start from a sphere; results and errors as of :func:`first_guess`.
    """
    low, high = asset.bounds
    half = np.maximum((high - low) / 2, 0.05 * (high - low).max())

    def made(triangles: int) -> tuple[Mesh, list[str]]:
        positions, faces = sphere(triangles)
        return unwrapped(positions * half + (low + high) / 2, faces, settings)

    mesh, notes = within_budget(made, settings)
    return _textured(asset, mesh, settings, seed, [*asset.notes, *notes])


def from_mesh(asset: Asset, low: Asset, settings: InitialSettings, *, seed: int = 0) -> tuple[Model, list[str]]:
    """
    A mesh of the user's own, baked; its UVs are kept where they do not overlap.

    Parameters
    ----------
    low : Asset
        In the frame of ``asset``. With ``settings.repair`` it is mended by the asset where it is damaged.
    """
    n = low.n_triangles
    if settings.triangles is not None and budget(settings) < n:
        raise MeshError(
            f"{low.name} has {n} triangles ({_n_positions(low)} vertices), above the budget of {settings.triangles}; "
            "ask for as many, or decimate it first"
        )
    if (low.bounds[0] > asset.bounds[1]).any() or (low.bounds[1] < asset.bounds[0]).any():
        raise MeshError(
            f"{low.name} does not stand where {asset.name} does: their boxes do not meet; export both in the same "
            "place and unit"
        )
    soup = clean(merge(asset))[0] if settings.repair else None
    mesh, notes = keep_mesh(
        low, reference=None if soup is None else ClosestPoints(soup.positions, soup.position_faces),
        keep_uv=settings.keep_uv, atlas_size=settings.atlas_side, padding=settings.padding,
        crease_angle=settings.crease_angle,
    )  # fmt: skip
    return _textured(asset, mesh, settings, seed, [*asset.notes, *notes])


def unwrapped(
    positions: np.ndarray, faces: np.ndarray, settings: InitialSettings, hard: np.ndarray | None = None
) -> tuple[Mesh, list[str]]:
    """
    A welded mesh with charts and creases as the settings have them, see :func:`unwrap`, and notes.
    """
    seen = None if hard is None else np.maximum(visibility(positions, faces)[faces].mean(1), _UNSEEN)
    return unwrap(
        positions, faces, atlas_size=settings.atlas_side, padding=settings.padding, crease_angle=settings.crease_angle,
        hard=hard, split=settings.vertices_per_position, weights=seen,
    )  # fmt: skip


def _textured(
    asset: Asset, mesh: Mesh, settings: InitialSettings, seed: int, notes: list[str]
) -> tuple[Model, list[str]]:
    """The mesh, displaced where that is asked for, with the textures that are asked for."""
    size, oversample = settings.atlas_side, settings.oversample
    model = _plain(asset, mesh, size, settings.textures, seed)
    model = replace(model, name=asset.name, metadata=asset.metadata)
    if not settings.subdivisions and settings.vertex_sets == 1 and any(part.morphs for part in asset.parts):
        model = replace(model, morphs=carried_morphs(asset, mesh))
    if settings.subdivisions:
        model = displaced_onto(asset, model, settings.subdivisions, settings.tessellations)
        mesh = tessellated(model).mesh
        split = 4**settings.subdivisions
        notes.append(f"{len(model.mesh.faces)} triangles of a base mesh are split in {split} and displaced")
    if settings.textures == "bake":
        grouping = grouped(asset, model.mesh)
        baked = bake(
            asset, mesh, size=size * oversample, samples=_SAMPLES if oversample == 1 else 1,
            grouping=grouping.split(settings.subdivisions), occlusion=settings.bake_occlusion,
        )  # fmt: skip
        if baked.missed > 0.05:
            notes.append(
                f"{baked.missed:.0%} of the baked points saw no surface along their normal and took the closest"
            )
        groups = grouping.groups.solid(baked.least_opacity)
        mode, cutoff = overall(groups)
        images: dict[str, Any] = {"base_color": baked.base_color, "specular": baked.specular, "normal": baked.normal}
        more: dict[str, Any] = {"emission": baked.emission, "occlusion": baked.occlusion}
        if oversample > 1:
            images = filtered_levels(**images)[oversample.bit_length() - 2]
            more = {name: None if x is None else coarser(x, oversample) for name, x in more.items()}
        model = replace(model, alpha_mode=mode, alpha_cutoff=cutoff, groups=groups, **images, **more)
    return model, _logged(notes)


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
