"""
Assets as Mitsuba shapes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..machine.meshes import make_mesh
from ..model.asset import Asset, Instance, Lookup, Material, Part
from ..model.mesh import Mesh
from ..model.tangents import split_mirrored, vertex_tangents
from ..model.topology import area_vectors, vertex_normals, weld


def part_normals(part: Part) -> np.ndarray:
    """
    Shading normals of a part, shape (V, 3): the file's, or angle-weighted over welded positions.
    """
    if part.normals is not None:
        return part.normals
    positions, index = weld(part.vertices)
    return vertex_normals(positions, index[part.faces])[index]


def bitmap(image: np.ndarray, wrap: str = "repeat") -> dict:
    """
    Mitsuba texture of a linear float image, shape (H, W, C).
    """
    if image.shape[2] == 2:
        raise ValueError("a texture has 1, 3 or 4 channels")
    data = mi.Bitmap(np.ascontiguousarray(image, np.float32))
    return {"type": "bitmap", "bitmap": data, "raw": True, "wrap_mode": wrap}


def _texture(image: np.ndarray, lookup: Lookup) -> dict:
    """A bitmap looked up where a material says."""
    wrap_u, wrap_v = lookup.wraps
    if lookup.uvs == 0 and wrap_u == wrap_v:
        return bitmap(image, wrap_u)
    uvs = f"vertex_uv{lookup.uvs}" if lookup.uvs else ""
    return {"type": "mapped_texture", "image": bitmap(image), "uvs": uvs, "wrap_u": wrap_u, "wrap_v": wrap_v}


def _constant(image: np.ndarray) -> bool:
    return image.shape[0] == 1 and image.shape[1] == 1


def _scalar(image: np.ndarray, lookup: Lookup):
    return float(image[0, 0, 0]) if _constant(image) else _texture(image, lookup)


def material_bsdf(
    material: Material, *, mesh_tangents: bool = False, vertex_colors: bool = False, form: str = "gltf"
) -> dict:
    """
    The ``ggx_gamma`` description of a material, for meshes with the attributes that the two switches speak of.
    """
    color, of_base, of_specular = material.base_color[..., :3], *map(material.lookup, ("base_color", "specular"))
    base = {"type": "rgb", "value": [float(c) for c in color[0, 0]]} if _constant(color) else _texture(color, of_base)
    out: dict[str, Any] = {"type": "ggx_gamma", "form": form, "base_color": base, "vertex_colors": vertex_colors}
    for channel, name in enumerate(("gamma", "roughness", "metallic")):
        out[name] = _scalar(material.specular[..., channel : channel + 1], of_specular)
    if material.alpha_mode != "OPAQUE":
        out["opacity"] = _scalar(material.base_color[..., 3:4], of_base)
        if material.alpha_mode == "MASK":
            out["opacity_cutoff"] = material.alpha_cutoff
    if material.normal is not None:
        out["normal_map"] = _texture(material.normal * 0.5 + 0.5, material.lookup("normal"))
        out["mesh_tangents"] = mesh_tangents
    if material.emission is not None:
        out["emission"] = _texture(material.emission, material.lookup("emission"))
    return out


def _oriented(part: Part, normals: np.ndarray) -> Part:
    """
    Rewind a part whose winding disagrees with most of its own shading normals, which then would be lit from behind.
    """
    p = part.vertices[part.faces]
    area = area_vectors(p)
    agree = np.einsum("fi,fi->", area, normals[part.faces].sum(1))
    return replace(part, faces=part.faces[:, ::-1]) if agree < 0 else part


#: Parts placed more often than this become one mesh of all their copies, or, beyond so many triangles in all, Mitsuba
#: instances: each of those is traced anew into every kernel, 0.15 s a piece, so that a thousand leaves take minutes.
_MANY, _COPIED = 8, 20_000_000


def asset_shapes(asset: Asset, *, form: str = "gltf") -> dict[str, mi.Object]:
    """
    Mitsuba shapes of an asset for a scene dictionary; the copies of a part placed often share a mesh or a shape group.

    Instances of a group map normals along ∂p/∂u of the face: a mesh attribute, such as the tangents of the others,
    stays in the coordinates of the group.
    """
    counts = np.bincount([i.part for i in asset.instances], minlength=len(asset.parts))
    few = replace(asset, instances=tuple(i for i in asset.instances if counts[i.part] <= _MANY))
    bsdfs: dict[tuple, mi.BSDF] = {}
    out = {f"part_{k}": _part_mesh(f"part_{k}", part, bsdfs, form) for k, part in enumerate(few.placed())}
    for p in np.flatnonzero(counts > _MANY).tolist():
        placements = tuple(i for i in asset.instances if i.part == p)
        if len(placements) * len(asset.parts[p].faces) <= _COPIED:
            out[f"copies_{p}"] = _part_mesh(f"copies_{p}", _copied(asset, p, placements), bsdfs, form)
            continue
        mesh = _part_mesh(f"group_{p}", asset.parts[p], bsdfs, form, in_group=True)
        group = mi.load_dict({"type": "shapegroup", "mesh": mesh})
        out[f"group_{p}"] = group
        for k, inst in enumerate(placements):
            to_world = mi.ScalarTransform4f(inst.to_world)
            out[f"group_{p}_{k}"] = mi.load_dict({"type": "instance", "to_world": to_world, "group": group})
    return out


def _copied(asset: Asset, p: int, placements: tuple[Instance, ...]) -> Part:
    """All copies of a part as one."""
    part = asset.parts[p]
    part = replace(part, normals=part_normals(part))
    copies = Asset((part,), tuple(replace(i, part=0) for i in placements)).placed()
    n, start = len(copies), np.arange(len(copies))[:, None, None] * len(part.vertices)
    return replace(
        part,
        vertices=np.concatenate([c.vertices for c in copies]),
        faces=(np.stack([c.faces for c in copies]) + start).reshape(-1, 3),
        normals=np.concatenate([c.normals for c in copies]),
        uvs=None if part.uvs is None else np.tile(part.uvs, (n, 1)),
        more_uvs=tuple(np.tile(uvs, (n, 1)) for uvs in part.more_uvs),
        colors=None if part.colors is None else np.tile(part.colors, (n, 1)),
    )


def _part_mesh(name: str, part: Part, bsdfs: dict[tuple, mi.BSDF], form: str, in_group: bool = False) -> mi.Mesh:
    return rendered_mesh(name, *rendered_part(part, with_tangents=not in_group)[:3], bsdfs, form)


def rendered_mesh(
    name: str, part: Part, normals: np.ndarray, tangents: np.ndarray | None, bsdfs: dict[tuple, mi.BSDF], form: str
) -> mi.Mesh:
    """
    The Mitsuba mesh of what :func:`rendered_part` returned; ``bsdfs`` collects those that meshes share.
    """
    attributes = {"mesh_tangents": tangents is not None, "vertex_colors": part.colors is not None}
    key = (id(part.material), *attributes.values())
    if key not in bsdfs:
        bsdfs[key] = mi.load_dict(material_bsdf(part.material, **attributes, form=form))
    bsdf = bsdfs[key]
    return make_mesh(name, part.vertices, part.faces, normals, part.uvs, bsdf, tangents, part.colors, part.more_uvs)


def rendered_part(part: Part, with_tangents: bool = True) -> tuple[Part, np.ndarray, np.ndarray | None, np.ndarray]:
    """
    A part as Mitsuba renders it.

    Returns
    -------
    part : Part
        Wound as its normals look; where it needs tangents with its vertices merged where all their data are equal, and
        split where the texture is mirrored.
    normals : ndarray, shape (V, 3)
    tangents : ndarray, shape (V, 3), or None
        Where there is a normal map.
    source : ndarray, shape (V,), int64
        Vertex of the part handed in that each one is made of.
    """
    normals = part_normals(part)
    part = _oriented(part, normals)
    if not with_tangents or part.material.normal is None or part.uvs is None:
        return part, normals, None, np.arange(len(part.vertices))
    colors = [] if part.colors is None else [part.colors]
    skin = [] if part.skin is None else [part.skin.joints, part.skin.weights]
    _, index = weld(np.concatenate([part.vertices, normals, part.uvs, *part.more_uvs, *colors, *skin], axis=1))
    _, first = np.unique(index, return_index=True)
    mesh = split_mirrored(Mesh(part.vertices[first], np.arange(len(first)), part.uvs[first], index[part.faces]))
    source = first[mesh.position_index]
    tangents, _ = vertex_tangents(mesh, normals[first])
    part = replace(
        part, vertices=mesh.vertices, faces=mesh.faces, uvs=mesh.uvs, normals=normals[source].astype(np.float32),
        more_uvs=tuple(uvs[source] for uvs in part.more_uvs),
        colors=None if part.colors is None else part.colors[source],
        skin=None if part.skin is None else part.skin.taken(source),
    )  # fmt: skip
    return part, normals[source], tangents, source
