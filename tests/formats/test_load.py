"""The one door for models: dispatch, messages, mended attributes, and the real models beside the checkout."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from support.tiny_models import QUAD, QUAD_FACES

from mi_simplify.errors import AssetError, MeshError, UserError
from mi_simplify.formats.load import load_asset
from mi_simplify.formats.polygons import fan, split_corners
from mi_simplify.formats.validate import check_asset
from mi_simplify.model.asset import Asset, Instance, Part


def test_paths_that_are_no_model(tmp_path):
    with pytest.raises(AssetError, match="the reference '.*gone.obj' does not exist"):
        load_asset(tmp_path / "gone.obj", purpose="reference")
    with pytest.raises(AssetError, match="the asset '.*' is no file"):
        load_asset(tmp_path)
    (tmp_path / "a.max").write_bytes(b"x")
    with pytest.raises(AssetError, match="unknown format '.max'; known are OBJ, PLY, STL, GLB, GLTF, USD"):
        load_asset(tmp_path / "a.max")
    (tmp_path / "a.obj").write_bytes(b"")
    with pytest.raises(AssetError, match="a.obj' is empty"):
        load_asset(tmp_path / "a.obj")


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "gltf", "usd", "usda", "usdc", "usdz", "xml"])
def test_noise_of_any_suffix_is_one_clear_line(tmp_path, suffix):
    path = tmp_path / f"noise.{suffix}"
    rng = np.random.default_rng(5)
    for magic in (b"", b"ply\n", b"glTF\2\0\0\0", b"#usda 1.0\n", b"PXR-USDC", b"PK\3\4", b"{}", b"solid"):
        path.write_bytes(magic + rng.integers(0, 256, 400, dtype=np.uint8).tobytes())
        with pytest.raises(UserError) as error:
            load_asset(path)
        assert "noise" in str(error.value) and "\n" not in str(error.value)


def test_attributes_that_cannot_be_used_are_mended_and_noted():
    normals = np.float32([[0, 0, 2], [0, 0, 0], [np.nan, 0, 1], [0, 0, 1]])
    uvs = np.float32([[0, 0], [np.nan, 1], [1, np.inf], [0, 1]])
    part = Part(QUAD, QUAD_FACES, normals=normals, uvs=uvs, colors=np.float32([[2, -1, np.nan, 1]] * 4))
    asset = check_asset(Asset((part,), (Instance(0),)), "a.obj")
    (mended,) = asset.parts
    np.testing.assert_allclose(mended.normals, [[0, 0, 1]] * 4, atol=1e-6)
    np.testing.assert_array_equal(mended.uvs, [[0, 0], [0, 1], [1, 0], [0, 1]])
    np.testing.assert_array_equal(mended.colors, [[1, 0, 1, 1]] * 4)
    assert asset.notes == (
        "2 of 4 normals of part 'part' had no length; recomputed",
        "texture coordinates of part 'part' that are NaN or infinite were set to 0",
    )


def test_degenerate_faces_stay():
    faces = np.concatenate([QUAD_FACES, [[0, 0, 1]], QUAD_FACES[:1]])
    assert check_asset(Asset((Part(QUAD, faces),), (Instance(0),)), "a").n_triangles == 4


def test_coordinates_that_overflow_are_refused():
    part = Part(QUAD * 1e18, QUAD_FACES, name="far")
    with pytest.raises(MeshError, match="a.obj: part 'far' has coordinates up to 1e.18; scale it down"):
        check_asset(Asset((part,), (Instance(0),)), "a.obj")
    tiny = replace(part, vertices=QUAD * 1e-6)
    assert check_asset(Asset((tiny,), (Instance(0),)), "a.obj").n_triangles == 2


def test_fan_and_corners_of_mixed_polygons():
    corners, polygon = fan(np.array([3, 0, 5, 2, 4]))
    np.testing.assert_array_equal(corners, [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 7], [10, 11, 12], [10, 12, 13]])
    np.testing.assert_array_equal(polygon, [0, 2, 2, 2, 4, 4])
    rng = np.random.default_rng(0)
    columns = rng.integers(0, 4, (3, 200))
    first, vertex = split_corners(*columns)
    assert len(first) == len(np.unique(columns, axis=1).T)
    np.testing.assert_array_equal(columns[:, first[vertex]], columns)


@pytest.mark.parametrize(
    ("file", "n_triangles", "height"),
    [
        ("spot/spot.obj", 5856, 1.690),
        ("bishop/bishop.glb", 75056, 0.124),
        ("cesium_milk_truck/CesiumMilkTruck.glb", 3624, 2.583),
        ("cesium_man/CesiumMan.usdz", 4672, 1.507),
        ("lion_statue/lionstatue.obj", 63338, 1.793),
        ("bishop/usd/Bishop.usd", 75056, 0.124),
    ],
)
def test_real_models(shared_assets, file, n_triangles, height):
    asset = load_asset(shared_assets / file)
    assert asset.n_triangles == n_triangles
    assert asset.bounds[1, 1] - asset.bounds[0, 1] == pytest.approx(height, abs=2e-3)
    for part in asset.placed():
        if part.normals is not None:  # winding and normals agree on which side is out
            p = part.vertices[part.faces]
            facing = np.einsum(
                "fi,fi->f", np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), part.normals[part.faces[:, 0]]
            )
            assert (facing >= 0).mean() > 0.99


def test_bishop_is_the_same_from_gltf_and_usd(shared_assets):
    glb = load_asset(shared_assets / "bishop/bishop.glb").parts[0]
    usd = load_asset(shared_assets / "bishop/usd/bishop_white_preview.usda").placed()[0]
    assert len(glb.vertices) == len(usd.vertices)
    a, b = (p.vertices[p.faces].mean(axis=1) for p in (glb, usd))
    distance = cKDTree(a).query(b)[0]  # the same triangles, down to the diagonals but of 50 concave quads
    assert (distance > 1e-6).sum() <= 100 and distance.max() < 2e-4
    np.testing.assert_allclose(usd.uvs.mean(0), glb.uvs.mean(0), atol=1e-4)
    for name in ("base_color", "specular", "normal"):
        np.testing.assert_allclose(getattr(usd.material, name), getattr(glb.material, name), atol=2 / 255)


@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 1, 0.5), (-1, 1, 3), (1, 1, 0), (0, 0, 0)])
def test_placed_normals_stay_upright_on_their_faces(scale):
    """Also where an instance is flattened, which is how some programs hide it."""
    p = np.array([[0, 0, 0], [1, 0, 0.5], [0, 1, 0.25]])
    normal = np.cross(p[1] - p[0], p[2] - p[0])
    part = Part(p, np.array([[0, 1, 2]]), normals=np.tile(normal / np.linalg.norm(normal), (3, 1)).astype(np.float32))
    (placed,) = Asset((part,), (Instance(0, np.diag([*scale, 1.0])),)).placed()
    a, b, c = placed.vertices[placed.faces[0]]
    upright = np.cross(b - a, c - a)
    length = np.linalg.norm(upright)
    np.testing.assert_allclose(placed.normals[0], upright / length if length else 0, atol=1e-6)
