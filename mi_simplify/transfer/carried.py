"""
Transfer of an animated original, carried by textures of a small model.

Rays are cast on the original, frame by frame; the small model's own shape casts no shadows, just as its normal map has
the detail that its triangles lack. Over the frames the coefficients are reduced to a few axes (a clustered PCA of
Sloan et al. 2003 with a single cluster), each axis is a set of textures over the small model's atlas, and a frame is a
sum of them. Texels are least squares over points spread on the surface, so that what bilinear lookups show is close to
the rays, on both sides of every seam.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, kron
from scipy.sparse.linalg import splu

from ..config.export import CarriedSettings
from ..errors import AssetError
from ..initial.closest import ClosestPoints, closest_barycentric, sample_surface
from ..machine.files import write_atomic
from ..progress import Progress, ProgressCallback, silent
from .archive import opened
from .body import Body, Places
from .cast import Caster, unshadowed

#: Points on the surface for each texel.
DENSITY = 2.0

#: How much neighbouring texels attract each other, beside a weight of 1 for each point. It fills those that no point
#: sees, and takes some of the noise of the rays.
SMOOTHNESS = 0.05

#: Share of an open sky that a point receives in one of the frames at least. Others lie inside of the body, where its
#: parts run through each other, and would darken the texels beside them that are seen.
LEAST_LIGHT = 0.02


@dataclass(frozen=True)
class CarriedTransfer:
    """
    Textures of transfer coefficients for a clip.

    Parameters
    ----------
    textures : ndarray, shape (P + 1, n, n, K), float16
        Of each axis, and last of the mean; for a diffuse reflectance of 1. The origin is top left, texel centres lie
        at (k + 1/2)/n, as in all textures of the model.
    weights : ndarray, shape (T, P), float32
        Of each axis in the frames that were cast.
    frames : ndarray, shape (T,), float32
        Which those are, as indices into the clip of the original.
    """

    textures: np.ndarray
    weights: np.ndarray
    frames: np.ndarray

    @property
    def order(self) -> int:
        """Highest band."""
        return round(self.n_k**0.5) - 1

    @property
    def n_k(self) -> int:
        """Coefficients of a texel."""
        return self.textures.shape[3]

    def at(self, frame: float) -> np.ndarray:
        """
        The textures of a frame, which may lie between those that were cast: shape (n, n, K), float32.
        """
        w = np.array([np.interp(frame, self.frames, column) for column in self.weights.T])
        return np.tensordot(np.append(w, 1), self.textures.astype(np.float32), 1).astype(np.float32)

    def save(self, path: str | Path) -> Path:
        """
        Write everything into one npz file.
        """
        arrays: dict[str, Any] = {"textures": self.textures, "weights": self.weights, "frames": self.frames}
        return write_atomic(path, lambda p: np.savez_compressed(p, **arrays))


def load_carried(path: str | Path) -> CarriedTransfer:
    """
    Read what :meth:`CarriedTransfer.save` wrote.

    Raises
    ------
    AssetError
        The file is missing or holds something else.
    """
    with opened(path, "transfer.npz of a run", "run it again") as data:
        return CarriedTransfer(data["textures"], data["weights"], data["frames"])


def carried(
    original: Body, small: Body, settings: CarriedSettings, progress: ProgressCallback = silent
) -> CarriedTransfer:
    """
    Cast the transfer of an original over its clip, and fit textures of a small model to it.

    Parameters
    ----------
    original, small : Body
        In one place in the bind pose.
    settings : CarriedSettings

    Raises
    ------
    AssetError
        The small model has no texture coordinates.
    """
    if small.uvs is None:
        raise AssetError(f"{small.asset.name}: texture coordinates expected for transfer textures; unwrap it")
    on_small, at = _spread(small, int(DENSITY * settings.size**2))
    on_original = nearest(original, on_small.of(at[0]), on_small.of(at[1]))
    n = min(settings.frames, original.n_frames)
    frames = np.unique(np.rint(np.linspace(0, original.n_frames - 1, n))).astype(np.float32)
    caster, cast = None, []
    for k, frame in enumerate(frames):
        positions, points, normals = on_original.posed(original, float(frame))
        if caster is None:
            options: dict[str, Any] = {
                "order": settings.order,
                "n_directions": settings.directions,
                "n_points": len(points),
            }
            caster = Caster(positions, original.faces, albedo=1.0, **options)
        cast.append(caster(positions, normals, points).astype(np.float16))
        progress(Progress("cast", k + 1, len(frames)))
    whole = np.stack(cast)
    lit = is_lit(whole).any(0)
    if not lit.any():
        raise AssetError(f"{original.asset.name}: no light reaches it; turn its faces outwards")
    weights, axes = _reduced(whole[:, lit].reshape(len(frames), -1), settings.axes)
    values = axes.reshape(len(axes), np.count_nonzero(lit), -1)
    textures = _fitted(lookup(on_small.of(small.uvs)[lit], settings.size), values, settings.size)
    return CarriedTransfer(textures.astype(np.float16), weights, frames)


def is_lit(transfer: np.ndarray) -> np.ndarray:
    """
    Where transfer (..., K) of reflectance 1 has more than :data:`LEAST_LIGHT` of what an open sky gives.
    """
    return transfer[..., 0] > LEAST_LIGHT * float(unshadowed(np.array([0.0, 1.0, 0.0]), 0, 1.0)[0])


def nearest(body: Body, points: np.ndarray, normals: np.ndarray) -> Places:
    """
    The places of a body that are closest to points (N, 3) in the bind pose and face the same way.
    """
    hit = ClosestPoints(body.posed(-1)[0], body.faces).query(points, normals)
    return Places(body.faces[hit.face], hit.barycentric)


def lookup(uvs: np.ndarray, n: int) -> csr_array:
    """
    Bilinear lookups at coordinates (N, 2), clamped, in n² texels: sparse, shape (N, n²).
    """
    x = np.clip(np.asarray(uvs, np.float64) * n - 0.5, 0, n - 1)
    low = np.minimum(x.astype(np.int64), n - 2)
    f = x - low
    rows, columns, shares = [], [], []
    for i in (0, 1):
        for j in (0, 1):
            rows.append(np.arange(len(x)))
            columns.append((low[:, 1] + j) * n + low[:, 0] + i)
            shares.append(np.abs(1 - i - f[:, 0]) * np.abs(1 - j - f[:, 1]))
    where = (np.concatenate(rows), np.concatenate(columns))
    return coo_array((np.concatenate(shares), where), shape=(len(x), n * n)).tocsr()


def _spread(body: Body, n: int) -> tuple[Places, tuple[np.ndarray, np.ndarray]]:
    """About ``n`` places over a body, by area in its bind pose, and its positions and normals there."""
    positions, normals = body.posed(-1)
    corners = positions[body.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    points, face = sample_surface(corners, area, n, 0)
    return Places(body.faces[face], closest_barycentric(points, corners[face])), (positions, normals)


def _reduced(values: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Principal axes of frames (T, M): weights (T, P), and axes (P + 1, M) with the mean as the last."""
    values = values.astype(np.float32)
    mean = values.mean(0)
    moved = values - mean
    power, w = np.linalg.eigh(moved @ moved.T)  # few frames, many values
    power, w = power[::-1], w[:, ::-1]
    kept = min(most, int(np.count_nonzero(power > 1e-6 * max(float(power[0]), 1e-12))))
    scale = np.sqrt(np.maximum(power[:kept], 0))
    return (w[:, :kept] * scale).astype(np.float32), np.concatenate([(w[:, :kept] / scale).T @ moved, mean[None]])


def _fitted(at: csr_array, values: np.ndarray, n: int) -> np.ndarray:
    """Textures (P, n, n, K) that lookups see as values (P, N, K)."""
    ends = np.ones(n)
    ends[[0, -1]] = 0.5
    along = diags_array([2 * ends, -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])
    one = eye_array(n)
    smooth = SMOOTHNESS * (kron(along, one) + kron(one, along))
    matrix = (at.T @ at + smooth + 1e-6 * eye_array(n * n)).tocsc()
    right = np.moveaxis(values, 0, 1).reshape(len(at.indptr) - 1, -1)  # (N, P·K)
    out = splu(matrix).solve(np.ascontiguousarray(at.T @ right.astype(np.float64)))
    return np.moveaxis(out.reshape(n, n, len(values), -1), 2, 0)
