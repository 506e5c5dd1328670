"""
A normal map said in another frame: from normals that a mesh was given to those that its faces have.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..initial.bake.lookup import LOWEST, LowPoly
from ..initial.unwrap.atlas import dilate
from ..model.mesh import Mesh
from ..model.model import Model, tessellated


def with_own_normals(model: Model) -> Model:
    """
    The model that files hold: the fine mesh that a displaced one stands for, shaded with the normals of its faces. One
    that is both already comes back unchanged.

    Renderers that trace paths take a vertex normal for the surface: light from behind it counts for nothing, whatever
    the normal map says. Normals that several tessellations share, see :attr:`..model.model.Displacement.framed`, lie
    too far from those of the finer ones for that. What it costs is that a map of large turns from texel to texel is
    interpolated less well.

    Parameters
    ----------
    model : Model
        UVs without overlap. Its mip levels are turned as well.
    """
    model = tessellated(model)
    mesh = model.mesh
    if mesh.own_normals is None:
        return model
    own = replace(mesh, own_normals=None)
    mips = tuple({**level, "normal": _moved(level["normal"], mesh, own)} for level in model.mips)
    return replace(model, mesh=own, normal=_moved(model.normal, mesh, own), mips=mips)


def _moved(normal: np.ndarray, old: Mesh, new: Mesh) -> np.ndarray:
    """
    A normal map (H, H, 3) of one mesh as that of another with the same vertices; texels between charts as nearby. A
    level that is too coarse to meet any chart stays, its normals being means over the whole model.
    """
    size = normal.shape[0]
    a, b = (_frames(mesh, size) for mesh in (old, new))
    covered = np.isfinite(a).all((2, 3)) & np.isfinite(b).all((2, 3))
    if not covered.any():
        return normal
    a, b = (x.reshape(size, size, 3, 3) for x in dilate([x.reshape(size, size, 9) for x in (a, b)], covered))
    world = np.einsum("yxkj,yxk->yxj", a, normal)
    out = np.einsum("yxkj,yxj->yxk", b, world)
    out[..., 2] = np.maximum(out[..., 2], LOWEST)
    return (out / np.linalg.norm(out, axis=2, keepdims=True)).astype(np.float32)


def _frames(mesh: Mesh, size: int) -> np.ndarray:
    """Rows of tangent, bitangent and normal at every texel, shape (H, H, 3, 3); NaN where no triangle lies."""
    points = LowPoly(mesh, np.zeros(len(mesh.positions))).points(size, (0.5, 0.5))
    t, n, w = points.t.numpy().T, points.n.numpy().T, points.w.numpy()
    frames = np.stack([t, w[:, None] * np.cross(n, t), n], axis=1)
    frames[~points.active.numpy()] = np.nan
    return frames.reshape(size, size, 3, 3)
