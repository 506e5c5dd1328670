"""
The outlines that a batch of views sees, in short pieces, and which piece lies nearest to a place on the film.

An outline is an edge across which the image can jump: a silhouette, an open edge or a crease. A piece is looked at from
both sides of its middle, and left out where something hides it. A grid of cells over the films holds the pieces near
each cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ...machine.frozen import frozen
from ...machine.meshes import MISS
from ..camera import Cameras, FilmRays, film_samples
from ..edge_rays import EdgeRays
from ..edge_samples import EdgeSamples
from ..edge_set import EdgeSet
from ..gbuffer import trace

#: No piece.
NONE = 0xFFFFFFFF

#: How far off an outline either side is looked at [pixels]: nearer to a vertex rays slip between its faces.
_STEP = 2e-3

#: Distance from an edge below which a ray may meet either side of it [pixels].
_AT_EDGE = 1e-2


@dataclass
class Pieces:
    """
    Parts of edges as the films see them; detached.

    ``end0 end1`` are positions, ``s0 s1`` the fractions between them where the piece begins and ends, (x0, y0) and
    (x1, y1) the film positions of both [pixels], (nx, ny) the unit normal of the edge on the film and ``step`` how far
    off the edge [pixels] either side is looked at. ``inner`` is 1 where the mesh is on
    both sides of the piece: creases, folds, one part before another; 0 where the background is on one.
    """

    view: mi.UInt32
    end0: mi.UInt32
    end1: mi.UInt32
    s0: mi.Float
    s1: mi.Float
    x0: mi.Float
    y0: mi.Float
    x1: mi.Float
    y1: mi.Float
    nx: mi.Float
    ny: mi.Float
    step: mi.Float
    inner: mi.Float

    def closest(self, index: mi.UInt32, x: mi.Float, y: mi.Float, active=True) -> tuple[mi.Float, mi.Float]:
        """Film position on a piece that is closest to another."""
        x0, y0, x1, y1 = (dr.gather(mi.Float, a, index, active) for a in (self.x0, self.y0, self.x1, self.y1))
        return closest_on_segment(x, y, x0, y0, x1, y1)


@dataclass
class Nearest:
    """
    For every camera ray within reach of an outline, the piece that is nearest to it on the film; detached.

    Parameters
    ----------
    ray : mi.UInt32, width M
        Which of the N camera rays, ascending.
    slot : mi.UInt32, width N
        Where a camera ray stands among the M, :data:`NONE` where it is out of reach.
    end0, end1, s0, s1
        Of the piece, width M.
    off_x, off_y : mi.Float, width M
        From the closest point on the piece to just beyond the edge, seen from the ray [pixels].
    at_edge : mi.Bool, width M
        Whether the ray is so near that rounding may have it on the other side.
    """

    ray: mi.UInt32
    slot: mi.UInt32
    end0: mi.UInt32
    end1: mi.UInt32
    s0: mi.Float
    s1: mi.Float
    off_x: mi.Float
    off_y: mi.Float
    at_edge: mi.Bool


def nothing_near(n_rays: int) -> Nearest:
    """
    That none of N rays is near an outline; M is 1, a place that no ray refers to.
    """
    no, none = dr.zeros(mi.UInt32, 1), dr.zeros(mi.Float, 1)
    near = Nearest(no, dr.full(mi.UInt32, NONE, n_rays), no, no, none, none, none, none, dr.zeros(mi.Bool, 1))
    dr.make_opaque(near)
    return near


def closest_on_segment(x, y, x0, y0, x1, y1) -> tuple[mi.Float, mi.Float]:
    """
    Point of a segment of the plane that is closest to (x, y); differentiable.
    """
    dx, dy = x1 - x0, y1 - y0
    t = dr.clip((dx * (x - x0) + dy * (y - y0)) / dr.maximum(dx * dx + dy * dy, 1e-12), 0, 1)
    return dr.fma(t, dx, x0), dr.fma(t, dy, y0)


def nearest_outlines(
    edges: EdgeSet, scene: mi.Scene, positions: mi.Float, rays: FilmRays, reach: float, handicap: float
) -> Nearest | None:
    """
    The nearest piece of an outline that is seen, for all camera rays that one is within reach of.

    Parameters
    ----------
    scene : mi.Scene
        Of the mesh at these positions alone.
    positions : mi.Float, width P·3
        Welded, detached.
    reach : float
        Distance on the film [pixels].
    handicap : float
        How much farther away inner pieces count [pixels]: smooth surfaces have folds right beside their silhouettes,
        and these must not take their place.

    Returns
    -------
    Nearest or None
        None where no ray is within reach of anything.

    Notes
    -----
    Four numbers are read back: of pieces, of those seen, of entries in the cells, of rays.
    """
    cameras, length = rays.cameras, max(2.0, reach)
    ends = _counts(edges, positions, cameras, length, reach)
    n = _last(ends)
    if n == 0:
        return None
    lane = dr.arange(mi.UInt32, n)
    dr.eval(lane)
    pieces, middles = _pieces(edges, positions, cameras, ends, lane, reach)
    pieces = _seen(edges, scene, cameras, pieces, middles)
    if pieces is None:
        return None
    cell = max(4, -(-int(2 * reach) // 4) * 4)
    spans = _spans(pieces, cameras, cell, reach)
    n = _last(spans)
    if n == 0:
        return None
    lane = dr.arange(mi.UInt32, n)
    dr.eval(lane)
    first, items = _filled(pieces, spans, cameras, cell, reach, lane)
    found = _closest(pieces, first, items, rays, cell, reach, handicap)
    ray = dr.compress(found != NONE)
    return _gathered(pieces, found, ray, rays) if dr.width(ray) else None


def _last(running_sum: mi.UInt32) -> int:
    return int(dr.gather(mi.UInt32, running_sum, dr.width(running_sum) - 1)[0])


@frozen()
def _counts(edges: EdgeSet, positions: mi.Float, cameras: Cameras, length: float, reach: float) -> mi.UInt32:
    """
    Running sum of the pieces of every edge in every view; none of edges that do not matter there.
    """
    planes = edges.planes(positions)
    dr.eval(planes)
    pair = dr.arange(mi.UInt32, edges.n_edges * cameras.n_views)
    view = pair // edges.n_edges
    segment = edges.segment(positions, cameras, view, pair - view * edges.n_edges, reach)
    matters = segment.visible & (edges.density(planes, cameras, view, segment) > 0)
    count = dr.select(matters, mi.UInt32(dr.clip(dr.ceil(segment.length / length), 1, 4096)), 0)
    dr.eval(count)
    return dr.cumsum(count)


@frozen("lane")
def _pieces(
    edges: EdgeSet, positions: mi.Float, cameras: Cameras, ends: mi.UInt32, lane: mi.UInt32, reach: float
) -> tuple[Pieces, EdgeSamples]:
    """
    All pieces, and a sample in the middle of each.
    """
    planes = edges.planes(positions)
    dr.eval(planes)
    n_pairs = edges.n_edges * cameras.n_views
    pair = mi.UInt32(dr.binary_search(0, n_pairs - 1, lambda i: dr.gather(mi.UInt32, ends, i) <= lane))
    first = dr.select(pair > 0, dr.gather(mi.UInt32, ends, dr.maximum(pair, 1) - 1), 0)
    count = mi.Float(dr.gather(mi.UInt32, ends, pair) - first)
    view = pair // edges.n_edges
    segment = edges.segment(positions, cameras, view, pair - view * edges.n_edges, reach)
    low, high = mi.Float(lane - first) / count, mi.Float(lane - first + 1) / count

    x, y = (lambda tau: dr.lerp(segment.x0, segment.x1, tau)), (lambda tau: dr.lerp(segment.y0, segment.y1, tau))
    middle = 0.5 * (low + high)
    depth = dr.rcp(dr.lerp(dr.rcp(dr.maximum(segment.z0, 1e-3)), dr.rcp(dr.maximum(segment.z1, 1e-3)), middle))
    step, outline = dr.maximum(edges.step(cameras, view, depth), _STEP), edges.outline(planes, cameras, view, segment)
    end0, end1, along = segment.row.x, segment.row.y, segment.fraction
    pieces = Pieces(
        view, end0, end1, along(low), along(high), x(low), y(low), x(high), y(high), segment.nx, segment.ny, step,
        mi.Float(0),
    )  # fmt: skip
    return pieces, EdgeSamples(
        view, end0, end1, along(middle), x(middle), y(middle), segment.nx, segment.ny, mi.Float(0), step, depth, outline
    )


def _seen(edges: EdgeSet, scene: mi.Scene, cameras: Cameras, pieces: Pieces, middles: EdgeSamples) -> Pieces | None:
    """
    The pieces that nothing hides, by what the rays to either side of their middles meet.
    """
    n = dr.width(pieces.view)
    rays, lane = EdgeRays(cameras, middles), dr.arange(mi.UInt32, 2 * n)
    _, origin, direction = rays.at(lane)
    face, t = trace(scene, origin, direction)
    near = (face != MISS) & rays.near(lane, direction, t)
    met = (face != MISS) & rays.seen(lane, face, edges, direction, t)
    hit = face != MISS
    dr.eval(near, met, hit)
    sides = lambda flags: [dr.gather(mi.Bool, flags, dr.arange(mi.UInt32, n) * 2 + k) for k in (0, 1)]  # noqa: E731
    # Where both sides of an outline are as far away as it is, a surface just in front of it hides it: nothing jumps
    # there, and taken for the nearest it would keep the true outline from being seen.
    smooth = middles.outline & sides(near)[0] & sides(near)[1]
    pieces.inner = dr.select(sides(hit)[0] & sides(hit)[1], mi.Float(1), 0)
    keep = dr.compress(middles.shows(*sides(met)) & ~smooth)
    return _kept(pieces, keep) if dr.width(keep) else None


@frozen("pieces", "keep")
def _kept(pieces: Pieces, keep: mi.UInt32) -> Pieces:
    return Pieces(*(dr.gather(type(a), a, keep) for a in vars(pieces).values()))


def _box(pieces: Pieces, cameras: Cameras, cell: int, reach: float) -> list[mi.UInt32]:
    """First column and row of cells within reach of each piece, and how many of both."""
    out = []
    for a, b, size in ((pieces.x0, pieces.x1, cameras.width), (pieces.y0, pieces.y1, cameras.height)):
        last = -(-size // cell) - 1
        low, high = dr.minimum(a, b) - reach, dr.maximum(a, b) + reach
        low, high = (mi.UInt32(dr.clip(dr.floor(v / cell), 0, last)) for v in (low, high))
        out.append((low, high - low + 1))
    (column, columns), (row, rows) = out
    return [column, row, columns, rows]


@frozen("pieces")
def _spans(pieces: Pieces, cameras: Cameras, cell: int, reach: float) -> mi.UInt32:
    """
    Running sum of the cells that each piece is entered in.
    """
    _, _, columns, rows = _box(pieces, cameras, cell, reach)
    count = columns * rows
    dr.eval(count)
    return dr.cumsum(count)


def _filled(
    pieces: Pieces, spans: mi.UInt32, cameras: Cameras, cell: int, reach: float, lane: mi.UInt32
) -> tuple[mi.UInt32, mi.UInt32]:
    """
    Where the entries of each cell begin, and the entries: pieces.
    """
    n_pieces = dr.width(pieces.view)
    piece = mi.UInt32(dr.binary_search(0, n_pieces - 1, lambda i: dr.gather(mi.UInt32, spans, i) <= lane))
    within = lane - dr.select(piece > 0, dr.gather(mi.UInt32, spans, dr.maximum(piece, 1) - 1), 0)
    column, row, columns, _ = _box(_kept_of(pieces, piece), cameras, cell, reach)
    down = within // columns
    n_columns, n_rows = -(-cameras.width // cell), -(-cameras.height // cell)
    view = dr.gather(mi.UInt32, pieces.view, piece)
    target = (view * n_rows + row + down) * n_columns + column + (within - down * columns)
    count = dr.zeros(mi.UInt32, n_columns * n_rows * cameras.n_views)
    rank = dr.scatter_inc(count, target)
    dr.eval(rank, target, piece, count)
    first = dr.cumsum(count) - count
    items = dr.zeros(mi.UInt32, dr.width(lane))
    dr.scatter(items, piece, dr.gather(mi.UInt32, first, target) + rank)
    first = dr.concat([first, mi.UInt32(dr.width(lane))])
    dr.eval(first, items)
    return first, items


def _kept_of(pieces: Pieces, index: mi.UInt32) -> Pieces:
    return Pieces(*(dr.gather(type(a), a, index) for a in vars(pieces).values()))


@frozen("pieces", "items")
@dr.syntax
def _closest(
    pieces: Pieces, first: mi.UInt32, items: mi.UInt32, rays: FilmRays, cell: int, reach: float, handicap: float
) -> mi.UInt32:
    """
    Nearest piece of every camera ray, :data:`NONE` out of reach.
    """
    cameras = rays.cameras
    _, view, x, y = film_samples(cameras, rays.spp, rays.seed)
    n_columns, n_rows = -(-cameras.width // cell), -(-cameras.height // cell)
    at = (view * n_rows + mi.UInt32(y) // cell) * n_columns + mi.UInt32(x) // cell
    k, end = dr.gather(mi.UInt32, first, at), dr.gather(mi.UInt32, first, at + 1)
    best, least = mi.UInt32(NONE), mi.Float(dr.inf)
    while k < end:
        piece = dr.gather(mi.UInt32, items, k)
        ex, ey = pieces.closest(piece, x, y)
        d = dr.sqrt(dr.square(x - ex) + dr.square(y - ey))
        key = dr.select(d < reach, d + dr.gather(mi.Float, pieces.inner, piece) * handicap, dr.inf)
        # Ties, at the common end of two pieces, go to the first piece, in whatever order the cell holds them.
        nearer = (key < least) | ((key == least) & (key < dr.inf) & (piece < best))
        best, least = dr.select(nearer, piece, best), dr.select(nearer, key, least)
        k += 1
    return best


@frozen("pieces", "ray")
def _gathered(pieces: Pieces, found: mi.UInt32, ray: mi.UInt32, rays: FilmRays) -> Nearest:
    slot = dr.full(mi.UInt32, NONE, dr.width(found))
    dr.scatter(slot, dr.arange(mi.UInt32, dr.width(ray)), ray)
    piece = _kept_of(pieces, dr.gather(mi.UInt32, found, ray))
    _, _, x, y = film_samples(rays.cameras, rays.spp, rays.seed, ray)
    ex, ey = closest_on_segment(x, y, piece.x0, piece.y0, piece.x1, piece.y1)
    dx, dy = x - ex, y - ey
    length = dr.sqrt(dx * dx + dy * dy)
    far = length > 1e-4
    inv = dr.rcp(dr.maximum(length, 1e-4))
    nx, ny = dr.select(far, dx * inv, piece.nx), dr.select(far, dy * inv, piece.ny)
    off = (-piece.step * nx, -piece.step * ny)
    return Nearest(ray, slot, piece.end0, piece.end1, piece.s0, piece.s1, *off, length < _AT_EDGE)
