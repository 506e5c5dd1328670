"""A mesh of the user's own: UVs kept to the bit where they can be baked to, refused or replaced where not."""

from dataclasses import replace

import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.errors import MeshError
from mi_simplify.initial.repair.kept import keep_mesh
from mi_simplify.initial.unwrap.atlas import texel_counts
from mi_simplify.initial.unwrap.charting import charts
from mi_simplify.model.asset import Asset, Instance, Part
from mi_simplify.model.tangents import face_tangents


def asset_of(*parts: Part) -> Asset:
    return Asset(parts, tuple(Instance(k) for k in range(len(parts))), name="low.obj")


def box(uv_of_side) -> Part:
    """A cube of six quads with vertices of their own; ``uv_of_side(k, ab)`` lays side k out."""
    ab = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    vertices, uvs = [], []
    for k in range(6):
        side = 1 - 2 * (k % 2)
        x, y, z = np.roll(np.eye(3), k // 2, axis=0)
        vertices.append((2 * ab[:, :1] - 1) * x * side + (2 * ab[:, 1:] - 1) * y + side * z)
        uvs.append(uv_of_side(k, np.stack([ab[:, 0], 1 - ab[:, 1]], 1)))
    faces = (np.arange(6)[:, None, None] * 4 + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    return Part(np.concatenate(vertices), faces, uvs=np.concatenate(uvs).astype(np.float32))


def apart(k, ab):
    """Six cells of the texture."""
    return (0.1 + 0.8 * ab + [k % 3, k // 3]) / [3, 2]


def test_a_layout_without_overlap_is_kept_to_the_bit():
    part = box(apart)
    mesh, notes = keep_mesh(asset_of(part), keep_uv=True)
    assert not any("new texture coordinates" in n for n in notes)
    assert len(mesh.positions) == 8 and len(mesh.uvs) == 24
    assert np.array_equal(mesh.uvs[mesh.faces], part.uvs[part.faces])
    assert np.array_equal(mesh.vertices[mesh.faces], part.vertices[part.faces])


def test_vertices_are_merged_where_position_and_coordinates_agree():
    part = box(apart)
    corners = part.faces.ravel()
    soup = Part(part.vertices[corners], np.arange(36).reshape(-1, 3), uvs=part.uvs[corners])
    mesh, _ = keep_mesh(asset_of(soup), keep_uv=True)
    assert len(mesh.positions) == 8 and len(mesh.uvs) == 24
    assert np.array_equal(mesh.uvs[mesh.faces], part.uvs[part.faces])


def test_tiles_beside_the_unit_square_are_kept():
    """Parts on tiles of their own (UDIM) that do not meet when they repeat."""
    part = box(lambda k, ab: apart(k, ab) + [k % 2, -(k // 2)])
    mesh, _ = keep_mesh(asset_of(part), keep_uv=True)
    assert np.array_equal(mesh.uvs[mesh.faces], part.uvs[part.faces])
    assert texel_counts(mesh, 128).max() == 1


def test_several_parts_share_one_texture_where_they_fit():
    part = box(apart)
    left, right = (
        Part(part.vertices + [3 * k, 0, 0], part.faces, uvs=part.uvs * [0.5, 1] + np.float32([0.5 * k, 0]))
        for k in (0, 1)
    )
    mesh, _ = keep_mesh(asset_of(left, right), keep_uv=True)
    assert len(mesh.faces) == 24 and mesh.uvs[:, 0].max() > 0.5
    with pytest.raises(MeshError, match=r"its own overlap on 100\.0% of the texture"):
        keep_mesh(asset_of(part, replace(right, uvs=part.uvs)), keep_uv=True)


UNUSABLE = {
    "overlap": (box(lambda k, ab: ab), "its own overlap on 100.0% of the texture"),
    "none": (Part(box(apart).vertices, box(apart).faces), "the mesh has none everywhere"),
    "no area": (
        box(lambda k, ab: apart(k, ab) * [1, 0 if k == 3 else 1]),
        "some of its triangles have no area in the texture",
    ),
    "far": (box(lambda k, ab: apart(k, ab) + [7, 0]), "its own reach over many copies of the texture"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_what_cannot_be_baked_to_is_unwrapped_anew_or_refused(name):
    part, why = UNUSABLE[name]
    mesh, notes = keep_mesh(asset_of(part), atlas_size=128)
    assert f"new texture coordinates: {why}" in notes
    assert np.array_equal(mesh.vertices[mesh.faces], part.vertices[part.faces])  # same faces, same order
    assert texel_counts(mesh, 128).max() == 1
    with pytest.raises(MeshError, match=f"of low.obj cannot be kept: {why}; lay them out without overlap"):
        keep_mesh(asset_of(part), keep_uv=True)


def test_mirrored_charts_are_kept_and_their_vertices_split():
    sphere = charted_sphere(4)
    fold = np.isin(charts(sphere)[0], np.unique(charts(sphere)[0])[3:4])  # the folded chart overlaps itself
    part = Part(sphere.vertices, sphere.faces[~fold], uvs=sphere.uvs)
    mesh, _ = keep_mesh(asset_of(part), keep_uv=True)
    _, sign = face_tangents(mesh)
    assert set(sign) == {-1, 1}
    for vertex_sign in (sign[(mesh.faces == v).any(1)] for v in range(len(mesh.uvs))):
        assert len(set(vertex_sign)) == 1
    assert np.array_equal(mesh.uvs[mesh.faces], part.uvs[part.faces])


def test_creases_run_along_seams_only():
    """Inside a chart a crease would let the texels of one side bleed into the other."""
    mesh, _ = keep_mesh(asset_of(box(apart)), crease_angle=30)
    n = mesh.normals()[mesh.normal_groups]
    assert np.allclose(np.abs(n).max(1), 1)
    bent = Part(
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, -1], [1, 1, -1]], float),
        np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]),
        uvs=np.float32([[0, 1], [0.5, 1], [0.5, 0], [0, 0], [1, 1], [1, 0]]),
    )
    mesh, _ = keep_mesh(asset_of(bent), crease_angle=30)
    assert len(np.unique(mesh.normal_groups)) == 6  # one chart over the edge: one normal along it


def test_a_defect_of_the_mesh_is_mended_and_told():
    part = box(apart)
    broken = Part(part.vertices, np.concatenate([part.faces, part.faces[:1], [[0, 0, 1]]]), uvs=part.uvs)
    mesh, notes = keep_mesh(asset_of(broken), keep_uv=True)
    assert len(mesh.faces) == 12
    assert "1 degenerate faces dropped" in notes and "1 duplicate faces dropped" in notes
