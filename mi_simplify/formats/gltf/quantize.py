"""
Vertex attributes as integers of 8 and 16 bits, as KHR_mesh_quantization allows them.
"""

from __future__ import annotations

from dataclasses import dataclass

import meshopt
import numpy as np

EXTENSION = "KHR_mesh_quantization"


@dataclass(frozen=True)
class Grid:
    """
    Cube of 65,536 steps a side that positions are rounded to; one scale for all axes keeps normals as they are.

    Parameters
    ----------
    scale : float
        Side of the cube [units of the mesh].
    offset : ndarray, shape (3,)
        Its least corner.
    """

    scale: float
    offset: np.ndarray

    @staticmethod
    def around(points: np.ndarray) -> Grid:
        """The smallest such cube around points (V, 3)."""
        low = points.min(0)
        return Grid(float(np.float32(max((points.max(0) - low).max(), 1e-30) * (1 + 1e-6))), low)

    def positions(self, points: np.ndarray) -> np.ndarray:
        """Points (V, 3) as uint16 that stand for [0, 1]."""
        return np.rint((points - self.offset) / self.scale * 65535).clip(0, 65535).astype("<u2")

    def offsets(self, vectors: np.ndarray) -> np.ndarray:
        """Differences of points (V, 3) as int16 that stand for [-1, 1]."""
        return np.rint(vectors / self.scale * 32767).clip(-32767, 32767).astype("<i2")

    @property
    def to_mesh(self) -> np.ndarray:
        """What takes stored positions to those of the mesh, shape (4, 4)."""
        matrix = np.diag([self.scale] * 3 + [1.0])
        matrix[:3, 3] = self.offset
        return matrix


def directions(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Unit vectors as integers that stand for [-1, 1], and packed for meshoptimizer's octahedral filter.

    Parameters
    ----------
    vectors : ndarray, shape (V, 3) or (V, 4)
        The fourth column is a tangent's sign.

    Returns
    -------
    plain : ndarray, shape (V, 3) or (V, 4)
        int16 for normals, int8 for tangents.
    packed : ndarray, shape (V, 8) or (V, 4), uint8
        To 12 bits for normals, 8 for tangents, whose error only turns the detail of a normal map.
    """
    is_tangent = vectors.shape[1] == 4
    kind, most, stride, bits = ("i1", 127, 4, 8) if is_tangent else ("<i2", 32767, 8, 12)
    four = vectors if is_tangent else np.concatenate([vectors, np.zeros((len(vectors), 1))], axis=1)
    packed = meshopt.encode_filter_oct(np.asarray(four, np.float32), stride, bits)
    return np.rint(vectors * most).astype(kind), packed


def texture_coordinates(uvs: np.ndarray) -> np.ndarray | None:
    """
    Coordinates (V, 2) as uint16 that stand for [0, 1]; None where some lie beyond.
    """
    if uvs.min() < 0 or uvs.max() > 1:
        return None
    return np.rint(uvs.astype(np.float64) * 65535).astype("<u2")


def shares(weights: np.ndarray) -> np.ndarray:
    """
    Weights (V, K) of rows that sum to 1 as uint8 of rows that sum to 255: what rounding down leaves goes to the
    largest remainders.
    """
    exact = weights / weights.sum(1, keepdims=True) * 255
    low = np.floor(exact)
    missing = 255 - low.sum(1).astype(int)
    rank = np.argsort(np.argsort(low - exact, axis=1, kind="stable"), axis=1)
    return (low + (rank < missing[:, None])).astype("u1")
