"""
A tessellated sphere around an asset: the first guess that knows nothing of its shape.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from ..errors import MeshError


def sphere(n_triangles: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """
    Closed sphere of ``n_triangles`` triangles (one less for an odd number), all about the same size.

    The convex hull of a Fibonacci lattice (Swinbank and Purser 2006): V points span 2V - 4 triangles, so that every
    even count can be had, unlike with a subdivided icosahedron.

    Returns
    -------
    positions : ndarray, shape (P, 3), float64
        Centred at the origin.
    faces : ndarray, shape (F, 3), int64
        Outward, counter-clockwise.

    Raises
    ------
    MeshError
        Fewer than 4 triangles are asked for.
    """
    if n_triangles < 4:
        raise MeshError(f"a budget of {n_triangles} triangles is too small for a sphere; ask for at least 4")
    n = n_triangles // 2 + 2
    k = np.arange(n) + 0.5
    y = 1 - 2 * k / n
    longitude = np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - y * y)
    points = np.stack([np.cos(longitude) * ring, y, np.sin(longitude) * ring], 1)
    faces = ConvexHull(points).simplices.astype(np.int64)
    p = points[faces]
    inward = np.einsum("fi,fi->f", p[:, 0], np.cross(p[:, 1], p[:, 2])) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points * radius, faces
