"""
What cards show: each cluster is laid into its cell of the atlas, and rays through texels look at it from both sides.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.meshes import make_mesh
from ...machine.upload import upload
from ..bake.lookup import Detail, Points, SurfacePoints
from ..soup import Soup
from ..unwrap.atlas import dilate
from .clusters import Clusters
from .layout import Layout

#: Surfaces that a ray goes through at most, where they are transparent.
_LAYERS = 8


def bake_cards(soup: Soup, clusters: Clusters, layout: Layout, size: int, samples: int) -> dict[str, np.ndarray]:
    """
    Textures of the cards.

    All clusters lie side by side in one scene, flat in the plane of the atlas with their depth along its normal: one
    ray meets one cluster alone. Both sides are averaged; a normal seen from behind is turned, as a two-sided material
    turns that of the map.

    Returns
    -------
    dict
        ``base_color`` (size, size, 4) with the share of each texel that is covered, ``specular`` and ``normal``.
    """
    used = np.flatnonzero(clusters.label >= 0)
    label = clusters.label[used]
    corners = soup.positions[soup.position_faces[used]]
    local = np.einsum("fki,fai->fka", corners - clusters.centre[label, None], clusters.axes[label])
    flat = layout.texel(label[:, None], local[..., :2])
    deepest = max(np.abs(local[..., 2]).max() * layout.density, 1.0)
    points = np.concatenate([flat, local[..., 2:] * layout.density], 2).reshape(-1, 3)
    scene = mi.load_dict(
        {"type": "scene", "mesh": make_mesh("laid out", points, np.arange(len(points)).reshape(-1, 3))}
    )
    detail = Detail(soup)
    face_of, card_of = upload(mi.UInt32, used), upload(mi.UInt32, label)
    frames = upload(mi.Float, np.pad(clusters.axes, ((0, 0), (0, 0), (0, 1))).reshape(-1))

    total = [mi.Float(0)] * 10
    texel = dr.arange(mi.UInt32, size * size)
    row = texel // size
    for k in range(samples * samples):
        offset = [dr.opaque(mi.Float, (c + 0.5) / samples) for c in (k % samples, k // samples)]
        x, y = mi.Float(texel - row * size) + offset[0], mi.Float(row) + offset[1]
        for side in (1, -1):
            seen = _look(scene, detail, face_of, card_of, frames, x, y, side, 1.5 * deepest)
            total = [a + b for a, b in zip(total, seen, strict=True)]
            dr.eval(total)
    sums = np.stack([t.numpy() for t in total], 1).reshape(size, size, 10) / (2 * samples * samples)
    opacity = sums[..., :1]
    covered = opacity[..., 0] > 1e-3
    mean = sums[..., 1:] / np.maximum(opacity, 1e-6)
    normal = mean[..., 6:9] / np.maximum(np.linalg.norm(mean[..., 6:9], axis=2, keepdims=True), 1e-6)
    rgb, specular, normal = dilate([x.astype(np.float32) for x in (mean[..., :3], mean[..., 3:6], normal)], covered)
    if not covered.any():
        normal = np.broadcast_to(np.array([0, 0, 1], np.float32), normal.shape).copy()
    base = np.concatenate([rgb, np.clip(opacity, 0, 1).astype(np.float32)], 2)
    return {"base_color": base, "specular": specular, "normal": normal}


def _look(scene, detail, face_of, card_of, frames, x, y, side: int, away: float) -> list[mi.Float]:
    """
    What rays from one side of the atlas meet: opacity, and colour, specular and normal times opacity, 10 numbers.
    """
    n = dr.width(x)
    out = [dr.zeros(mi.Float, n) for _ in range(10)]
    through, active = dr.full(mi.Float, 1, n), dr.full(mi.Bool, True, n)
    z = dr.full(mi.Float, side * away, n)
    direction = mi.Vector3f(0, 0, -side)
    for _ in range(_LAYERS):
        pi = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(x, y, z), direction), True, active)
        active &= pi.is_valid()
        face = dr.select(active, dr.gather(mi.UInt32, face_of, pi.prim_index, active), 0)
        card = dr.gather(mi.UInt32, card_of, pi.prim_index, active)
        t, b, m = (dr.gather(mi.Vector4f, frames, card * 3 + k, active).xyz for k in range(3))
        zero = mi.Float(0)
        at = Points(
            active, mi.Point3f(0), mi.Vector3f(m), mi.Vector3f(t), mi.Float(1), zero, mi.Vector3f(m), mi.UInt32(0)
        )
        values = detail.shade(at, SurfacePoints(face, dr.select(active, pi.prim_uv, 0)))
        opacity = values[6]
        weight = through * opacity
        shown = [mi.Float(1), *values[3:6], *values[7:13]]
        out = [a + dr.select(active, weight * v, 0) for a, v in zip(out, shown, strict=True)]
        through *= dr.select(active, 1 - opacity, 1)
        z = dr.select(active, z - side * (pi.t + 1e-4), z)
        active &= through > 1e-3
        dr.eval(out, through, active, z)
        if not dr.any(active):
            break
    return out
