"""
Ray-cast baker: what a detailed asset looks like, written into the textures of a low-poly mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import MeshError
from ...machine.runtime import ensure_variant
from ...machine.upload import upload
from ...model.asset import Asset, Material
from ...model.mesh import Mesh
from ...model.topology import area_vectors
from ..closest import ClosestPoints, sample_surface
from ..groups import Grouping
from ..reduce.cleanup import clean
from ..soup import merge
from ..unwrap.atlas import dilate


@dataclass(frozen=True)
class Baked:
    """
    Textures of one low-poly mesh, every texel filled.

    Parameters
    ----------
    base_color : ndarray, shape (H, W, 4), float32
        Linear RGB and opacity.
    specular : ndarray, shape (H, W, 3), float32
        (gamma, roughness, metallic), linear.
    normal : ndarray, shape (H, W, 3), float32
        Unit vectors in the mesh's MikkTSpace frame, +Y up the image.
    height : ndarray, shape (H, W, 1), float32
        Signed distance to the reference along the smooth normal [world units].
    covered : ndarray, shape (H, W), bool
        Texels that a triangle touches; the others repeat the nearest of them.
    missed : float
        Share of the samples whose ray met nothing suitable; they took the closest point of the reference.
    emission : ndarray, shape (H, W, 3), float32, or None
        Linear; None where no material has any.
    occlusion : ndarray, shape (H, W, 1), float32, or None
        None where no material has any, and none was asked for.
    least_opacity : ndarray, shape (groups,)
        Of the texels of each group.
    """

    base_color: np.ndarray
    specular: np.ndarray
    normal: np.ndarray
    height: np.ndarray
    covered: np.ndarray
    missed: float
    emission: np.ndarray | None = None
    occlusion: np.ndarray | None = None
    least_opacity: np.ndarray = field(default_factory=lambda: np.ones(1))


def bake(
    asset: Asset, mesh: Mesh, *, size: int = 1024, samples: int = 2, reach: float | None = None,
    grouping: Grouping | None = None, occlusion: bool = False,
) -> Baked:  # fmt: skip
    """
    Look from every texel along the smooth normal, both ways, and write down the closest surface that faces alike.

    Parameters
    ----------
    asset : Asset
        The reference, in the frame of ``mesh``; all its materials are read.
    mesh : Mesh
        The low-poly mesh; UVs without overlap.
    size : int
        Side of the textures [texels].
    samples : int
        ``samples``² points to a texel, averaged.
    reach : float, optional
        How far to look either way [world units]; by default from the distance of the two surfaces nearby.
    grouping : Grouping, optional
        Of the faces of ``mesh``: each looks at the surface of its own group alone, and opaque ones come out opaque.
    occlusion : bool
        Cast rays on the asset for its occlusion; where a material has one of its own, the darker of both counts.

    Raises
    ------
    MeshError
        The UVs of ``mesh`` cover no texel.
    """
    ensure_variant()
    from ...machine.meshes import MISS
    from .decals import seen
    from .lookup import N_VALUES, Detail, LowPoly  # their classes need a variant
    from .occlusion import Sky

    soup, _ = clean(merge(asset))
    closest = ClosestPoints(soup.vertices, soup.faces)
    far = reaches(mesh, closest, soup.diagonal) if reach is None else np.full(len(mesh.positions), reach)
    low = LowPoly(mesh, far, None if grouping is None else grouping.groups.of_face)
    owner = None if grouping is None else grouping.of_material[soup.material_index]
    detail = Detail(soup, owner)
    sky = Sky(soup, detail) if occlusion else None
    n_groups = 1 if grouping is None else len(grouping.groups.kinds)
    is_opaque = mi.Bool(
        [grouping is not None and grouping.groups.kinds[k].alpha_mode == "OPAQUE" for k in range(n_groups)]
    )
    if owner is not None and n_groups > 1:
        within = [np.flatnonzero(owner == k) for k in range(n_groups)]
        nearest = [(which, ClosestPoints(soup.vertices, soup.faces[which])) for which in within]
    else:
        nearest = [(np.arange(len(soup.faces)), closest)]

    total = [mi.Float(0)] * (N_VALUES + 1)
    n_missed, least = 0, dr.ones(mi.Float, n_groups)
    dr.make_opaque(least)
    for k in range(samples * samples):
        points = low.points(size, ((k % samples + 0.5) / samples, (k // samples + 0.5) / samples))
        hits = detail.search(points)
        dr.eval(points, hits)
        lost = dr.compress(points.active & (hits.face == MISS))
        if len(lost):
            n_missed += len(lost)
            p, n, group = (dr.gather(type(x), x, lost).numpy().T for x in (points.p, points.ray, points.group))
            for k, (which, near) in enumerate(nearest):
                here = np.flatnonzero(group == k)
                if not len(here):
                    continue
                found, place = near.query(p[here], n[here], candidates=4), upload(mi.UInt32, lost.numpy()[here])
                dr.scatter(hits.face, upload(mi.UInt32, which[found.face]), place)
                dr.scatter(hits.b, upload(mi.Point2f, found.barycentric[:, 1:]), place)
        hits.face = dr.select(hits.face == MISS, 0, hits.face)
        dr.eval(hits)
        values = [*_solid(seen(detail, points, hits), dr.gather(mi.Bool, is_opaque, points.group))]
        if sky is not None:
            values[-1] = dr.minimum(values[-1], sky.seen(points, hits, k))
        values.append(mi.Float(1))
        values = [dr.select(points.active, x, 0) for x in values]
        dr.scatter_reduce(dr.ReduceOp.Min, least, values[6], points.group, points.active)
        total = [a + b for a, b in zip(total, values, strict=True)]
        dr.eval(total)
    sums = np.stack([x.numpy() for x in total], 1).reshape(size, size, N_VALUES + 1)
    if not sums[..., N_VALUES].any():
        raise MeshError("the low-poly mesh covers no texel; it needs texture coordinates")
    baked = _finish(sums, soup.materials, n_missed / sums[..., N_VALUES].sum(), occlusion)
    return replace(baked, least_opacity=least.numpy())


def _solid(values: list[mi.Float], opaque: mi.Bool) -> list[mi.Float]:
    """What :func:`.decals.seen` found, with opacity 1 where a surface is opaque."""
    opacity = values[6]
    solid = [
        dr.select(opacity > 1e-3, x / dr.maximum(opacity, 1e-3), y)
        for x, y in zip(values[:3], values[3:6], strict=True)
    ]
    solid = [*solid, *values[3:6], mi.Float(1), *values[7:]]
    return [dr.select(opaque, x, y) for x, y in zip(solid, values, strict=True)]


def _finish(sums: np.ndarray, materials: tuple[Material, ...], missed: float, occlusion: bool) -> Baked:
    """Averages of the sums of :meth:`Detail.shade` and their count; the background filled."""
    count = sums[..., -1:]
    covered = count[..., 0] > 0
    mean = sums[..., :-1] / np.maximum(count, 1)
    opacity = mean[..., 6:7]
    rgb = np.where(opacity > 1e-3, mean[..., :3] / np.maximum(opacity, 1e-3), mean[..., 3:6])
    normal = mean[..., 10:13] / np.maximum(np.linalg.norm(mean[..., 10:13], axis=2, keepdims=True), 1e-6)
    images = [np.concatenate([rgb, opacity], 2), mean[..., 7:10], normal, mean[..., 13:14]]
    has_emission, has_occlusion = (any(getattr(m, k) is not None for m in materials) for k in ("emission", "occlusion"))
    has_occlusion |= occlusion
    images += [mean[..., 14:17]] * has_emission + [mean[..., 17:18]] * has_occlusion
    base_color, specular, normal, height, *more = dilate([x.astype(np.float32) for x in images], covered)
    emission, open_share = more[0] if has_emission else None, more[-1] if has_occlusion else None
    return Baked(base_color, specular, normal, height, covered, float(missed), emission, open_share)


def reaches(mesh: Mesh, closest: ClosestPoints, diagonal: float) -> np.ndarray:
    """
    How far a ray must look at every position of a low-poly mesh: a multiple of the gap to the reference around it.

    Both gaps count, from the mesh to the reference and back: the second knows how far its relief stands out.

    Returns
    -------
    ndarray, shape (P,)
        [world units], at least a thousandth of ``diagonal``.
    """
    own = ClosestPoints(mesh.positions, mesh.position_faces, n_samples=50_000)
    area = np.linalg.norm(area_vectors(own.corners), axis=1)
    points, face = sample_surface(own.corners, area, 20_000, seed=1)
    gap = np.zeros(len(own.corners))
    np.maximum.at(gap, face, closest.query(points, own.normals[face], candidates=4).distance)

    area = np.linalg.norm(area_vectors(closest.corners), axis=1)
    n_wanted = min(50_000, max(len(area) // 2, 1))
    points, face = sample_surface(closest.corners, area, n_wanted, seed=2)
    if len(points) > 2 * n_wanted:  # one centre per triangle is more than enough of a dense mesh
        points, face = points[-n_wanted:], face[-n_wanted:]
    back = own.query(points, closest.normals[face], candidates=4)
    seen = np.einsum("ni,ni->n", own.normals[back.face], closest.normals[face]) > 0
    np.maximum.at(gap, back.face[seen], np.minimum(back.distance[seen], 0.05 * diagonal))

    out = np.zeros(len(mesh.positions))
    faces = mesh.position_faces
    for _ in range(2):  # the neighbours' too, so that rays do not end at an edge
        np.maximum.at(out, faces, gap[:, None])
        gap = out[faces].max(1)
    return 1.5 * out + 1e-3 * diagonal
