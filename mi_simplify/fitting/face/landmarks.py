"""
A morphable model from landmarks alone: camera poses, scale and weights, before anything is rendered; plain NumPy.

Cameras look along +Z with X to the right and Y down, pixels from the top left corner: a point p of the model is seen at
``f x / z + c`` of ``(x, y, z) = R s p + t``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...errors import UserError

#: Pixels up to which an error of a landmark counts by its square; beyond that by itself.
_SOFT = 2.0


@dataclass(frozen=True)
class LandmarkFit:
    """
    Parameters
    ----------
    rotations : ndarray, shape (B, 3, 3)
    translations : ndarray, shape (B, 3)
        From the scaled model to each camera.
    scale : float
        Camera units by model units; 1 where no depth is known, which leaves it to the translations.
    weights : ndarray, shape (K,)
    error : float
        Mean distance between landmarks and their images [pixels].
    """

    rotations: np.ndarray
    translations: np.ndarray
    scale: float
    weights: np.ndarray
    error: float


def fit_landmarks(
    points: np.ndarray,
    offsets: np.ndarray,
    seen: np.ndarray,
    focal: float,
    size: tuple[int, int],
    *,
    depth: np.ndarray | None = None,
    prior: float = 1.0,
) -> LandmarkFit:
    """
    Poses, scale and weights under which the landmarks of a model are where images have them.

    Poses begin with the affine camera of least squares, made a scaled rotation (Procrustes); all is then refined
    together by Gauss-Newton steps on a robust error, with the squares of the weights as a prior.

    Parameters
    ----------
    points : ndarray, shape (L, 3)
        Landmarks of the mean model.
    offsets : ndarray, shape (K, L, 3)
        What each mode adds to them at weight 1.
    seen : ndarray, shape (B, L, 2)
        Their places in each image [pixels].
    focal : float
        [pixels]
    size : (int, int)
        Width and height of the images [pixels]; the principal point is their middle.
    depth : ndarray, shape (B, L), optional
        Distance along the view axis [camera units]; NaN where none is known.
    prior : float
        Pixels that a weight of 1 costs.

    Raises
    ------
    UserError
        Numbers of landmarks differ, too few of them, or some lie outside their image.
    """
    points, offsets, seen = (np.asarray(x, np.float64) for x in (points, offsets, seen))
    if seen.ndim != 3 or seen.shape[1:] != (len(points), 2) or offsets.shape[1:] != points.shape:
        raise UserError(f"the model has {len(points)} landmarks, but the images {seen.shape[1:2]}; name the same ones")
    if len(points) < 6:
        raise UserError(f"a pose needs at least 6 landmarks, got {len(points)}")
    outside = ((seen < 0) | (seen > np.array(size))).any(2)
    if outside.any():
        view, k = np.argwhere(outside)[0]
        raise UserError(
            f"landmark {k} of image {view} is at {seen[view, k].round(1)}, outside its {size[0]} × {size[1]}"
        )
    if depth is not None and np.shape(depth) != seen.shape[:2]:
        raise UserError(f"depth of landmarks should have the shape {seen.shape[:2]}, got {np.shape(depth)}")
    n, centre = len(seen), np.array(size) / 2
    poses = np.array([_affine_start(points, image - centre, focal) for image in seen])
    scale = 1.0
    if depth is not None:
        z = np.einsum("bi,li->bl", Rotation.from_rotvec(poses[:, :3]).as_matrix()[:, 2], points) + poses[:, 5:]
        scale = float(np.nanmedian(np.asarray(depth) / z))
        poses[:, 3:] *= scale

    n_weights, n_marks = len(offsets), len(points)
    ahead = None if depth is None else focal / np.asarray(depth) / _SOFT  # as far off as the same distance across

    def residuals(x: np.ndarray) -> np.ndarray:
        weights, s = x[6 * n + 1 :], np.exp(x[6 * n])
        local = _in_cameras(x[: 6 * n].reshape(n, 6), s * (points + np.tensordot(weights, offsets, axes=1)))
        pixels = (focal * local[..., :2] / local[..., 2:] + centre - seen) / _SOFT
        far = 1e3 * x[6 * n : 6 * n + 1] if ahead is None else np.nan_to_num(ahead * (local[..., 2] - depth)).ravel()
        return np.concatenate([pixels.ravel(), prior / _SOFT * weights, far])

    def derivatives(x: np.ndarray) -> np.ndarray:
        weights, s = x[6 * n + 1 :], np.exp(x[6 * n])
        turned, shape = x[: 6 * n].reshape(n, 6), s * (points + np.tensordot(weights, offsets, axes=1))
        local, rotations = _in_cameras(turned, shape), Rotation.from_rotvec(turned[:, :3]).as_matrix()
        by = np.zeros((n, n_marks, 3, len(x)))  # of the points in the cameras
        for k, (rotation, vector) in enumerate(zip(rotations, turned[:, :3], strict=True)):
            by[k, :, :, 6 * k : 6 * k + 3] = -rotation @ _cross(shape) @ _right_jacobian(vector)
            by[k, :, :, 6 * k + 3 : 6 * k + 6] = np.eye(3)
            by[k, :, :, 6 * n] = shape @ rotation.T
            by[k, :, :, 6 * n + 1 :] = s * np.einsum("ij,klj->lik", rotation, offsets)
        z = local[..., 2, None, None]
        pixels = focal / _SOFT / z * (by[..., :2, :] - local[..., :2, None] / z * by[..., 2:, :])
        of_weights = np.zeros((n_weights, len(x)))
        of_weights[:, 6 * n + 1 :] = prior / _SOFT * np.eye(n_weights)
        if ahead is None:
            far = 1e3 * (np.arange(len(x)) == 6 * n)[None].astype(float)
        else:
            far = np.nan_to_num(ahead[..., None] * by[..., 2, :]).reshape(-1, len(x))
        return np.concatenate([pixels.reshape(-1, len(x)), of_weights, far])

    start = np.concatenate([poses.ravel(), [np.log(scale)], np.zeros(len(offsets))])
    found = least_squares(residuals, start, derivatives, loss="soft_l1", x_scale="jac", max_nfev=40).x
    poses, weights, scale = found[: 6 * n].reshape(n, 6), found[6 * n + 1 :], float(np.exp(found[6 * n]))
    local = _in_cameras(poses, scale * (points + np.tensordot(weights, offsets, axes=1)))
    error = np.linalg.norm(focal * local[..., :2] / local[..., 2:] + centre - seen, axis=2).mean()
    rotations = Rotation.from_rotvec(poses[:, :3]).as_matrix()
    return LandmarkFit(rotations, poses[:, 3:], scale, weights, float(error))


def _affine_start(points: np.ndarray, pixels: np.ndarray, focal: float) -> np.ndarray:
    """Rotation vector and translation of the scaled orthographic camera nearest to the affine one."""
    middle, at = points.mean(0), pixels.mean(0)
    affine = np.linalg.lstsq(points - middle, pixels - at, rcond=None)[0].T  # (2, 3)
    u, s, vt = np.linalg.svd(affine, full_matrices=False)
    rows = u @ vt
    rotation = np.vstack([rows, np.cross(*rows)])
    z = focal / s.mean()
    centre = np.array([*(at * z / focal), z])
    return np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), centre - rotation @ middle])


def _in_cameras(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (L, 3) in the frames of cameras, shape (B, L, 3)."""
    return np.einsum("bij,lj->bli", Rotation.from_rotvec(poses[:, :3]).as_matrix(), points) + poses[:, None, 3:]


def _cross(v: np.ndarray) -> np.ndarray:
    """Matrices of the cross product with vectors (..., 3), shape (..., 3, 3)."""
    return np.cross(v[..., None, :], np.eye(3)).swapaxes(-1, -2)


def _right_jacobian(vector: np.ndarray) -> np.ndarray:
    """J in R(r + dr) = R(r) R(J dr), of a rotation vector."""
    angle, k = np.linalg.norm(vector), _cross(vector)
    if angle < 1e-6:
        return np.eye(3) - k / 2
    return np.eye(3) - (1 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * k @ k


def aligned(points: np.ndarray, target: np.ndarray, *, with_scale: bool = False) -> np.ndarray:
    """
    Points moved rigidly, or by a similarity, onto their counterparts with the least squares (Umeyama 1991).

    Parameters
    ----------
    points, target : ndarray, shape (V, 3)
    with_scale : bool
    """
    a, b = points - points.mean(0), target - target.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = (s * sign).sum() / np.square(a).sum() if with_scale else 1.0
    return scale * a @ rotation.T + target.mean(0)
