"""
Transfer coefficients by ray casting (Sloan et al. 2002): how each vertex answers low-frequency light from far away.

With albedo ρ, visibility V and unit normal n, ``T(ω) = ρ/π V(ω) max(0, n·ω)``; coefficient k is ``∫ T Y_k dω`` for the
real spherical harmonics Y of :mod:`..model.light.harmonics`. Radiance that leaves the vertex under light with
coefficients l is ``Σ_k l_k T_k``.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.meshes import MovingMesh
from ..model.light.harmonics import MAX_DEGREE, harmonics

#: Zonal coefficients of max(0, cos θ), band by band (Ramamoorthi and Hanrahan 2001, Eq. 8).
COSINE = (np.pi, 2 * np.pi / 3, np.pi / 4, 0.0)

#: Rays start this far above the surface [diagonals of the object's box].
OFFSET = 1e-4

#: The golden ratio's fraction times 2³²: multiples of it are evenly spread, whatever their number.
_GOLDEN = 2654435769


def unshadowed(normals: np.ndarray, order: int = MAX_DEGREE, albedo: float = 0.8) -> np.ndarray:
    """
    Transfer of a vertex that nothing occludes, in closed form: ``ρ/π A_l Y_lm(n)``.

    Parameters
    ----------
    normals : ndarray, shape (..., 3)
        Unit vectors.
    order : int
        Highest band, 0 to 3.
    albedo : float
        ρ.

    Returns
    -------
    ndarray, shape (..., (order + 1)²), float32
    """
    n = np.asarray(normals, np.float64)
    basis = np.stack(np.broadcast_arrays(*harmonics(order, n[..., 0], n[..., 1], n[..., 2])), axis=-1)
    return (albedo / np.pi * basis * band_factors(order)).astype(np.float32)


def band_factors(order: int) -> np.ndarray:
    """
    The factor of the cosine lobe's band for each coefficient, shape ((order + 1)²,).
    """
    return np.concatenate([np.full(2 * band + 1, COSINE[band]) for band in range(order + 1)])


class Caster:
    """
    Casts the rays of one object, frame by frame, with Dr.Jit on all cores.

    Directions are cosine distributed: N points of a golden spiral over the disc, which it stratifies by radius and
    angle, turned for each vertex by an angle of its own that stays the same in all frames. What is estimated is the
    *occluded* part; the rest is known in closed form, so that an unoccluded vertex has no error at all:
    ``T = T_unshadowed - ρ/N Σ (1 - V(ω_i)) Y(ω_i)``.

    Parameters
    ----------
    positions : ndarray, shape (V, 3)
        In any frame.
    faces : ndarray, shape (F, 3)
        What occludes; both sides do.
    order : int
        Highest band, 0 to 3.
    n_directions : int
        Rays of a vertex, and of each bounce.
    albedo : float
        Diffuse reflectance ρ in [0, 1].
    shadowed : bool
        Without, the closed form alone.
    bounces : int
        Diffuse interreflections to follow: 0, 1 or 2; the back of a face reflects nothing.
    n_points : int, optional
        How many points are lit, where these are not the mesh's vertices; they see no interreflections.
    """

    def __init__(
        self,
        positions: np.ndarray,
        faces: np.ndarray,
        *,
        order: int = MAX_DEGREE,
        n_directions: int = 256,
        albedo: float = 0.8,
        shadowed: bool = True,
        bounces: int = 0,
        n_points: int | None = None,
    ):
        if n_points is not None and bounces:
            raise ValueError("interreflections are known at the vertices of the mesh alone")
        n = len(positions) if n_points is None else n_points
        self.order, self.n_directions, self.albedo = order, n_directions, albedo
        self.shadowed, self.bounces = shadowed, bounces
        self._faces = mi.UInt32(np.ascontiguousarray(faces, np.uint32).ravel())
        self._mesh = MovingMesh(np.asarray(positions), np.asarray(faces))
        rng = np.random.default_rng(n)
        self._turn = mi.Float(rng.random(n, np.float32))
        self._shift = mi.Float(rng.random(n, np.float32))

    def __call__(self, positions: np.ndarray, normals: np.ndarray, points: np.ndarray | None = None) -> np.ndarray:
        """
        Coefficients of a frame.

        Parameters
        ----------
        positions : ndarray, shape (V, 3)
            Of the mesh.
        normals : ndarray, shape (N, 3)
            Unit normals of what is lit; light is received on their side alone.
        points : ndarray, shape (N, 3), optional
            What is lit; the vertices if not given.

        Returns
        -------
        ndarray, shape (N, (order + 1)²), float32
        """
        out = unshadowed(normals, self.order, self.albedo)
        if not self.shadowed:
            return out
        low, high = positions.min(0), positions.max(0)
        lit = positions if points is None else points
        origin = np.asarray(lit, np.float64) + OFFSET * float(np.linalg.norm(high - low)) * np.asarray(normals)
        flat = mi.Float(np.ascontiguousarray(positions, np.float32).ravel())
        self._mesh.move(flat)
        start = mi.Point3f(np.ascontiguousarray(origin.T, np.float32))
        frame = mi.Frame3f(mi.Normal3f(np.ascontiguousarray(np.asarray(normals).T, np.float32)))
        ways = (frame, self._turn, self._shift, dr.opaque(mi.UInt32, self.n_directions))
        scale = self.albedo / self.n_directions
        out -= scale * _interleaved(_blocked(self._mesh.scene, start, ways, self.order))
        light = out
        for _ in range(self.bounces):
            sent = mi.Float(np.ascontiguousarray(light, np.float32).ravel())
            light = scale * _interleaved(_gathered(self._mesh.scene, start, ways, self.order, self._faces, flat, sent))
            out = out + light
        return out


def _interleaved(sums: list[mi.Float]) -> np.ndarray:
    """Sums, one array a coefficient, as (V, K)."""
    dr.eval(sums)
    return np.stack([np.array(s) for s in sums], axis=1)


def direction(ways: tuple, k: mi.UInt32) -> mi.Vector3f:
    """
    The k-th direction of every vertex; ``ways`` holds frames, turns, shifts and the number of directions.
    """
    frame, turn, shift, n = ways
    share = (mi.Float(k) + shift) / mi.Float(n)  # of the disc's area
    angle = dr.two_pi * (mi.Float(k * mi.UInt32(_GOLDEN)) * 2**-32 + turn)
    sin, cos = dr.sincos(angle)
    radius = dr.sqrt(share)
    return frame.to_world(mi.Vector3f(radius * cos, radius * sin, dr.safe_sqrt(1 - share)))


@dr.syntax
def _blocked(scene: mi.Scene, origin: mi.Point3f, ways: tuple, order: int) -> list[mi.Float]:
    """Sums of the basis functions over the directions that the object blocks."""
    sums = [dr.zeros(mi.Float, dr.width(origin)) for _ in range((order + 1) ** 2)]
    k = mi.UInt32(0)
    while k < ways[3]:
        d = direction(ways, k)
        blocked = scene.ray_test(mi.Ray3f(origin, d))
        sums = _added(sums, harmonics(order, d.x, d.y, d.z), blocked)
        k += 1
    return sums


@dr.syntax
def _gathered(
    scene: mi.Scene, origin: mi.Point3f, ways: tuple, order: int, faces: mi.UInt32, positions: mi.Float, sent: mi.Float
) -> list[mi.Float]:
    """Sums of the transfer that leaves what the directions hit, on its front."""
    n = (order + 1) ** 2
    sums = [dr.zeros(mi.Float, dr.width(origin)) for _ in range(n)]
    k = mi.UInt32(0)
    while k < ways[3]:
        d = direction(ways, k)
        hit = scene.ray_intersect_preliminary(mi.Ray3f(origin, d), coherent=False)
        seen = hit.is_valid()
        corner = dr.gather(mi.Vector3u, faces, hit.prim_index, seen)
        a, b, c = _corners(positions, corner, seen)
        seen &= dr.dot(dr.cross(b - a, c - a), d) < 0
        w = (1 - hit.prim_uv.x - hit.prim_uv.y, hit.prim_uv.x, hit.prim_uv.y)
        sums = _added(sums, _mixed(sent, corner, w, n, seen), seen)
        k += 1
    return sums


def _added(sums: list[mi.Float], values: list[mi.Float], where: mi.Bool) -> list[mi.Float]:
    return [s + dr.select(where, v, 0) for s, v in zip(sums, values, strict=True)]


def _corners(positions: mi.Float, corner: mi.Vector3u, active: mi.Bool) -> list[mi.Point3f]:
    return [dr.gather(mi.Point3f, positions, corner[j], active) for j in range(3)]


def _mixed(sent: mi.Float, corner: mi.Vector3u, weights: tuple, n: int, active: mi.Bool) -> list[mi.Float]:
    """All coefficients of a point in a triangle."""
    return [
        sum((w * dr.gather(mi.Float, sent, corner[j] * n + i, active) for j, w in enumerate(weights)), mi.Float(0))
        for i in range(n)
    ]
