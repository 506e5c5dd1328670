"""Unwrapping: no overlap, the padding that was asked for, no mirrored charts, little stretch, creases."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from mi_simplify.errors import MeshError
from mi_simplify.initial.sphere import sphere
from mi_simplify.initial.unwrap.atlas import texel_counts
from mi_simplify.initial.unwrap.charting import charts, check, unwrap
from mi_simplify.initial.unwrap.segmentation import conformal_stretch
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.tangents import face_tangents
from mi_simplify.model.topology import area_vectors, corner_angles

BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
BOX_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
BOX_FACES = np.concatenate([BOX_FACES[:, [0, 1, 2]], BOX_FACES[:, [0, 2, 3]]])


def bumpy(n=600):
    p, f = sphere(n)
    return p * (1 + 0.15 * np.sin(6 * p[:, :1]) * np.cos(5 * p[:, 1:2])) * [1, 1.4, 0.8], f


def only(mesh: Mesh, which: np.ndarray) -> Mesh:
    return Mesh(mesh.positions, mesh.position_index, mesh.uvs, mesh.faces[which])


def gap(mesh: Mesh, size: int) -> float:
    """Least number of texels between two charts, and twice that to the border of the texture."""
    chart, n = charts(mesh)
    least = np.inf
    for k in range(n):
        own, rest = (texel_counts(only(mesh, which), size) > 0 for which in (chart == k, chart != k))
        least = min(least, (distance_transform_edt(~own) - 1)[rest].min(initial=np.inf))
    q = mesh.uvs[mesh.faces] * size
    return min(least, 2 * min(q.min(), size - q.max()))


def check_layout(mesh: Mesh, positions: np.ndarray, faces: np.ndarray, size: int) -> None:
    """The same triangles in the same order, on texels of their own, none mirrored."""
    assert np.array_equal(mesh.position_faces, faces) and np.array_equal(mesh.positions, positions)
    assert mesh.uvs.dtype == np.float32 and 0 <= mesh.uvs.min() and mesh.uvs.max() <= 1
    assert texel_counts(mesh, size).max() == 1
    assert texel_counts(mesh, 4 * size).max() == 1
    assert (face_tangents(mesh)[1] == 1).all()


@pytest.mark.parametrize("padding", [2, 6])
def test_charts_neither_overlap_nor_touch_nor_mirror(padding):
    p, f = bumpy()
    mesh, notes = unwrap(p, f, atlas_size=256, padding=padding)
    assert notes == []
    check_layout(mesh, p, f, 256)
    assert gap(mesh, 256) >= padding - 1  # a texel at most is lost where charts end between two centres


def test_texels_are_shared_out_by_area():
    p, f = bumpy()
    mesh, _ = unwrap(p, f, atlas_size=512)
    c, q = p[f], mesh.uvs[mesh.faces].astype(float)
    area = np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1)
    d, e = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    density = np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]) / area
    assert np.quantile(density, 0.95) < 1.6 * np.quantile(density, 0.05)


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_size_and_place_do_not_matter(scale):
    p, f = bumpy(200)
    mesh, notes = unwrap(p * scale + 3 * scale, f, atlas_size=128)
    assert notes == []
    check_layout(mesh, p * scale + 3 * scale, f, 128)


def test_creases_have_two_normals_and_cost_no_chart():
    mesh, _ = unwrap(BOX, BOX_FACES, atlas_size=128, crease_angle=30)
    check_layout(mesh, BOX, BOX_FACES, 128)
    assert len(mesh.uvs) == 24  # four corners a side, wherever the charts end
    n = mesh.normals()[mesh.normal_groups]
    assert np.allclose(np.abs(n).max(1), 1)  # each side is flat
    smooth, _ = unwrap(BOX, BOX_FACES, atlas_size=128)
    assert np.array_equal(smooth.uvs[smooth.faces], mesh.uvs[mesh.faces])  # the same charts
    assert np.array_equal(charts(smooth)[0], charts(mesh)[0]) and len(smooth.uvs) <= 24
    assert np.abs(smooth.normals()).sum(1).min() > 0.94 * 3**0.5  # nearly along the diagonals, 20 degrees at most


def test_the_same_mesh_is_unwrapped_the_same_way():
    p, f = bumpy(200)
    a, b = (unwrap(p, f, atlas_size=128)[0] for _ in range(2))
    assert np.array_equal(a.uvs, b.uvs) and np.array_equal(a.faces, b.faces)


def test_creases_cost_a_vertex_at_hard_edges_only():
    nowhere = np.zeros(BOX_FACES.shape, bool)
    mesh, _ = unwrap(BOX, BOX_FACES, atlas_size=128, crease_angle=30, hard=nowhere)
    smooth, _ = unwrap(BOX, BOX_FACES, atlas_size=128, crease_angle=180)
    assert len(mesh.uvs) == len(smooth.uvs) < 24
    assert len(np.unique(mesh.normal_groups)) > len(np.unique(smooth.normal_groups))  # along the borders of charts
    corners = BOX[BOX_FACES]
    top = (corners[..., 1] == 1) & (np.roll(corners, -1, axis=1)[..., 1] == 1)
    top &= np.abs(np.roll(corners, -1, axis=1) - corners).sum(2) == 1  # no diagonal
    mesh, _ = unwrap(BOX, BOX_FACES, atlas_size=128, crease_angle=30, hard=top)
    check_layout(mesh, BOX, BOX_FACES, 128)
    n = mesh.normals()[mesh.normal_groups[mesh.faces]]
    lid = (corners[..., 1] == 1).all(1)
    assert np.allclose(n[lid], [0, 1, 0])


@pytest.mark.parametrize("n", [1, 2, 40])
def test_loose_triangles_are_charts_of_their_own(n):
    rng = np.random.default_rng(n)
    p, f = rng.normal(size=(3 * n, 3)), np.arange(3 * n).reshape(-1, 3)
    mesh, _ = unwrap(p, f, atlas_size=128)
    check_layout(mesh, p, f, 128)
    assert charts(mesh)[1] == n


def test_faces_without_area_and_edges_of_three_faces_are_laid_out():
    p, f = bumpy(200)
    p = np.concatenate([p, p[f[0]].mean(0, keepdims=True) * 1.5])
    f = np.concatenate([f, [[f[0, 0], f[0, 1], len(p) - 1]]])
    p[f[50, 2]] = p[f[50, 0]]  # two faces collapse
    mesh, _ = unwrap(p, f, atlas_size=256)
    assert np.array_equal(mesh.position_faces, f) and texel_counts(mesh, 1024).max() == 1


def test_an_atlas_too_small_for_its_charts_is_refused_with_the_size_that_may_do():
    rng = np.random.default_rng(0)
    p, f = rng.normal(size=(600, 3)), np.arange(600).reshape(-1, 3)
    with pytest.raises(MeshError, match="200 charts do not fit a 16² atlas with 4 texels .* size of at least 32"):
        unwrap(p, f, atlas_size=16)
    with pytest.raises(MeshError, match="no faces"):
        unwrap(p, f[:0])


def test_the_check_warns_of_few_texels_and_thin_charts():
    p, f = bumpy(2000)
    _, notes = unwrap(p, f, atlas_size=64, padding=1)
    assert any("texels a triangle in a 64² atlas; use a larger atlas or fewer triangles" in n for n in notes)
    strip = Mesh(np.eye(4)[:, :3], np.arange(4), np.float32([[0, 0], [1, 0], [1, 0.005], [0, 0.005]]),
                 np.array([[0, 1, 2], [0, 2, 3]]))  # fmt: skip
    notes = check(strip, 512)
    assert any("100% of the surface lies in charts narrower than 4 texels" in n for n in notes)
    assert any("charts cover only 0% of the atlas" in n or "1% of the atlas" in n for n in notes)


def test_a_closed_surface_is_no_chart():
    """It has no border to keep its length; a tetrahedron beside one open triangle."""
    positions = np.float64([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 0, 0], [6, 0, 0], [5, 1, 0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2], [4, 5, 6]])
    area = np.linalg.norm(area_vectors(positions[faces]), axis=1) / 2
    stretch = conformal_stretch(positions, faces, np.array([0, 0, 0, 0, 1]), corner_angles(positions, faces), area)
    assert stretch[0] == np.inf and stretch[1] == pytest.approx(1)
