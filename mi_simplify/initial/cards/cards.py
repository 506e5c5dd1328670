"""
Textured cards as the first guess for foliage: every cluster of leaves becomes a quad that shows what it looks like.
"""

from __future__ import annotations

import numpy as np

from ...config.initial import LARGEST_ATLAS
from ...errors import MeshError
from ...machine.runtime import ensure_variant
from ...model.asset import Asset
from ...model.mesh import Mesh
from ...model.model import Model
from ...model.topology import area_vectors
from ..soup import Soup, merge
from .clusters import Clusters, cluster_faces, pieces
from .crossing import crossing_cards
from .layout import Layout, lay_out

#: What the configuration has where nothing is said.


def cards(
    asset: Asset, triangles: int, *, atlas_size: int = LARGEST_ATLAS, samples: int = 3, output: str = "mask"
) -> tuple[Model, list[str]]:
    """
    Quads that cover an asset's clusters, colour, opacity and normal baked into one atlas.

    Planes are chosen as :func:`cluster_faces` says. A quad is larger than what its cluster covers on its plane by the
    share that the plane hides of the cluster's area (Cauchy's formula), so that over all directions as much is covered.

    Parameters
    ----------
    asset : Asset
    triangles : int
        Budget; two a card.
    atlas_size : int
        Side of the atlas [texels].
    samples : int
        ``samples``² rays for each texel and side.
    output : {'mask', 'blend', 'opaque'}
        Cut out at an opacity of one half, which then is exceeded on as much of a card as was covered; transparent, the
        opacity the share of a texel that is covered; or quads of the same area without opacity.

    Returns
    -------
    model : Model
    notes : list of str

    Raises
    ------
    MeshError
        The budget is below one card, or the atlas too small for the cards.
    """
    if triangles < 2:
        raise MeshError(f"a budget of {triangles} triangles is too small for a card; ask for at least 2")
    ensure_variant()
    from .bake import bake_cards  # traces rays

    soup, node, group = _with_nodes(asset, triangles // 2)
    corners = soup.positions[soup.position_faces]
    piece = pieces(soup.position_faces, node)
    clusters = cluster_faces(corners, piece, group, triangles // 2)
    if len(clusters) == 0:
        raise MeshError(f"{asset.name}: no face has an area, there is nothing to put on cards")
    layout = lay_out(clusters, corners, atlas_size)
    images = bake_cards(soup, clusters, layout, atlas_size, samples)
    n_groups = int(group.max()) + 1
    notes = [
        f"{len(clusters)} cards for {piece.max() + 1} pieces in {n_groups} node{'s' * (n_groups > 1)}, "
        f"{np.sqrt(layout.cells.prod(1).mean()):.1f} texels a side"
    ]
    base = images["base_color"]
    shape, reach = _RECTANGLE, np.ones(len(clusters))
    if output == "mask":
        base[..., 3] = masked(base[..., 3], layout)
    elif output == "opaque":
        shape, reach = equal_areas(base[..., 3], layout)
        base[..., 3] = 1
    mesh = card_mesh(clusters, layout, atlas_size, shape, reach)
    crossing = crossing_cards(mesh.positions.reshape(-1, 4, 3))
    if crossing and output != "opaque":
        notes.append(
            f"{crossing} pairs of cards cut through each other; how their order changes there is missing in the fit's "
            "derivatives"
        )
    mode = {"mask": "MASK", "blend": "BLEND", "opaque": "OPAQUE"}[output]
    return Model(mesh, base, images["specular"], images["normal"], mode, name=asset.name), notes


def _with_nodes(asset: Asset, n_cards: int) -> tuple[Soup, np.ndarray, np.ndarray]:
    """
    The asset's triangles; for each its placement, shape (F,), and the node that its clusters stay within, shape (F,).

    That is the deepest level of the tree with four cards a node, so that there is something to choose.
    """
    placed = [i for i in asset.instances if len(asset.parts[i.part].faces)]
    counts = [len(asset.parts[i.part].faces) for i in placed]
    paths = [i.node.split("/") if i.node else [] for i in placed]
    group = np.zeros(len(placed), np.int64)
    for depth in range(1, max((len(p) for p in paths), default=0) + 1):
        names, level = np.unique(["/".join(p[:depth]) for p in paths], return_inverse=True)
        if len(names) > max(n_cards // 4, 1):
            break
        group = level
    soup = merge(asset)
    return soup, np.repeat(np.arange(len(placed)), counts), np.repeat(group, counts)


#: Corners of a card between its sides, counter-clockwise seen along the normal.
_RECTANGLE = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
_KITE = np.array([[-1.0, 0], [0, -1], [1, 0], [0, 1]])


def card_mesh(clusters: Clusters, layout: Layout, atlas_size: int, shape: np.ndarray, reach: np.ndarray) -> Mesh:
    """
    Two triangles a card, grown about the cluster's centre.

    Parameters
    ----------
    shape : ndarray, shape (4, 2) or (C, 4, 2)
        Corners between the sides of the layout's rectangles, from -1 to 1.
    reach : ndarray, shape (C,)
        Factor of the corners about the middle of the rectangles; their texels stay within these.
    """
    n, middle, half = len(clusters), (layout.low + layout.high) / 2, (layout.high - layout.low) / 2
    local = middle[:, None] + half[:, None] * (shape * reach[:, None, None])  # (C, 4, 2)
    shown = middle[:, None] + half[:, None] * (shape * np.minimum(reach, 1)[:, None, None])
    grown = local * np.sqrt(clusters.growth)[:, None, None]
    positions = clusters.centre[:, None] + np.einsum("cka,cai->cki", grown, clusters.axes[:, :2])
    texel = layout.texel(np.arange(n)[:, None], shown)
    faces = (4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    uvs = (texel.reshape(-1, 2) / atlas_size).astype(np.float32)
    return Mesh(positions.reshape(-1, 3), np.arange(4 * n), uvs, faces)


def masked(opacity: np.ndarray, layout: Layout) -> np.ndarray:
    """
    The opacity of each card scaled so that it exceeds one half on as many texels as it covers in all.

    Parameters
    ----------
    opacity : ndarray, shape (S, S)
    """
    place, card, _ = layout.texels(len(opacity))
    values = opacity.ravel()[place]
    order = np.lexsort((-values, card))
    start = np.searchsorted(card[order], np.arange(len(layout.cells)))
    wanted = np.bincount(card, values, len(layout.cells))
    rank = np.clip(np.rint(wanted).astype(np.int64) - 1, 0, layout.cells.prod(1) - 1)
    threshold = np.maximum(values[order][start + rank], 1e-3)
    out = opacity.copy().ravel()
    out[place] = np.clip(values * (0.5 / threshold)[card], 0, 1)
    return out.reshape(opacity.shape)


def equal_areas(opacity: np.ndarray, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """
    A rectangle or a kite for each card, whichever meets more of what it covers, of the same area.

    Returns
    -------
    shape : ndarray, shape (C, 4, 2)
    reach : ndarray, shape (C,)
        As for :func:`card_mesh`.
    """
    place, card, at = layout.texels(len(opacity))
    values, n = opacity.ravel()[place], len(layout.cells)
    # The margin and what is beyond it are no part of the card's own rectangle.
    size = ((layout.high - layout.low) * layout.density).prod(1)
    fill = np.clip(np.bincount(card, values, n) / size, 1e-4, 1)
    reaches = np.stack([np.sqrt(fill), np.sqrt(2 * fill)])
    inside = np.stack([np.abs(at).max(1), np.abs(at).sum(1)]) <= reaches[:, card]
    met = np.stack([np.bincount(card, values * x, n) for x in inside])
    best = met.argmax(0)
    return np.stack([_RECTANGLE, _KITE])[best], reaches[best, np.arange(n)]


def is_aggregate(asset: Asset, triangles: int) -> str:
    """
    Why an asset wants cards instead of decimation; empty where it does not.

    Many separate small pieces, for which the budget leaves less than a dozen triangles each: collapsing edges would
    take most of them away.
    """
    soup, node, _ = _with_nodes(asset, 1)
    piece = pieces(soup.position_faces, node)
    corners = soup.positions[soup.position_faces]
    area = np.linalg.norm(area_vectors(corners), axis=1)
    n = int(piece.max()) + 1
    order = np.argsort(piece, kind="stable")
    start = np.searchsorted(piece[order], np.arange(n))
    low = np.minimum.reduceat(corners.min(1)[order], start)
    high = np.maximum.reduceat(corners.max(1)[order], start)
    small = np.linalg.norm(high - low, axis=1) < 0.25 * soup.diagonal
    share = np.bincount(piece, area, n)[small].sum() / max(area.sum(), 1e-300)
    if small.sum() < 100 or share < 0.5 or triangles > 12 * n:
        return ""
    return f"{small.sum()} small separate pieces make up {share:.0%} of the surface, {triangles / n:.1f} triangles each"
