"""
A budget of triangles shared out over the parts of an asset by what pictures show of them, so that none gets lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .coverage import Coverage
from .crumbs import components
from .decimate import Reduction

_VISIBLE = 1.0
"""Parts that fill less are allowed to go [pixels of the evaluation]."""
_LOST = 2 / 3
"""A part of whose pixels less is left counts as lost."""
_FIRST, _MOST = 4, 24
"""Triangles that are set aside for a part of a pixel, and for one of a hundred."""
_SET_ASIDE, _AT_MOST = 0.5, 0.8
"""Share of a budget that is set aside for parts, and that may be where it is short."""
_ROUNDS = 4
_HALFWAY = 4
"""Times the budget down to which it is the same way, however it is shared out."""


@dataclass(frozen=True)
class Shares:
    """
    What is set aside for parts.

    Parameters
    ----------
    least : ndarray, shape (C,), int64
        Triangles that each part keeps at least; 0 where it may go.
    needed : int
        Budget that has room for all of them.
    """

    least: np.ndarray
    needed: int


def shares(pixels: np.ndarray, size: np.ndarray, n_triangles: int, raised: np.ndarray | int = 1) -> Shares:
    """
    Triangles to set aside for parts, the larger in the pictures first.

    As many as a hull of a part takes, from 4 for a pixel to 24 for a hundred, and not more than the part has; less of
    those where that is more than half of the budget, and none for the smallest where that is not enough.

    Parameters
    ----------
    pixels : ndarray, shape (C,)
        Largest area in a picture [pixels of the evaluation].
    size : ndarray, shape (C,)
        Triangles of each part.
    n_triangles : int
        Budget.
    raised : ndarray, shape (C,), or int
        Times as many as usual: what turned out to be needed.
    """
    visible = pixels >= _VISIBLE
    root = np.sqrt(np.maximum(pixels, 0))
    hull = np.minimum(size, np.clip(_FIRST + 2 * (root - 1), _FIRST, _MOST).astype(np.int64) * raised) * visible
    small = np.minimum(size, np.clip(_FIRST + root // 4, _FIRST, 2 * _FIRST).astype(np.int64) * raised) * visible
    room = max(0.0, _SET_ASIDE * n_triangles - small.sum())
    blend = min(1.0, room / max(1, (hull - small).sum()))
    least = small + np.floor(blend * (hull - small)).astype(np.int64)
    order = np.argsort(-pixels, kind="stable")
    fits = np.empty(len(pixels), bool)
    fits[order] = np.cumsum(least[order]) <= _AT_MOST * n_triangles
    needed = int(np.ceil(small.sum() / _AT_MOST))
    return Shares(np.where(fits, least, 0), needed)


def reduce_parts(
    positions: np.ndarray,
    faces: np.ndarray,
    n_triangles: int,
    seen: np.ndarray,
    opaque: np.ndarray,
    names: np.ndarray,
    *,
    keep_hidden: bool = False,
    resolution: int = 256,
    size: int = 192,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str], list[str]]:
    """
    Decimate a surface of several parts, which are its connected components, so that none of them is lost unsaid.

    Parts that nobody can see from outside go first. The others have triangles set aside (:func:`shares`); after the
    decimation pictures of both surfaces are compared part by part, and what is lost gets more from the rest.

    Parameters
    ----------
    positions : ndarray, shape (P, 3)
        Welded.
    faces : ndarray, shape (F, 3)
    n_triangles : int
        Budget, at least 4.
    seen : ndarray, shape (P,)
        As :func:`.visibility.visibility` gives it.
    opaque : ndarray of bool, shape (F,)
        Faces that hide what lies behind them.
    names : ndarray of str, shape (F,)
        What each face belongs to, for the warnings.
    keep_hidden : bool
        Keep parts that are never seen from outside.
    resolution : int
        Side of a picture of the evaluation [pixels], by which a part is large enough to be missed.
    size : int
        Rays along a side of the pictures that are compared.

    Returns
    -------
    positions : ndarray, shape (Q, 3), float64
    faces : ndarray, shape (G, 3), int64
    part : ndarray, shape (Q,), int64
        Of each position, as :func:`.crumbs.components` numbers those of the input.
    notes : list of str
        What went unseen.
    warnings : list of str
        What is lost, and the budget that would hold it.
    """
    notes: list[str] = []
    label = components(faces, len(positions))
    of_face = label[faces[:, 0]]
    n_parts = int(of_face.max()) + 1
    if n_triangles >= len(faces) or n_parts == 1:
        whole = Reduction.of(positions, faces, seen, label).to(n_triangles, np.zeros(label.max() + 1, np.int64))
        return *whole.result(), notes, []
    if not keep_hidden:
        goes = _hidden(label, of_face, seen, n_parts, len(faces) - n_triangles)
        if goes.any():
            dropped = goes[of_face]
            notes.append(
                f"{_counted(int(goes.sum()), 'part')} that cannot be seen from outside "
                f"({dropped.sum():,} triangles) left out; --keep-hidden keeps such parts"
            )
            faces, of_face, opaque, names = (x[~dropped] for x in (faces, of_face, opaque, names))
    count = np.bincount(of_face, minlength=n_parts)
    solid = np.zeros(n_parts, bool)
    solid[of_face[opaque]] = True
    look = Coverage(positions, faces, of_face, solid, resolution, size)
    pixels = look.pixels
    if keep_hidden:
        pixels = np.where(count > 0, np.maximum(pixels, _VISIBLE), pixels)
    raised = np.ones(n_parts, np.int64)
    best: tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray, int] | None = None
    halfway = Reduction.of(positions, faces, seen, label)
    halfway = halfway.to(_HALFWAY * n_triangles, shares(pixels, count, n_triangles, 1).least, crumbs=False)
    for _ in range(_ROUNDS):
        share = shares(pixels, count, n_triangles, raised)
        p, f, component = halfway.to(n_triangles, share.least).result()
        of_new = component[f[:, 0]]
        left = look.left(p, f, of_new)
        if keep_hidden:
            left[(count > 0) & (np.bincount(of_new, minlength=n_parts) == 0)] = 0
        lost = (left < _LOST) & ((1 - left) * pixels >= _VISIBLE)
        loss = float(((1 - left) * pixels)[lost].sum())
        if best is None or loss < best[0]:
            best = loss, p, f, component, lost, share.needed
        if not lost.any() or (share.least[lost] == count[lost]).all():
            break
        raised = np.where(lost, 2 * raised, raised)
    assert best is not None
    loss, p, f, component, lost, needed = best
    if not lost.any():
        return p, f, component, notes, []
    needed = min(len(faces), -(-max(needed, share.needed, n_triangles * 5 // 4) // 10) * 10)
    which = np.flatnonzero(lost)[np.argsort(-pixels[lost], kind="stable")]
    return p, f, component, notes, [_warning(which, of_face, names, n_triangles, needed)]


def _hidden(label: np.ndarray, of_face: np.ndarray, seen: np.ndarray, n_parts: int, excess: int) -> np.ndarray:
    """Parts that nobody sees and that have to go, the largest first, shape (C,)."""
    most = np.zeros(n_parts + 1)
    np.maximum.at(most, label, seen)
    size = np.bincount(of_face, minlength=n_parts)
    order = np.argsort(-size, kind="stable")
    order = order[most[order] == 0]
    before = np.cumsum(size[order]) - size[order]
    goes = np.zeros(n_parts, bool)
    if len(order) < n_parts:  # else nothing would be left
        goes[order[before < excess]] = True
    return goes


def _counted(n: int, what: str) -> str:
    return f"{n:,} {what}" + ("s" if n != 1 else "")


def _warning(which: np.ndarray, of_face: np.ndarray, names: np.ndarray, n_triangles: int, needed: int) -> str:
    """One line that names the lost parts, the largest first."""
    found, first = np.unique(of_face, return_index=True)
    told = dict.fromkeys(str(names[k]) for k in first[np.searchsorted(found, which)])
    listed = ", ".join(list(told)[:6]) + (f" and {len(told) - 6} more" if len(told) > 6 else "")
    return (
        f"{_counted(len(which), 'part')} of the asset {'are' if len(which) != 1 else 'is'} lost or torn at "
        f"{n_triangles:,} triangles: {listed}; ask for about {needed:,} (--triangles {needed}) to keep them"
    )
