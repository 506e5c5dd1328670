"""
The first guess: a small textured model made from the asset itself, before anything is optimised.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from ..errors import MeshError
from ..latent.model import Mesh, Model
from ..latent.tangents import split_mirrored
from ..scenes.asset import Asset
from .atlas import overlap_fraction
from .bake import bake
from .cleanup import Soup, clean, merge
from .decimate import decimate
from .sphere import sphere
from .unwrap import check, unwrap

log = logging.getLogger("mi_simplify")

KINDS = ("decimate", "sphere", "mesh")
TEXTURES = ("bake", "constant", "random")


def first_guess(
    asset: Asset,
    *,
    triangles: int,
    atlas_size: int = 1024,
    textures: str = "bake",
    seed: int = 0,
    kind: str = "decimate",
    init: Asset | None = None,
    samples: int = 2,
    padding: int = 4,
    time_limit: float = 60.0,
    crease_angle: float = 30.0,
) -> tuple[Model, list[str]]:
    """
    A model to start from.

    Parameters
    ----------
    asset : Asset
        The reference; the result is in the same frame.
    triangles : int
        Budget, at least 4 and at most the asset's own count; not used for ``kind="mesh"``.
    atlas_size : int
        Side of the textures [texels].
    textures : {'bake', 'constant', 'random'}
        Ray-cast from the asset; the default grey; uniform noise around it.
    seed : int
        Of the noise.
    kind : {'decimate', 'sphere', 'mesh'}
        Quadric edge collapse of the asset; an ellipsoid in its bounding box; the mesh of ``init``.
    init : Asset, optional
        Low-poly mesh in the frame of ``asset``, for ``kind="mesh"``. UVs without overlap are kept.
    samples : int
        ``samples``² points are baked for every texel.
    padding : int
        Empty texels between charts.
    time_limit : float
        Seconds that the unwrapping may take.
    crease_angle : float
        Edges of the reduced mesh that turn by more get two normals [degrees]; 180 has none.

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
    if kind == "mesh":
        if init is None:
            raise MeshError("a start from a mesh needs one: name the file")
        mesh, more = keep_mesh(init, atlas_size=atlas_size, padding=padding, time_limit=time_limit)
    else:
        if kind == "decimate":
            positions, faces, more = reduced(asset, triangles)
            notes += more
        else:
            low, high = asset.bounds
            half = np.maximum((high - low) / 2, 0.05 * (high - low).max())
            positions, faces = sphere(triangles)
            positions = positions * half + (low + high) / 2
        mesh, more = unwrap(
            positions, faces, atlas_size=atlas_size, padding=padding, time_limit=time_limit, crease_angle=crease_angle
        )
    notes += more
    model = replace(_plain(mesh, atlas_size, textures, seed), name=asset.name)
    if textures == "bake":
        baked = bake(asset, mesh, size=atlas_size, samples=samples)
        if baked.missed > 0.05:
            notes.append(
                f"{baked.missed:.0%} of the baked points saw no surface along their normal and took the closest"
            )
        mode, cutoff = alpha_of(asset, baked.base_color)
        model = replace(
            model, base_color=baked.base_color, specular=baked.specular, normal=baked.normal,
            alpha_mode=mode, alpha_cutoff=cutoff,
        )  # fmt: skip
    for line in notes:
        log.info("first guess: %s", line)
    return model, notes


def quadrics_only(asset: Asset, triangles: int, *, atlas_size: int = 1024) -> tuple[Model, list[str]]:
    """
    What a user would take instead: quadric decimation, colours carried over by closest point, flat normal map.
    """
    positions, faces, notes = reduced(asset, triangles)
    mesh, more = unwrap(positions, faces, atlas_size=atlas_size)
    baked = bake(asset, mesh, size=atlas_size, samples=1, reach=0.0)
    mode, cutoff = alpha_of(asset, baked.base_color)
    flat = np.broadcast_to(np.float32([0, 0, 1]), baked.normal.shape).copy()
    model = Model(mesh, baked.base_color, baked.specular, flat, mode, cutoff, name=asset.name)
    return model, notes + more


def reduced(asset: Asset, triangles: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """
    Positions (P, 3) and faces (F, 3) of the cleaned and decimated asset, and what the clean-up did.
    """
    if triangles < 4:
        raise MeshError(f"a budget of {triangles} triangles is too small; ask for at least 4")
    if triangles > asset.n_triangles:
        raise MeshError(
            f"the budget of {triangles} triangles is above the {asset.n_triangles} of {asset.name}; ask for fewer"
        )
    soup, notes = clean(merge(asset))
    positions, faces = decimate(soup.positions, soup.position_faces, triangles)
    return positions, faces, notes


def keep_mesh(
    init: Asset, *, atlas_size: int = 1024, padding: int = 4, time_limit: float = 60.0
) -> tuple[Mesh, list[str]]:
    """
    A mesh of the user's own, cleaned, with its UVs where they can be baked to.
    """
    soup, notes = clean(merge(init))
    why = _unusable(init, soup)
    if why:
        notes.append(f"new texture coordinates: {why}")
        mesh, more = unwrap(
            soup.positions, soup.position_faces, atlas_size=atlas_size, padding=padding, time_limit=time_limit
        )
        return mesh, notes + more
    mesh = _own_uvs(soup)
    return mesh, notes + check(mesh, atlas_size)


def _own_uvs(soup: Soup) -> Mesh:
    """The soup with its vertices merged where position and UV agree."""
    rows = np.column_stack([soup.position_index, soup.uvs])
    rows, index = np.unique(rows, axis=0, return_inverse=True)
    faces = index.reshape(-1)[soup.faces]
    used, faces = np.unique(faces, return_inverse=True)
    rows = rows[used]
    mesh = Mesh(soup.positions, rows[:, 0].astype(np.int64), np.float32(rows[:, 1:]), faces.reshape(-1, 3))
    return split_mirrored(mesh)


def _unusable(init: Asset, soup: Soup) -> str:
    """Why the UVs of a mesh cannot be baked to; empty if they can."""
    if any(init.parts[i.part].uvs is None for i in init.instances):
        return "the mesh has none everywhere"
    used = soup.uvs[soup.faces]
    if used.min() < -1e-4 or used.max() > 1 + 1e-4:
        return "its own leave the unit square"
    q = used.astype(np.float64)
    d1, d2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    if (np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) == 0).any():
        return "some of its triangles have no area in the texture"
    share = overlap_fraction(_own_uvs(soup))
    return f"its own overlap on {share:.1%} of the texture" if share > 0.002 else ""


def _plain(mesh: Mesh, size: int, textures: str, seed: int) -> Model:
    """Grey, or noise around it; the normal map is flat either way."""
    base = np.full((size, size, 4), 0.5, np.float32)
    specular = np.full((size, size, 3), [0, 0.5, 0], np.float32)
    if textures == "random":
        rng = np.random.default_rng(seed)
        base[...] = rng.random(base.shape, np.float32)
        specular[..., 1:] = rng.random((size, size, 2), np.float32) * [0.9, 0.2] + [0.1, 0]
    base[..., 3] = 1
    normal = np.zeros((size, size, 3), np.float32)
    normal[..., 2] = 1
    return Model(mesh, base, specular, normal)


def alpha_of(asset: Asset, base_color: np.ndarray) -> tuple[str, float]:
    """
    Alpha mode and cutoff for textures baked from an asset: OPAQUE where no texel is transparent, MASK unless it blends.
    """
    modes = {asset.parts[i.part].material.alpha_mode for i in asset.instances}
    if modes <= {"OPAQUE"} or float(base_color[..., 3].min()) > 0.999:
        return "OPAQUE", 0.5
    return ("BLEND" if "BLEND" in modes else "MASK"), 0.5
