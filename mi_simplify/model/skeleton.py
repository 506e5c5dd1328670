"""
Skeleton and clip as files have them: local translations, rotations and scales, and sorted weights.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from .rig import Rig
from .rigging import Rigging

log = logging.getLogger("mi_simplify")


@dataclass(frozen=True)
class Skeleton:
    """
    A rig in local transforms, ``T R S`` each.

    Parameters
    ----------
    names : tuple of str
    parents : ndarray, shape (J,)
        Before their children; -1 for none.
    bind : ndarray, shape (J, 4, 4)
        Joint to world in the bind pose: rotations and translations alone.
    translations, scales : ndarray, shape (T, J, 3), float32
    rotations : ndarray, shape (T, J, 4), float32
        Unit quaternions x y z w, each on the side of the one before.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    bind: np.ndarray
    translations: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray


def skeleton_of(rig: Rig) -> Skeleton:
    """
    The skeleton of a rig.

    Any constant in a joint's own frame cancels between bind pose and pose, so that scale and shear of the bind pose are
    taken out of both: what is left of them are scales that are animated, and units never get into the half precision
    that USD keeps scales in. A pose that shears is written as the closest one that does not, with a warning.
    """
    u, s, vt = np.linalg.svd(rig.bind[:, :3, :3])
    mirrored = np.linalg.det(u @ vt) < 0
    s, vt = s * np.where(mirrored[:, None], [1, 1, -1], 1), vt
    u = u * np.where(mirrored[:, None, None], [1, 1, -1], 1)
    stretch = np.tile(np.eye(4), (len(s), 1, 1))
    stretch[:, :3, :3] = np.swapaxes(vt, 1, 2) @ (s[:, :, None] * vt)
    out = np.linalg.inv(stretch)
    bind, poses = rig.bind @ out, rig.poses @ out
    above = np.where(rig.parents[:, None, None] >= 0, poses[:, rig.parents], np.eye(4))
    curves, sheared = decomposed(np.linalg.inv(above) @ poses)
    if sheared.any():
        names = ", ".join(np.array(rig.names)[sheared][:3])
        log.warning("joints shear in the animation, which no file can hold; written without shear: %s", names)
    return Skeleton(rig.names, rig.parents, bind, curves["translation"], curves["rotation"], curves["scale"])


def decomposed(local: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """
    Transforms over time as translations, rotations and scales.

    Parameters
    ----------
    local : ndarray, shape (T, J, 4, 4)

    Returns
    -------
    curves : dict
        ``translation`` and ``scale``, shape (T, J, 3), and ``rotation``, unit quaternions x y z w, shape (T, J, 4),
        each on the side of the one before; float32.
    sheared : ndarray, shape (J,), bool
        Those that shear as well: they have the closest rotation.
    """
    linear = local[..., :3, :3]
    scales = np.linalg.norm(linear, axis=-2)
    scales[..., 2] *= np.where(np.linalg.det(linear) < 0, -1, 1)
    rotations = linear / np.where(np.abs(scales) > 1e-12, scales, 1)[..., None, :]
    u, _, vt = np.linalg.svd(rotations)
    straight = u @ vt
    sheared = np.abs(straight - rotations).max((0, 2, 3)) > 1e-3
    curves = {
        "translation": local[..., :3, 3], "rotation": _continuous(_quaternions(straight)), "scale": scales,
    }  # fmt: skip
    return {path: curve.astype(np.float32) for path, curve in curves.items()}, sheared


def influences(rigging: Rigging) -> tuple[np.ndarray, np.ndarray]:
    """
    Joints and weights of all positions, the strongest first, of a number that files take: 4 or 8.

    Returns
    -------
    joints : ndarray, shape (P, K), int64
    weights : ndarray, shape (P, K), float32
        Of sum 1 to the last bit but one.
    """
    skin = rigging.skin(rigging.influences)
    k = 4 if skin.joints.shape[1] <= 4 else 8
    pad = ((0, 0), (0, k - skin.joints.shape[1]))
    joints, weights = np.pad(skin.joints, pad), np.pad(skin.weights, pad).astype(np.float32)
    weights[:, 0] = 1 - weights[:, 1:].astype(np.float64).sum(1)
    return joints, weights


def _quaternions(rotations: np.ndarray) -> np.ndarray:
    """Unit quaternions x y z w of rotation matrices, shape (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat().reshape(*rotations.shape[:-2], 4)


def _continuous(q: np.ndarray) -> np.ndarray:
    """Of the two quaternions of a rotation the one closer to that of the frame before, shape (T, J, 4)."""
    same = np.einsum("tji,tji->tj", q[1:], q[:-1]) >= 0
    sign = np.cumprod(np.concatenate([np.ones((1, q.shape[1])), np.where(same, 1, -1)]), axis=0)
    return q * sign[..., None]
