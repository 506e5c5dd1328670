"""Polygons as triangles: area, orientation and attributes are right for concave ones too, whatever the format."""

import numpy as np
import pytest
from support.exchange import collada, fbx

from mi_simplify.errors import MeshError
from mi_simplify.formats import triangulate as module
from mi_simplify.formats.load import load_asset
from mi_simplify.formats.polygons import fan
from mi_simplify.formats.triangulate import triangulate
from mi_simplify.model.topology import area_vectors

#: The letter E, of 11 squares; its first corner does not see all the others.
E = np.array(
    [[0, 0, 0], [3, 0, 0], [3, 1, 0], [1, 1, 0], [1, 2, 0], [3, 2, 0], [3, 3, 0], [1, 3, 0], [1, 4, 0], [3, 4, 0],
     [3, 5, 0], [0, 5, 0]], float,
)  # fmt: skip


def areas(points: np.ndarray, axis: int = 2) -> np.ndarray:
    """Signed areas of the triangles of one polygon."""
    corners, polygons = triangulate(points, np.arange(len(points)), np.array([len(points)]), "a")
    assert len(corners) == len(points) - 2 and (polygons == 0).all()
    assert set(corners.ravel()) == set(range(len(points)))  # collinear corners stay, too
    return area_vectors(points[corners])[:, axis] / 2


def in_obj(folder):
    lines = [f"v {x} {y} {z}\nvt {x / 5} {y / 5}\n" for x, y, z in E]
    (folder / "e.obj").write_text("".join(lines) + "f " + " ".join(f"{k}/{k}" for k in range(1, 13)) + "\n")
    return folder / "e.obj"


def in_ply(folder):
    rows = "".join(f"{x} {y} {z} {x / 5} {y / 5}\n" for x, y, z in E)
    head = "".join(f"property float {c}\n" for c in ("x", "y", "z", "s", "t"))
    text = f"ply\nformat ascii 1.0\nelement vertex 12\n{head}element face 1\nproperty list uchar int vertex_indices\n"
    (folder / "e.ply").write_text(f"{text}end_header\n{rows}12 {' '.join(map(str, range(12)))}\n")
    return folder / "e.ply"


def in_usd(folder):
    points, st = ", ".join(f"({x}, {y}, {z})" for x, y, z in E), ", ".join(f"({x / 5}, {y / 5})" for x, y, _ in E)
    (folder / "e.usda").write_text(
        '#usda 1.0\n(upAxis = "Y")\ndef Mesh "E"\n{\n  uniform token subdivisionScheme = "none"\n'
        f"  int[] faceVertexCounts = [12]\n  int[] faceVertexIndices = {list(range(12))}\n"
        f'  point3f[] points = [{points}]\n  texCoord2f[] primvars:st = [{st}] (interpolation = "faceVarying")\n}}\n'
    )
    return folder / "e.usda"


def in_dae(folder):
    pytest.importorskip("assimp_py")
    (folder / "e.dae").write_text(collada(E, [range(12)], E[:, :2] / 5))
    return folder / "e.dae"


def in_fbx(folder):
    pytest.importorskip("assimp_py")
    (folder / "e.fbx").write_text(fbx(E, [range(12)], E[:, :2] / 5))
    return folder / "e.fbx"


@pytest.mark.parametrize("writer", [in_obj, in_ply, in_usd, in_dae, in_fbx])
def test_a_concave_polygon_is_covered_once_and_texture_coordinates_follow(tmp_path, writer):
    (part,) = load_asset(writer(tmp_path)).parts
    signed = area_vectors(part.vertices[part.faces])[:, 2] / 2
    assert len(signed) == 10 and signed.min() > 0
    np.testing.assert_allclose(signed.sum(), 11)
    assert part.uvs is not None
    np.testing.assert_allclose(part.uvs, part.vertices[:, :2] * [0.2, -0.2] + [0, 1], atol=1e-6)


@pytest.mark.parametrize("start", range(4))
def test_a_dart_is_cut_along_its_inner_diagonal(start):
    dart = np.roll(np.array([[0, 0, 0], [1, 0.9, 0], [2, 0, 0], [1, 2, 0]], float), start, axis=0)
    signed = areas(dart)
    assert signed.min() > 0
    np.testing.assert_allclose(signed.sum(), 1.1)


def test_stars_of_any_size_place_and_direction_are_covered():
    rng = np.random.default_rng(0)
    for n in (5, 8, 13, 60, 300):
        angles = (np.arange(n) + rng.uniform(0, 0.9, n)) * (2 * np.pi / n)
        radii = rng.uniform(0.3, 1, n)
        star = np.stack([radii * np.cos(angles), radii * np.sin(angles), 0 * radii], axis=1)
        true = 0.5 * np.sum(radii * np.roll(radii, -1) * np.sin(np.roll(angles, -1) - angles))
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        for points, axis in ((star, 2), (star[::-1], 2), (np.roll(star, 1, axis=1), 0), (star + [5e5, 4e6, 0], 2)):
            signed = areas(points, axis)
            assert signed.min() >= 0 or signed.max() <= 0
            np.testing.assert_allclose(abs(signed.sum()), true, rtol=1e-6)
        corners, _ = triangulate(star @ rotation.T, np.arange(n), np.array([n]), "a")
        vectors = area_vectors(star[corners])[:, 2]
        np.testing.assert_allclose(np.abs(vectors).sum() / 2, true)


def test_a_hole_behind_a_bridge_stays_open():
    outer, inner = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]], [[1, 1], [1, 3], [3, 3], [3, 1], [1, 1]]
    signed = areas(np.concatenate([np.array(outer + inner, float), np.zeros((10, 1))], axis=1))
    assert signed.min() >= 0
    np.testing.assert_allclose(signed.sum(), 12)


def test_many_polygons_at_once_are_those_alone(monkeypatch):
    rng = np.random.default_rng(1)
    counts = rng.integers(0, 9, 400)
    points, begin = np.zeros((counts.sum(), 3)), 0
    for n in counts:
        angles = (np.arange(n) + rng.uniform(0, 0.9, n)) * (2 * np.pi / max(n, 1))
        radii = rng.uniform(0.3, 1, n)
        points[begin : begin + n] = np.stack([radii * np.cos(angles), radii * np.sin(angles), 0 * radii], axis=1)
        begin += n
    monkeypatch.setattr(module, "_CHUNK", 100)
    corners, polygons = triangulate(points, np.arange(len(points)), counts, "a")
    np.testing.assert_array_equal(polygons, fan(counts)[1])
    begin = 0
    for k, n in enumerate(counts):
        alone, _ = triangulate(points[begin : begin + n], np.arange(n), np.array([n]), "a")
        np.testing.assert_array_equal(corners[polygons == k], alone + begin)
        begin += n


def test_what_is_no_simple_polygon_still_ends():
    rng = np.random.default_rng(2)
    for n in (4, 5, 7, 20):
        assert len(areas(rng.normal(size=(n, 3)))) == n - 2
        assert len(areas(np.zeros((n, 3)))) == n - 2
        assert len(areas(np.full((n, 3), np.nan))) == n - 2
        assert len(areas(rng.integers(0, 2, (n, 3)).astype(float))) == n - 2


def test_a_concave_polygon_of_too_many_corners_is_refused(monkeypatch):
    monkeypatch.setattr(module, "MAX_CORNERS", 10)
    with pytest.raises(MeshError, match="e.obj: a concave polygon has 12 corners; triangulate it"):
        triangulate(E, np.arange(12), np.array([12]), "e.obj")
