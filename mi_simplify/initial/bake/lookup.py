"""
The two surfaces of a bake on the device: the low-poly one laid out in its texture, and the detailed one to look at.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.meshes import MISS, make_mesh
from ...machine.upload import upload
from ...machine.wrapping import WRAPS, folded
from ...model.asset import PLAIN, Lookup
from ...model.mesh import Mesh
from ...model.tangents import split_mirrored, vertex_tangents
from ...model.topology import vertex_normals, weld
from ..soup import Soup

N_VALUES = 18
"""Numbers that :meth:`Detail.shade` tells of a point."""

LOWEST = 0.05
"""Least z of a baked normal: what turns away from the low-poly surface is laid almost flat onto it."""


@dataclass
class Points:
    """
    Points on the low-poly surface: Dr.Jit arrays of one width.

    Parameters
    ----------
    active : mi.Bool
        Whether a triangle lies under the texel.
    p : mi.Point3f
    n, t : mi.Vector3f
        Orthonormal smooth normal and tangent; the bitangent is ``w * cross(n, t)``.
    w : mi.Float
    reach : mi.Float
        How far the reference is looked for, both ways along ``ray`` [world units].
    ray : mi.Vector3f
        Unit normal without creases: neighbouring charts must not look past each other.
    group : mi.UInt32
        Of the face.
    """

    active: mi.Bool
    p: mi.Point3f
    n: mi.Vector3f
    t: mi.Vector3f
    w: mi.Float
    reach: mi.Float
    ray: mi.Vector3f
    group: mi.UInt32


@dataclass
class SurfacePoints:
    """
    Points on the reference: triangle (``MISS`` where there is none) and weights of its second and third corner.
    """

    face: mi.UInt32
    b: mi.Point2f


def _flat(rows: np.ndarray) -> mi.Float:
    return upload(mi.Float, np.ravel(rows))


def _scene(vertices: np.ndarray, faces: np.ndarray) -> mi.Scene:
    return mi.load_dict({"type": "scene", "mesh": make_mesh("mesh", vertices, faces)})


class LowPoly:
    """
    A low-poly mesh that can be asked for its surface at a texture coordinate.

    Parameters
    ----------
    mesh : Mesh
        UVs without overlap; where they leave [0, 1] they repeat.
    reach : ndarray, shape (P,)
        Length of the rays at every position [world units].
    group : ndarray, shape (F,), optional
        Of the faces; all are of one if not given.
    """

    def __init__(self, mesh: Mesh, reach: np.ndarray, group: np.ndarray | None = None):
        mesh = split_mirrored(mesh)
        normals = mesh.normals()
        tangents, w = vertex_tangents(mesh, normals)
        smooth = vertex_normals(mesh.positions, mesh.position_faces)
        index = mesh.position_index
        columns = [mesh.vertices, w, normals[mesh.normal_groups], reach[index], tangents, w, smooth[index], w]
        self.packets = _flat(np.column_stack(columns))
        flat, which = _tiled(mesh)
        self.faces = upload(mi.UInt32, mesh.faces[which].ravel())
        self.group = upload(mi.UInt32, np.zeros(len(which), np.int64) if group is None else group[which])
        self.scene = _scene(np.column_stack([flat, np.zeros(len(flat))]), np.arange(len(flat)).reshape(-1, 3))

    def points(self, size: int, offset: tuple[float, float]) -> Points:
        """
        The surface at ``(k + offset) / size`` of every texel k, row by row.
        """
        k = dr.arange(mi.UInt32, size * size)
        u = (mi.Float(k % size) + dr.opaque(mi.Float, offset[0])) / size
        v = (mi.Float(k // size) + dr.opaque(mi.Float, offset[1])) / size
        pi = self.scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(u, v, -1), mi.Vector3f(0, 0, 1)), True)
        active = pi.is_valid()
        corners = dr.gather(mi.Vector3u, self.faces, pi.prim_index, active)
        pw, nr, tw, sw = _blend(self.packets, 4, corners, pi.prim_uv, active)
        n = dr.normalize(nr.xyz)
        t = dr.normalize(tw.xyz - n * dr.dot(n, tw.xyz))
        w = dr.select(tw.w < 0, mi.Float(-1), 1)
        group = dr.gather(mi.UInt32, self.group, pi.prim_index, active)
        return Points(active, mi.Point3f(pw.xyz), n, t, w, nr.w, dr.normalize(sw.xyz), group)


def _tiled(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Corners in the texture (3N, 2) of the faces, one copy for every tile that a face reaches, and which they are."""
    uv = mesh.uvs.astype(np.float64)[mesh.faces]
    low = np.floor(uv.min(1)).astype(int)
    high = np.maximum(np.ceil(uv.max(1)).astype(int) - 1, low)
    corners, faces = [], []
    for u in range(low[:, 0].min(), high[:, 0].max() + 1):
        for v in range(low[:, 1].min(), high[:, 1].max() + 1):
            here = (low <= [u, v]).all(1) & ([u, v] <= high).all(1)
            corners.append(uv[here] - [u, v])
            faces.append(np.flatnonzero(here))
    return np.concatenate(corners).reshape(-1, 2), np.concatenate(faces)


def _blend(packets: mi.Float, slots: int, corners: mi.Vector3u, b: mi.Point2f, active) -> list[mi.Vector4f]:
    """Vertex packets of four floats, ``slots`` to a vertex, interpolated in their triangles."""
    weights = (1 - b.x - b.y, b.x, b.y)
    return [
        sum(w * dr.gather(mi.Vector4f, packets, i * slots + k, active) for w, i in zip(weights, corners, strict=True))
        for k in range(slots)
    ]


class Images:
    """
    One texture of every material in one buffer; bilinear, texel centres at ``(k + .5) / N``.

    Parameters
    ----------
    images : list of ndarray, shape (H, W, C)
        C at most 4.
    lookups : list of Lookup
        Where each of them is looked up.
    """

    def __init__(self, images: list[np.ndarray], lookups: list[Lookup]):
        padded = [np.pad(np.float32(a), ((0, 0), (0, 0), (0, 4 - a.shape[2]))).reshape(-1, 4) for a in images]
        self.texels = _flat(np.concatenate(padded))
        self.first = upload(mi.UInt32, np.cumsum([0] + [len(p) for p in padded[:-1]]))
        self.width = mi.Int32([a.shape[1] for a in images])
        self.height = mi.Int32([a.shape[0] for a in images])
        self.is_plain = all(lookup == PLAIN for lookup in lookups)
        self.uvs = mi.UInt32([lookup.uvs for lookup in lookups])
        self.wraps = [mi.UInt32([WRAPS.index(lookup.wraps[axis]) for lookup in lookups]) for axis in (0, 1)]

    def _placed(self, index: mi.UInt32, uvs: list[mi.Point2f], size: tuple[mi.Int32, mi.Int32]) -> mi.Point2f:
        """Where the repeating image ``index`` is looked up."""
        if self.is_plain:
            return uvs[0]
        which, uv = dr.gather(mi.UInt32, self.uvs, index), uvs[0]
        for k, more in enumerate(uvs[1:]):
            uv = dr.select(which == k + 1, more, uv)
        out = []
        for x, n, wraps in zip(uv, size, self.wraps, strict=True):
            kind = dr.gather(mi.UInt32, wraps, index)
            for number, wrap in enumerate(WRAPS[1:], 1):
                x = dr.select(kind == number, folded(x, n, wrap), x)
            out.append(x)
        return mi.Point2f(*out)

    def at(self, index: mi.UInt32, uvs: list[mi.Point2f]) -> mi.Vector4f:
        """Image ``index`` at its own of the coordinates of a point, v = 0 at the top."""
        w, h = dr.gather(mi.Int32, self.width, index), dr.gather(mi.Int32, self.height, index)
        uv = self._placed(index, uvs, (w, h))
        first = dr.gather(mi.UInt32, self.first, index)
        x = (uv.x - dr.floor(uv.x)) * w - 0.5
        y = (uv.y - dr.floor(uv.y)) * h - 0.5
        x0, y0 = dr.floor(x), dr.floor(y)
        fx, fy = x - x0, y - y0
        ix, iy = mi.Int32(x0), mi.Int32(y0)
        out = mi.Vector4f(0)
        for dy, wy in ((0, 1 - fy), (1, fy)):
            for dx, wx in ((0, 1 - fx), (1, fx)):
                row, column = (iy + dy + h) % h, (ix + dx + w) % w
                out += wx * wy * dr.gather(mi.Vector4f, self.texels, first + mi.UInt32(row * w + column))
        return out


class Detail:
    """
    The reference: a scene to trace, and what it looks like at a hit.

    Parameters
    ----------
    soup : Soup
    group : ndarray, shape (F,), optional
        Of its faces; -1 for one that no point is of.
    """

    def __init__(self, soup: Soup, group: np.ndarray | None = None):
        self.group = None if group is None or (group == group[0]).all() else upload(mi.UInt32, np.maximum(group, 0))
        rows = np.column_stack([soup.vertices, soup.normals, soup.uvs, soup.colors, soup.more_uvs])
        rows, index = weld(rows)  # MikkTSpace shares a tangent where position, normal and UV are equal
        mesh = Mesh(rows[:, :3], np.arange(len(rows)), rows[:, 6:8].astype(np.float32), index[soup.faces])
        mesh = split_mirrored(mesh)
        rows = rows[mesh.position_index]
        whole = Mesh(rows[:, :3], np.arange(len(rows)), mesh.uvs, mesh.faces)
        tangents, w = vertex_tangents(whole, rows[:, 3:6])
        more = np.pad(rows[:, 12:], ((0, 0), (0, -(rows.shape[1] - 12) % 4)))  # two pairs in a slot
        self.slots = 4 + more.shape[1] // 4
        columns = [rows[:, :3], rows[:, 6], rows[:, 3:6], rows[:, 7], tangents, w, rows[:, 8:12], more]
        self.packets = _flat(np.column_stack(columns))
        self.faces = upload(mi.UInt32, mesh.faces.ravel())
        self.scene = _scene(rows[:, :3], mesh.faces)
        self.diagonal, self.step = mi.Float(soup.diagonal), mi.Float(1e-6 * soup.diagonal)

        self.material = upload(mi.UInt32, soup.material_index)

        def images(name: str, *neutral: float) -> Images:
            found = [getattr(m, name) for m in soup.materials]
            default = np.array(neutral, np.float32).reshape(1, 1, -1)
            return Images([default if x is None else x for x in found], [m.lookup(name) for m in soup.materials])

        self.base_color, self.specular, self.normal = (
            images("base_color"),
            images("specular"),
            images("normal", 0, 0, 1),
        )
        self.emission, self.occlusion = images("emission", 0, 0, 0), images("occlusion", 1)
        self.opaque = mi.Bool([m.alpha_mode == "OPAQUE" for m in soup.materials])
        self.blended = mi.Bool([m.alpha_mode == "BLEND" for m in soup.materials])
        self.cutoff = mi.Float([m.alpha_cutoff if m.alpha_mode == "MASK" else -1.0 for m in soup.materials])

    def search(self, s: Points) -> SurfacePoints:
        """
        From outside inwards along the smooth normal: of the surfaces that face alike the one closest to the point.
        """
        of_face = mi.UInt32(0) if self.group is None else self.group
        return _march(self.scene, self.faces, self.packets, self.slots, self.step, s, of_face, self.group is not None)

    def position(self, hits: SurfacePoints) -> mi.Point3f:
        """Where hits are; every face must exist."""
        corners = dr.gather(mi.Vector3u, self.faces, hits.face)
        return mi.Point3f(_blend(self.packets, self.slots, corners, hits.b, True)[0].xyz)

    def blends(self, hits: SurfacePoints) -> mi.Bool:
        """Whether the material of hits blends; every face must exist."""
        return dr.gather(mi.Bool, self.blended, dr.gather(mi.UInt32, self.material, hits.face))

    def face_normal(self, face: mi.UInt32, active) -> mi.Vector3f:
        """Unnormalised geometric normal of faces."""
        return _face_normal(self.packets, self.slots, dr.gather(mi.Vector3u, self.faces, face, active), active)

    def shade(self, s: Points, hits: SurfacePoints) -> list[mi.Float]:
        """
        What is seen at the hits, zero where a point is not active.

        Every face must exist, even there: LLVM 23 has been seen to drop the mask of a gather whose result a select
        with the same mask discards, so nothing is masked here.

        Returns
        -------
        list of mi.Float
            RGB times opacity, RGB, opacity, (gamma, roughness, metallic), tangent-space normal, height, emission,
            occlusion: ``N_VALUES`` numbers.
        """
        corners = dr.gather(mi.Vector3u, self.faces, hits.face)
        pu, nv, tw, color, *more = _blend(self.packets, self.slots, corners, hits.b, True)
        uv = [mi.Point2f(pu.w, nv.w)]
        for pair in more:
            uv += [mi.Point2f(pair.x, pair.y), mi.Point2f(pair.z, pair.w)]
        m = dr.gather(mi.UInt32, self.material, hits.face)
        base = self.base_color.at(m, uv) * color
        a = base.w
        cutoff = dr.gather(mi.Float, self.cutoff, m)
        a = dr.select(cutoff >= 0, dr.select(a >= cutoff, mi.Float(1), 0), a)
        a = dr.select(dr.gather(mi.Bool, self.opaque, m), 1, a)
        specular = self.specular.at(m, uv)

        n = dr.normalize(nv.xyz)
        t = tw.xyz - n * dr.dot(n, tw.xyz)
        t *= dr.rsqrt(dr.maximum(dr.squared_norm(t), 1e-20))
        b = dr.select(tw.w < 0, mi.Float(-1), 1) * dr.cross(n, t)
        local = self.normal.at(m, uv)
        n = dr.normalize(t * local.x + b * local.y + n * local.z)
        n = dr.select(
            dr.dot(_face_normal(self.packets, self.slots, corners, True), s.n) < 0, -n, n
        )  # seen from its back
        z = dr.maximum(dr.dot(s.n, n), LOWEST)
        low = dr.normalize(mi.Vector3f(dr.dot(s.t, n), s.w * dr.dot(dr.cross(s.n, s.t), n), z))
        height = dr.dot(pu.xyz - s.p, s.n)
        rgb = base.xyz
        glow, occlusion = self.emission.at(m, uv).xyz, self.occlusion.at(m, uv).x
        values = [*(rgb * a), *rgb, a, *specular.xyz, *low, height, *glow, occlusion]
        return [dr.select(s.active, x, 0) for x in values]


def _face_normal(packets: mi.Float, slots: int, corners: mi.Vector3u, active) -> mi.Vector3f:
    """Unnormalised geometric normal."""
    a, b, c = (dr.gather(mi.Vector4f, packets, i * slots, active).xyz for i in corners)
    return dr.cross(b - a, c - a)


@dr.syntax
def _march(
    scene: mi.Scene, faces: mi.UInt32, packets: mi.Float, slots: int, step: mi.Float, s: Points, of_face: mi.UInt32,
    grouped: bool,
) -> SurfacePoints:  # fmt: skip
    face, b = mi.UInt32(MISS), mi.Point2f(0)
    best = mi.Float(dr.inf)
    t = mi.Float(0)  # way from the outer end
    active = mi.Bool(s.active)
    n, reach = mi.Vector3f(s.ray), mi.Float(s.reach)
    start = mi.Point3f(s.p + n * reach)
    while active:
        ray = mi.Ray3f(start - n * t, -n)
        ray.maxt = 2 * reach - t
        pi = scene.ray_intersect_preliminary(ray, False, active)
        active &= pi.is_valid()
        t += dr.select(active, pi.t, 0)
        corners = dr.gather(mi.Vector3u, faces, pi.prim_index, active)
        off = dr.abs(t - reach)
        better = active & (dr.dot(_face_normal(packets, slots, corners, active), n) > 0) & (off < best)
        if dr.hint(grouped, mode="scalar"):
            better &= dr.gather(mi.UInt32, of_face, pi.prim_index, active) == s.group
        face = dr.select(better, pi.prim_index, face)
        b = dr.select(better, pi.prim_uv, b)
        best = dr.select(better, off, best)
        t += step
        active &= (t - reach < best) & (t < 2 * reach)  # all further hits lie deeper
    return SurfacePoints(face, b)
