"""
Skinning weights and joints as files have them, made into what linear blend skinning needs; what is broken is told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..errors import AssetError, MeshError
from ..model.asset import Instance, Part
from ..model.rig import Rig, Skin
from .validate import MAX_COORDINATE, check_indices

#: Name of the joint that carries what does not move.
STILL = "still"

#: Frames of a clip; longer ones are thinned.
MAX_FRAMES = 2000

#: Sums of weights that differ by more are worth a word.
_ROUNDING = 0.01


def make_skin(
    joints: np.ndarray, weights: np.ndarray, points: np.ndarray, n_joints: int, model: str, name: str,
    note: Callable[[str], None],
) -> Skin:  # fmt: skip
    """
    A skin of a file's influences.

    Parameters
    ----------
    joints, weights : ndarray, shape (V, K)
        As the file has them; joints of weight 0 may be anything.
    points : ndarray, shape (V, 3)
        Of the vertices; those without weights follow the closest vertex that has some.
    n_joints : int
        Joints that there are.
    model, name : str
        File and mesh, for messages.
    note : callable
        Takes a line on what was mended.

    Raises
    ------
    MeshError
        A weight is not finite, a joint out of range, or no vertex has any weight.
    """
    weights = np.asarray(weights, np.float64)
    if not np.isfinite(weights).all():
        raise MeshError(f"{model}: weights of '{name}' are NaN or infinite; normalise them and export again")
    if (weights < 0).any():
        note(f"{int((weights < 0).any(1).sum())} vertices of '{name}' had negative weights, which count as none")
        weights = np.maximum(weights, 0)
    joints = np.where(weights > 0, joints, 0).astype(np.int64)
    check_indices(joints.reshape(-1), n_joints, model, name, "joint")
    total = weights.sum(1)
    bound = total > 1e-6
    if len(bound) and not bound.any():
        raise MeshError(f"{model}: all weights of '{name}' are 0, so no joint moves it; bind it again and export")
    loose = ~bound
    if loose.any():
        nearest = np.flatnonzero(bound)[cKDTree(points[bound]).query(points[loose])[1]]
        joints[loose], weights[loose] = joints[nearest], weights[nearest]
        note(f"{int(loose.sum())} vertices of '{name}' had weights of sum 0; they follow the closest one that has any")
    off = bound & (np.abs(total - 1) > _ROUNDING)
    if off.any():
        note(f"weights of {int(off.sum())} vertices of '{name}' did not sum to 1; they were normalised")
    return Skin(joints, weights / weights.sum(1, keepdims=True))


def sorted_rig(
    names: list[str],
    parents: np.ndarray,
    bind: np.ndarray,
    poses: np.ndarray,
    codes: np.ndarray,
    rate: float,
    model: str,
) -> tuple[Rig, np.ndarray]:
    """
    A rig with parents before children and distinct names, and the new number of each joint, shape (J,).

    Parameters
    ----------
    names, parents, bind, poses, codes, rate
        As :class:`..model.rig.Rig` has them, in any order.
    model : str
        File, for messages.

    Raises
    ------
    AssetError
        The poses are not finite.
    """
    if not (np.isfinite(poses).all() and np.abs(poses).max() < MAX_COORDINATE):
        raise AssetError(f"{model}: the animation is not finite; export it again")
    depth = np.zeros(len(names), np.int64)
    for k in range(len(names)):
        j = k
        while parents[j] >= 0 and depth[k] <= len(names):
            j, depth[k] = parents[j], depth[k] + 1
    order = np.argsort(depth, kind="stable")
    new = np.empty_like(order)
    new[order] = np.arange(len(order))
    above = np.asarray(parents)[order]
    seen: dict[str, int] = {}
    distinct = []
    for k in order:
        n = seen[names[k]] = seen.get(names[k], 0) + 1
        distinct.append(names[k] if n == 1 else f"{names[k]}_{n}")
    above = np.where(above >= 0, new[above], -1)
    return Rig(tuple(distinct), above, bind[order], poses[:, order], np.asarray(codes, np.float64), rate), new


def renumbered(
    parts: Iterable[Part], instances: Iterable[Instance], is_rigid: Iterable[bool], new: np.ndarray, joints: list[int]
) -> tuple[tuple[Part, ...], tuple[Instance, ...]]:
    """
    Parts and instances that name the joints of a finished rig.

    Parameters
    ----------
    is_rigid : iterable of bool
        Of each instance, whether it follows a single joint instead of having a skin.
    new : ndarray, shape (J,)
        The rig's number of each joint that skins speak of.
    joints : list of int
        That of each rigid instance, in their order.
    """
    left = iter(joints)
    skinned = (p if p.skin is None else replace(p, skin=replace(p.skin, joints=new[p.skin.joints])) for p in parts)
    placed = (replace(i, joint=next(left)) if rigid else i for i, rigid in zip(instances, is_rigid, strict=True))
    return tuple(skinned), tuple(placed)
