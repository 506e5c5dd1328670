"""
How many triangles a first guess gets, from what was asked for: a number, a share of the asset's, or vertices.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import numpy as np

from ..config import InitialSettings
from ..config.amounts import LEAST_TRIANGLES, resolved
from ..config.initial import LARGEST_ATLAS
from ..errors import MeshError
from ..model.asset import Asset
from ..model.mesh import Mesh
from .texels import atlas_side

_NEAR = 0.97
"""Share of a budget of vertices that is near enough."""

_ROUNDS = 6
"""Meshes that are made at most, if one of them fits."""

Made = tuple[Mesh, list[str]]


def settled(settings: InitialSettings, asset: Asset) -> InitialSettings:
    """
    The settings with numbers for what depends on the asset: a budget that was a share of its triangles, and the side of
    the atlas.
    """
    if isinstance(settings.triangles, str):
        settings = settings.model_copy(update={"triangles": resolved(settings.triangles, asset.n_triangles)})
    if settings.atlas_size == "auto":
        named = settings.triangles is None and settings.vertices is None  # else it is up to a mesh of the user's own
        size = LARGEST_ATLAS if named else atlas_side(settings, asset, budget(settings))
        settings = settings.model_copy(update={"atlas_size": size})
    return settings


def budget(settings: InitialSettings) -> int:
    """
    The triangles asked for; of a budget of vertices about as many as it is enough for.

    Raises
    ------
    MeshError
        None are, as settings for a mesh of the user's own have it; or a share is, which :func:`settled` resolves.
    """
    if settings.vertices is not None:
        # A card has four vertices and two triangles; a surface with seams and creases about one a triangle.
        return max(LEAST_TRIANGLES, settings.vertices // 2 if settings.kind == "cards" else settings.vertices)
    if not isinstance(settings.triangles, int):
        raise MeshError("a budget of triangles is needed: name it")
    return settings.triangles


def within_budget(make: Callable[[int], Made], settings: InitialSettings, most: int | None = None) -> Made:
    """
    The unwrapped mesh that a budget asks for.

    The number of vertices of a file is known only once a mesh is unwrapped; it grows about as the triangles do. So a
    few meshes are made, each of as many triangles as the one before suggests, until a budget of vertices is nearly
    used.

    Parameters
    ----------
    make : callable
        ``make(triangles) -> mesh, notes``.
    settings : InitialSettings
        With ``triangles`` as a number, or ``vertices``.
    most : int, optional
        Triangles that there are.

    Raises
    ------
    MeshError
        No mesh has so few vertices.
    """
    if settings.vertices is None:
        return make(budget(settings))
    wanted, best = settings.vertices, None
    few, many = LEAST_TRIANGLES - 1, (most or 4 * wanted) + 1  # that fit, that do not or are not there
    triangles = min(budget(settings), many - 1)
    for n_made in count(1):
        mesh, notes = make(triangles)
        n = len(mesh.uvs)
        if n <= wanted:
            few = triangles
            if best is None or n > len(best[0].uvs):
                best = mesh, notes
        else:
            many = triangles
        # Vertices do not grow evenly with triangles: that nothing has fitted so far does not say that nothing does.
        if _NEAR * wanted <= n <= wanted or many - few <= 1 or (n_made >= _ROUNDS and best is not None):
            break
        aim = round(triangles * 0.99 * wanted / n)
        triangles = int(np.clip(aim, few + 1, many - 1))
    if best is None:
        raise MeshError(
            f"a budget of {wanted} vertices is too small: {n} are needed for {triangles} triangles, seams and creases "
            f"counted; ask for at least --vertices {n}"
        )
    mesh, notes = best
    return mesh, [f"{len(mesh.faces)} triangles have {len(mesh.uvs)} vertices, of {wanted} asked for", *notes]
