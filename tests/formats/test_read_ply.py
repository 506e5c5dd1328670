"""PLY in text and both byte orders, ragged rows, wedge UVs; STL welded."""

import struct

import numpy as np
import pytest
import trimesh
from support.tiny_models import QUAD, assert_corner_colors, corner_pixels, png

from mi_simplify.errors import AssetError, MeshError
from mi_simplify.formats.load import load_asset
from mi_simplify.model.color import srgb_to_linear

WEDGES = """comment TextureFile image.png
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
property list uchar float texcoord
end_header
"""


def header(kind: str, rest: str) -> bytes:
    return f"ply\nformat {kind} 1.0\n{rest}".encode()


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_agrees_with_another_writer(tmp_path, encoding):
    mesh = trimesh.creation.icosphere(subdivisions=2)
    colors = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 4)).astype(np.uint8)
    mesh.visual.vertex_colors = colors
    (tmp_path / "ball.ply").write_bytes(mesh.export(file_type="ply", encoding=encoding))
    asset = load_asset(tmp_path / "ball.ply")
    (part,) = asset.parts
    np.testing.assert_array_equal(part.faces, mesh.faces)
    np.testing.assert_allclose(part.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_allclose(part.colors[:, :3], srgb_to_linear(colors[:, :3] / 255), atol=1e-6)
    np.testing.assert_allclose(part.colors[:, 3], colors[:, 3] / 255, atol=1e-6)
    np.testing.assert_array_equal(part.material.base_color, [[[1, 1, 1, 1]]])
    assert part.material.alpha_mode == "BLEND"


@pytest.mark.parametrize("order", ["<", ">"])
def test_rows_of_different_length(tmp_path, order):
    rng = np.random.default_rng(3)
    angles = np.arange(60) * 6.0
    vertices = np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles)), angles * 1e-4], axis=1)
    faces = [np.sort(rng.permutation(60)[: rng.integers(3, 7)]) for _ in range(200)]  # convex from above
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    text = (
        "element vertex 60\nproperty double x\nproperty double y\nproperty double z\n"
        "element face 200\nproperty uchar flag\nproperty list ushort uint vertex_index\n"
        "property float weight\nend_header\n"
    )
    data = header(name, text) + vertices.astype(order + "f8").tobytes()
    for f in faces:
        data += struct.pack(f"{order}BH{len(f)}If", 7, len(f), *f, 1.5)
    (tmp_path / "a.ply").write_bytes(data)
    (part,) = load_asset(tmp_path / "a.ply").parts
    expected = np.concatenate([[[f[0], f[k], f[k + 1]] for k in range(1, len(f) - 1)] for f in faces])
    np.testing.assert_array_equal(part.vertices[part.faces], vertices[expected])


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_uvs_per_corner_are_the_right_way_up(tmp_path, kind):
    uvs = QUAD[:, :2].ravel()
    if kind == "ascii":
        body = "".join(f"{x} {y} {z}\n" for x, y, z in QUAD) + "4 0 1 2 3 8 " + " ".join(map(str, uvs))
        body = body.encode()
    else:
        body = QUAD.astype("<f4").tobytes() + struct.pack("<B4iB8f", 4, 0, 1, 2, 3, 8, *uvs)
    (tmp_path / "quad.ply").write_bytes(header(kind, WEDGES) + body)
    (tmp_path / "image.png").write_bytes(png(corner_pixels()))
    (part,) = load_asset(tmp_path / "quad.ply").parts
    assert_corner_colors(part)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_truncated_file(tmp_path, kind):
    order = ">" if "big" in kind else "<"
    body = QUAD.astype(order + "f4").tobytes() + struct.pack(order + "B4iB8f", 4, 0, 1, 2, 3, 8, *([0] * 8))
    body = b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2" if kind == "ascii" else body[:-5]
    (tmp_path / "quad.ply").write_bytes(header(kind, WEDGES) + body)
    with pytest.raises(MeshError, match="quad.ply: the file ends before its last vertex or face"):
        load_asset(tmp_path / "quad.ply")


def test_ply_without_faces_and_without_sense(tmp_path):
    points = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
    (tmp_path / "a.ply").write_bytes(header("ascii", points))
    with pytest.raises(MeshError, match="a.ply: there are no faces in it"):
        load_asset(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(b"plain text")
    with pytest.raises(MeshError, match="this is no PLY file"):
        load_asset(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(header("ascii", points.replace("float x", "quaternion x")))
    with pytest.raises(MeshError, match="header line 'property quaternion x'"):
        load_asset(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(header("ascii", points.replace("vertex 1", "vertex 4000000000")))
    with pytest.raises(MeshError, match="ends before its last vertex"):
        load_asset(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(header("ascii", WEDGES) + b"0 0 0 1 0 0 1 1 0 0 1 0 3 0 1 4 6 0 0 0 0 0 0")
    with pytest.raises(MeshError, match="part 'a' refers to vertex 4, but there are 4"):
        load_asset(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(header("ascii", WEDGES) + b"0 0 0 1 0 0 1 1 0 0 1 0 3 0 1 2 6 0 0 0 0 0 0")
    with pytest.raises(AssetError, match="a.ply: texture 'image.png' does not exist"):
        load_asset(tmp_path / "a.ply")


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_is_welded(tmp_path, kind):
    mesh = trimesh.creation.icosphere(subdivisions=2)
    data = mesh.export(file_type=kind)
    (tmp_path / "ball.stl").write_bytes(data.encode() if isinstance(data, str) else data)
    (part,) = load_asset(tmp_path / "ball.stl").parts
    assert len(part.vertices) == len(mesh.vertices) == 162
    assert np.bincount(part.faces.ravel()).min() >= 5
    np.testing.assert_allclose(part.vertices[part.faces], mesh.triangles, atol=1e-6)


def test_broken_stl(tmp_path):
    path = tmp_path / "ball.stl"
    path.write_bytes(trimesh.creation.icosphere(subdivisions=1).export(file_type="stl")[:-100])
    with pytest.raises(MeshError, match="ball.stl: the header promises 80 facets, the file holds 78"):
        load_asset(path)
    path.write_bytes(b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\n")
    with pytest.raises(MeshError, match="a facet is incomplete"):
        load_asset(path)
    path.write_bytes(b"hello")
    with pytest.raises(MeshError, match="this is no STL file"):
        load_asset(path)


@pytest.mark.parametrize("with_vertex_colors", [False, True])
def test_colours_of_faces(tmp_path, with_vertex_colors):
    """Two triangles of a quad, red and blue: their shared vertices are there twice."""
    rgb = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    text = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    text += (rgb if with_vertex_colors else "") + "element face 2\nproperty list uchar int vertex_indices\n" + rgb
    rows = [f"{x} {y} {z}" + (" 0 255 0" if with_vertex_colors else "") for x, y, z in QUAD]
    rows += ["3 0 1 2 255 0 0", "3 0 2 3 0 0 128"]
    (tmp_path / "a.ply").write_bytes(header("ascii", text + "end_header\n") + "\n".join(rows).encode())
    asset = load_asset(tmp_path / "a.ply")
    (part,) = asset.parts
    assert part.colors is not None
    if with_vertex_colors:
        np.testing.assert_array_equal(part.colors, [[0, 1, 0, 1]] * 4)
        assert asset.notes == ("colours of faces were left out: the vertices have colours, too",)
        return
    assert len(part.vertices) == 6 and asset.notes == ()
    dark = srgb_to_linear(np.array(128 / 255))
    np.testing.assert_allclose(part.colors[part.faces], [[[1, 0, 0, 1]] * 3, [[0, 0, dark, 1]] * 3], atol=1e-6)
    np.testing.assert_array_equal(part.material.base_color, [[[1, 1, 1, 1]]])


@pytest.mark.parametrize("convention", ["VisCAM", "Magics", "header alone", "none"])
def test_colours_of_stl_facets(tmp_path, convention):
    facets = np.zeros(3, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = QUAD[[[0, 1, 2], [0, 2, 3], [0, 1, 3]]]
    red, own = (31 << 10, 1 << 15) if convention == "VisCAM" else (31, 0)
    if convention in ("VisCAM", "Magics"):
        facets["attribute"] = [red | own, (16 << 5) | own, own ^ (1 << 15)]
    head = b"" if convention in ("VisCAM", "none") else b"COLOR=" + bytes([0, 255, 0, 255]) + b",MATERIAL="
    (tmp_path / "a.stl").write_bytes(head.ljust(80, b" ") + struct.pack("<I", 3) + facets.tobytes())
    (part,) = load_asset(tmp_path / "a.stl").parts
    if convention == "none":
        assert part.colors is None and len(part.vertices) == 4
        return
    assert part.colors is not None
    half = srgb_to_linear(np.array(16 / 31))
    rest = [0.5] * 3 if convention == "VisCAM" else [0, 1, 0]
    expected = [rest] * 3 if convention == "header alone" else [[1, 0, 0], [0, half, 0], rest]
    np.testing.assert_allclose(
        part.colors[part.faces][..., :3], np.repeat(np.array(expected)[:, None], 3, 1), atol=1e-6
    )
    np.testing.assert_array_equal(part.material.base_color, [[[1, 1, 1, 1]]])
