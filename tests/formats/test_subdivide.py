"""Subdivision surfaces: known points of the schemes, creases, laws, and meshes of USD files."""

from dataclasses import replace

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from mi_simplify.formats.load import load_asset
from mi_simplify.formats.usd.subdivide import INFINITE, Cage, refined

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
CUBE_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
EDGES = np.array([[a, b] for a in range(8) for b in range(a + 1, 8) if np.abs(CUBE[a] - CUBE[b]).sum() == 2])
OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
OCTAHEDRON_FACES = np.array(
    [[a, b, c] if (a + b // 2 + c) % 2 else [b, a, c] for a in (0, 1) for b in (2, 3) for c in (4, 5)]
)


def cage(points, faces, creases=(), sharpness=()) -> Cage:
    ends = np.array(creases, np.int64).reshape(-1, 2)
    sharp = np.array(sharpness, float)
    return Cage(points, faces.ravel(), np.full(len(faces), faces.shape[1]), ends, sharp, np.zeros(len(points)))


def has(points: np.ndarray, *wanted) -> bool:
    return all((np.abs(points - w).max(1) < 1e-12).any() for w in wanted)


def test_a_cube_by_catmull_and_clark():
    fine, face, _ = refined(cage(CUBE, CUBE_FACES), "catmullClark", 1)
    assert len(fine.points) == 26 and len(fine.counts) == 24 and np.bincount(face).tolist() == [4] * 6
    assert has(fine.points, [1, 0, 0], [0.75, 0.75, 0], [5 / 9, 5 / 9, 5 / 9])
    p = fine.points[fine.index.reshape(-1, 4)]
    outwards = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])
    assert (np.einsum("fi,fi->f", outwards, p.mean(1)) > 0).all()  # wound as the cube is


def test_an_octahedron_by_loop():
    fine, _, _ = refined(cage(OCTAHEDRON, OCTAHEDRON_FACES), "loop", 1)
    beta = (5 / 8 - (3 / 8) ** 2) / 4
    assert len(fine.points) == 18 and len(fine.counts) == 32
    assert has(fine.points, [1 - 4 * beta, 0, 0], [3 / 8, 3 / 8, 0])


def test_sharp_edges_keep_a_cube_and_blunt_ones_round_it():
    sharp, _, _ = refined(cage(CUBE, CUBE_FACES, EDGES, [INFINITE] * 12), "catmullClark", 3)
    assert np.abs(sharp.points).max(1) == pytest.approx(1) and has(sharp.points, *CUBE)
    once, _, _ = refined(cage(CUBE, CUBE_FACES, EDGES, [1] * 12), "catmullClark", 2)
    twice, _, _ = refined(cage(CUBE, CUBE_FACES, EDGES, [2] * 12), "catmullClark", 2)
    smooth, _, _ = refined(cage(CUBE, CUBE_FACES), "catmullClark", 2)
    reach = [np.linalg.norm(c.points, axis=1).max() for c in (smooth, once, twice)]
    assert reach[0] < reach[1] < reach[2] == pytest.approx(3**0.5)
    half, _, _ = refined(cage(CUBE, CUBE_FACES, EDGES, [0.5] * 12), "catmullClark", 1)
    assert has(half.points, [0.875, 0.875, 0], [7 / 9, 7 / 9, 7 / 9])  # halfway between smooth and sharp


def test_a_corner_of_one_edge_ring_follows_the_crease():
    """The four edges of a cube's top: its corners move along the curve of the crease."""
    top = EDGES[(CUBE[EDGES][:, :, 2] == 1).all(1)]
    fine, _, _ = refined(cage(CUBE, CUBE_FACES, top, [INFINITE] * 4), "catmullClark", 1)
    assert has(fine.points, [0.75, 0.75, 1], [1, 0, 1])  # (6 v + a + b) / 8, and a middle


@pytest.mark.parametrize("scheme", ["catmullClark", "loop"])
def test_a_flat_sheet_stays_flat_with_its_corners(scheme):
    points = np.array([[x, y, 0] for x in range(4) for y in range(4)], float)
    a = np.array([4 * x + y for x in range(3) for y in range(3)])
    faces = np.stack([a, a + 4, a + 5, a + 1], axis=1)
    if scheme == "loop":
        faces = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    fine, _, weights = refined(cage(points, faces), scheme, 2)
    assert (fine.points[:, 2] == 0).all()
    if scheme == "catmullClark":
        assert has(fine.points, [0, 0, 0], [3, 3, 0])
    np.testing.assert_allclose([fine.points.min(0), fine.points.max(0)], [[0, 0, 0], [3, 3, 0]], atol=1e-12)
    # What is linear on the corners stays so: here the values are those of one plane.
    values = weights @ (points[faces.ravel()] @ [[1.0], [2.0], [0.0]])
    middle = values.reshape(len(fine.counts), -1).mean()
    assert middle == pytest.approx(1.5 + 3) and values.min() == 0 and values.max() == 9
    np.testing.assert_allclose(np.asarray(weights.sum(axis=1)).ravel(), 1)


def test_subdivision_moves_with_the_cage():
    rng = np.random.default_rng(0)
    matrix, offset = rng.normal(size=(3, 3)), rng.normal(size=3)
    some = cage(CUBE + rng.normal(0, 0.2, CUBE.shape), CUBE_FACES, EDGES[:5], [0.5, 1, 1.5, 2, INFINITE])
    fine, _, _ = refined(some, "catmullClark", 3)
    moved, _, _ = refined(replace(some, points=some.points @ matrix.T + offset), "catmullClark", 3)
    np.testing.assert_allclose(moved.points, fine.points @ matrix.T + offset, atol=1e-10)


def write_cube(path, scheme=True, normals=False, creases=False):
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/cube")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(CUBE.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(CUBE_FACES.ravel().tolist())
    if scheme:
        mesh.CreateSubdivisionSchemeAttr("catmullClark")
    if normals:
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy((CUBE / 3**0.5).astype(np.float32)))
    if creases:
        mesh.CreateCreaseLengthsAttr([2] * 12)
        mesh.CreateCreaseIndicesAttr(EDGES.ravel().tolist())
        mesh.CreateCreaseSharpnessesAttr([10.0] * 12)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    st.Set([(0, 0), (1, 0), (1, 1), (0, 1)] * 6)
    stage.Save()
    return load_asset(path)


def test_a_usd_mesh_is_the_surface_not_its_cage(tmp_path):
    asset = write_cube(tmp_path / "a.usda")
    (part,) = asset.parts
    assert len(part.faces) == 2 * 6 * 16 and asset.notes == ("'cube', a catmullClark surface, is subdivided 2 times",)
    assert np.linalg.norm(part.vertices, axis=1).max() < 1.05  # the limit is nearly a ball
    assert (part.uvs.min(0) == 0).all() and (part.uvs.max(0) == 1).all()
    assert set(np.unique(part.uvs).tolist()) == {0, 0.25, 0.5, 0.75, 1}
    sharp = write_cube(tmp_path / "b.usda", creases=True)
    np.testing.assert_allclose(sharp.bounds, [[-1] * 3, [1] * 3], atol=1e-6)


@pytest.mark.parametrize(("what", "reason"), [("scheme", "by default only"), ("normals", "normals of its own")])
def test_a_cage_that_is_meant_as_a_mesh_stays_one(tmp_path, what, reason):
    asset = write_cube(tmp_path / "a.usda", scheme=what != "scheme", normals=what == "normals")
    assert asset.n_triangles == 12
    assert reason in asset.notes[0] and "its control cage is used" in asset.notes[0]
