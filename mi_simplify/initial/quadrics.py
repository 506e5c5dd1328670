"""
What a user would take instead: quadrics by fast-simplification, the baseline of the reports.
"""

from __future__ import annotations

import numpy as np

from ..config.initial import LARGEST_ATLAS
from ..model.asset import Asset
from ..model.model import Model
from .bake.baker import bake
from .guess import alpha_of
from .reduce.cleanup import clean
from .soup import merge
from .unwrap.charting import unwrap

#: What the configuration has where nothing is said.


def quadrics_only(asset: Asset, triangles: int, *, atlas_size: int = LARGEST_ATLAS) -> tuple[Model, list[str]]:
    """
    What a user would take instead: fast-simplification, colours carried over by closest point, no normal map.

    The baseline of the reports. Smooth normals; ``triangles`` may exceed the asset's, which then stays as it is.
    """
    positions, faces, notes = fast_quadrics(asset, triangles)
    mesh, more = unwrap(positions, faces, atlas_size=atlas_size)
    baked = bake(asset, mesh, size=atlas_size, samples=1, reach=0.0)
    mode, cutoff = alpha_of(asset, baked.base_color)
    flat = np.broadcast_to(np.array([0, 0, 1], np.float32), baked.normal.shape).copy()
    model = Model(mesh, baked.base_color, baked.specular, flat, mode, cutoff, name=asset.name)
    return model, notes + more


def fast_quadrics(asset: Asset, triangles: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """
    As :func:`reduced`, by fast-simplification: what others have for free.
    """
    import fast_simplification

    soup, notes = clean(merge(asset))
    positions, faces = soup.positions, soup.position_faces
    if triangles < len(faces):
        low = positions.min(0)
        scale = 100 / np.ptp(positions, axis=0).max()  # fast-simplification compares errors with absolute thresholds
        points, faces = fast_simplification.simplify(
            ((positions - low) * scale).astype(np.float32), faces.astype(np.int32), target_count=triangles
        )
        positions, faces = points.astype(np.float64) / scale + low, faces.astype(np.int64)
    return positions, faces, notes
