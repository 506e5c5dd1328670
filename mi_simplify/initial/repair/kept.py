"""
A low-poly mesh of the user's own as the first guess.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...config import InitialSettings
from ...config.initial import LARGEST_ATLAS
from ...errors import MeshError
from ...model.asset import Asset
from ...model.mesh import Mesh
from ...model.tangents import split_mirrored
from ...model.topology import normal_groups
from ..closest import ClosestPoints
from ..reduce.cleanup import clean
from ..soup import Soup, merge
from ..unwrap.atlas import overlap_fraction
from ..unwrap.charting import check, unwrap
from .repair import repair

#: What the configuration has where nothing is said.
_DEFAULTS = InitialSettings()


def keep_mesh(
    init: Asset,
    *,
    reference: ClosestPoints | None = None,
    keep_uv: bool = False,
    atlas_size: int = LARGEST_ATLAS,
    padding: int = _DEFAULTS.padding,
    crease_angle: float = _DEFAULTS.crease_angle,
) -> tuple[Mesh, list[str]]:
    """
    A low-poly mesh, cleaned and perhaps repaired, with its own UVs if they can be baked to and new ones if not.

    Parameters
    ----------
    init : Asset
        All its parts become one mesh.
    reference : ClosestPoints, optional
        The detailed surface to repair the mesh by, see :func:`repair`; without it no vertex moves.
    keep_uv : bool
        Refuse a mesh whose UVs cannot be baked to instead of making new ones.
    atlas_size, padding, crease_angle
        As for :func:`unwrap`. A mesh that keeps its UVs has creases along their seams only: inside a chart the texels
        of one side would bleed into the other.

    Returns
    -------
    mesh : Mesh
    notes : list of str
        What was cleaned up, why there are new UVs, and the warnings of the check.

    Raises
    ------
    MeshError
        ``keep_uv``, and the UVs overlap, are missing, or have no area.
    """
    soup, notes = clean(merge(init))
    why = _unusable(init, soup)
    if why and keep_uv:
        raise MeshError(
            f"the texture coordinates of {init.name} cannot be kept: {why}; lay them out without overlap, or let the "
            "mesh be unwrapped anew (without --keep-uv)"
        )
    if reference is not None:
        positions, index, more = repair(soup.positions, soup.position_faces, reference)
        soup = replace(soup, positions=positions, position_index=index[soup.position_index])
        notes += more
    if why:
        notes.append(f"new texture coordinates: {why}")
        mesh, more = unwrap(
            soup.positions, soup.position_faces, atlas_size=atlas_size, padding=padding, crease_angle=crease_angle
        )  # fmt: skip
        return mesh, notes + more
    mesh = split_mirrored(_with_creases(_own_uvs(soup), crease_angle))
    return mesh, notes + check(mesh, atlas_size)


def _own_uvs(soup: Soup) -> Mesh:
    """The soup with its vertices merged where position and UV agree."""
    rows = np.column_stack([soup.position_index, soup.uvs])
    rows, index = np.unique(rows, axis=0, return_inverse=True)
    used, faces = np.unique(index.reshape(-1)[soup.faces], return_inverse=True)
    rows = rows[used]
    kept, position_index = np.unique(rows[:, 0].astype(np.int64), return_inverse=True)
    return Mesh(soup.positions[kept], position_index, rows[:, 1:].astype(np.float32), faces.reshape(-1, 3))


def _with_creases(mesh: Mesh, angle: float) -> Mesh:
    """Two normals along sharp edges where the vertices are split already: normal groups that share a vertex are one."""
    groups = normal_groups(mesh.positions, mesh.position_faces, angle)
    n, n_groups = len(mesh.uvs), int(groups.max()) + 1
    links = (mesh.faces.ravel(), n + groups.ravel())
    graph = coo_array((np.ones(groups.size, bool), links), shape=(n + n_groups,) * 2)
    _, label = connected_components(graph, directed=False)
    _, normal_index = np.unique(label[:n], return_inverse=True)
    return replace(mesh, normal_index=normal_index)


def _unusable(init: Asset, soup: Soup) -> str:
    """Why the UVs of a mesh cannot be baked to; empty if they can."""
    if any(init.parts[i.part].uvs is None for i in init.instances):
        return "the mesh has none everywhere"
    used = soup.uvs[soup.faces]
    if used.min() < -4 or used.max() > 5:
        return "its own reach over many copies of the texture"
    q = used.astype(np.float64)
    d1, d2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    if (np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) == 0).any():
        return "some of its triangles have no area in the texture"
    share = overlap_fraction(_own_uvs(soup))
    return f"its own overlap on {share:.1%} of the texture" if share > 0.002 else ""
