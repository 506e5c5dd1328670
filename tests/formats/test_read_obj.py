"""OBJ with MTL: textures the right way up, indices of every form, materials, and what is wrong said plainly."""

import numpy as np
import pytest
from support.tiny_models import assert_corner_colors, corner_pixels, face_normals, png

from mi_simplify.errors import AssetError, MeshError
from mi_simplify.formats.load import load_asset
from mi_simplify.model.color import srgb_to_linear

QUAD = """mtllib quad.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl paint
f 1/1 2/2 3/3 4/4
"""


def write(folder, obj: str, mtl: str | None = None, **images: np.ndarray):
    (folder / "quad.obj").write_text(obj)
    if mtl is not None:
        (folder / "quad.mtl").write_text(mtl)
    for name, pixels in images.items():
        (folder / f"{name}.png").write_bytes(png(pixels))
    return folder / "quad.obj"


def test_texture_is_the_right_way_up(tmp_path):
    path = write(tmp_path, QUAD, "newmtl paint\nKs 0 .25 0\nKd .1 .2 .3\nmap_Kd image.png\n", image=corner_pixels())
    asset = load_asset(path)
    (part,) = asset.parts
    assert_corner_colors(part)
    assert asset.n_triangles == 2 and part.normals is None
    np.testing.assert_allclose(face_normals(part), [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(part.material.specular, [[[0, 0.5, 0]]])
    assert asset.source == str(path) and asset.name == "quad"
    assert asset.notes == ("specular colour (Ks) of material 'paint' was left out: gloss is read from Pr and Pm",)


def test_all_forms_of_corners_give_the_same_mesh(tmp_path):
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)])
    forms = [
        "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n",
        "f -5 -4 -1\nf -4 -3 -1\nf -3 -2 -1\nf -2 -5 -1\n",
        "f 1// 2// 5//   # a comment\n  f 2 3 \\\n 5\nf\t3 4 5\nf 4 1 5",
    ]
    expected = None
    for text in forms:
        for ending in ("\n", "\r\n"):
            path = tmp_path / "pyramid.obj"
            path.write_bytes(b"\xef\xbb\xbf# made by a test\n" + (vertices + text).replace("\n", ending).encode())
            (part,) = load_asset(path).parts
            corners = part.vertices[part.faces]
            expected = corners if expected is None else expected
            np.testing.assert_array_equal(corners, expected)
            assert len(part.vertices) == 5


def test_vertices_split_at_seams_only(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .5 .5\nvn 0 0 2\n"
    same = text + "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"
    seam = text + "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/5/1 4/4/1\n"
    (part,) = load_asset(write(tmp_path, same)).parts
    assert len(part.vertices) == 4
    np.testing.assert_allclose(part.normals, [[0, 0, 1]] * 4)  # of unit length, whatever the file has
    (part,) = load_asset(write(tmp_path, seam)).parts
    assert len(part.vertices) == 5
    np.testing.assert_allclose(sorted(part.uvs[:, 1]), [0, 0, 0.5, 1, 1], atol=1e-7)


def test_polygon_becomes_a_fan(tmp_path):
    angles = np.arange(6) * np.pi / 3
    text = "".join(f"v {np.cos(a)} {np.sin(a)} 0\n" for a in angles) + "f 1 2 3 4 5 6\nf 1 2\n"
    asset = load_asset(write(tmp_path, text))
    assert asset.n_triangles == 4
    np.testing.assert_allclose(face_normals(asset.parts[0]), [[0, 0, 1]] * 4, atol=1e-9)
    assert asset.notes == ("1 faces with fewer than three corners were left out",)


def test_materials_become_parts_that_shade_as_one_surface(tmp_path):
    text = (
        "mtllib quad.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 1 0 -1\nv 1 1 -1\n"
        "usemtl a\nf 1 2 3 4\nusemtl b\nf 2 5 6 3\nusemtl a\nf 1 4 3\n"
    )
    asset = load_asset(write(tmp_path, text, "newmtl a\nKd .5 .5 .5\nnewmtl b\nPr .25\nPm 1\nd .5\n"))
    a, b = asset.parts
    assert (len(a.faces), len(b.faces)) == (3, 2)
    np.testing.assert_allclose(a.material.base_color[0, 0], [*srgb_to_linear([0.5] * 3), 1], atol=1e-6)
    np.testing.assert_allclose(b.material.base_color[0, 0], [0.5] * 4)
    np.testing.assert_allclose(b.material.specular[0, 0], [0, 0.25, 1])
    assert (a.material.alpha_mode, b.material.alpha_mode) == ("OPAQUE", "BLEND")
    normal_a = a.normals[np.flatnonzero((a.vertices == [1, 0, 0]).all(1))[0]]
    normal_b = b.normals[np.flatnonzero((b.vertices == [1, 0, 0]).all(1))[0]]
    np.testing.assert_allclose(normal_a, normal_b)
    assert normal_a[0] > 0.1 and normal_a[2] > 0.1


def test_objects_become_parts(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\no left\nf 1 2 3\no right\nv 0 0 1\nv 1 0 1\nv 1 1 1\nf 4 5 6\n"
    assert [p.name for p in load_asset(write(tmp_path, text)).parts] == ["left", "right"]


def test_physically_based_maps(tmp_path):
    mtl = "newmtl paint\nmap_Pr rough.png\nmap_Pm metal.png\nmap_d mask.png\nnorm -bm 1.0 normal map.png\n"
    normal = np.uint8([[[255, 128, 128]]])
    path = write(
        tmp_path, QUAD, mtl, rough=np.uint8([[51, 102]]), metal=np.uint8([[255]]), mask=np.uint8([[0], [255]]),
        **{"normal map": normal},
    )  # fmt: skip
    material = load_asset(path).parts[0].material
    np.testing.assert_allclose(material.specular, [[[0, 0.2, 1], [0, 0.4, 1]]], atol=1e-6)
    np.testing.assert_allclose(material.base_color[:, 0], [[0.5, 0.5, 0.5, 0], [0.5, 0.5, 0.5, 1]])
    np.testing.assert_allclose(material.normal, [[[1, 0, 0]]], atol=0.01)
    assert material.alpha_mode == "MASK"  # nothing between 0 and 1
    path = write(tmp_path, QUAD, "newmtl paint\nmap_d mask.png\n", mask=np.uint8([[0], [100]]))
    assert load_asset(path).parts[0].material.alpha_mode == "BLEND"


def test_bump_maps_count_where_they_hold_normals(tmp_path):
    flat = np.full((4, 4, 3), (128, 128, 255), np.uint8)
    heights = np.repeat(np.random.default_rng(0).integers(0, 255, (4, 4, 1), dtype=np.uint8), 3, axis=2)
    asset = load_asset(write(tmp_path, QUAD, "newmtl paint\nmap_Bump -bm 1 bump.png\n", bump=flat))
    np.testing.assert_allclose(asset.parts[0].material.normal[..., 2], 1, atol=1e-3)
    assert "holds a normal map" in asset.notes[0]
    asset = load_asset(write(tmp_path, QUAD, "newmtl paint\nmap_Bump bump.png\n", bump=heights))
    assert asset.parts[0].material.normal is None
    assert "heights, not normals" in asset.notes[0]


def test_paths_of_another_machine(tmp_path):
    path = write(tmp_path, QUAD, "newmtl paint\nmap_Kd C:\\work\\image.png\n", image=corner_pixels())
    asset = load_asset(path)
    assert_corner_colors(asset.parts[0])
    assert "'C:\\work\\image.png' was taken from 'image.png' beside the model" in asset.notes[0]


def test_vertex_colours_are_srgb(tmp_path):
    text = "v 0 0 0 1 0 .5\nv 1 0 0 1 0 .5\nv 1 1 0 1 0 .5\nf 1 2 3\n"
    (part,) = load_asset(write(tmp_path, text)).parts
    np.testing.assert_allclose(part.colors, [[1, 0, 0.2140411, 1]] * 3, atol=1e-6)
    np.testing.assert_array_equal(part.material.base_color, [[[1, 1, 1, 1]]])


def test_missing_materials_are_grey_with_a_note(tmp_path):
    asset = load_asset(write(tmp_path, QUAD))
    np.testing.assert_array_equal(asset.parts[0].material.base_color[0, 0], [0.5, 0.5, 0.5, 1])
    assert any("'quad.mtl' does not exist" in n for n in asset.notes)
    assert any("material 'paint' is not defined" in n for n in asset.notes)


def test_missing_texture_is_named(tmp_path):
    path = write(tmp_path, QUAD, "newmtl paint\nmap_Kd gone.png\n")
    with pytest.raises(AssetError, match="quad.obj: texture 'gone.png' does not exist"):
        load_asset(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 9\n", "part 'quad' refers to vertex 9, but there are 3"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 0 1 2\n", "refers to vertex 0, but there are 3"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf -1 -2 -4\n", "a face counts back beyond the first 'v'"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nf 1/1 2/2 3/1\n", "refers to texture coordinate 2, but there are 1"),
        ("v 0 0 0\nv 1 nan 0\nv 1 1 0\nf 1 2 3\n", "1 of 3 vertices of part 'quad' are NaN or infinite"),
        ("v 0 0 0\nv 1 1e999 0\nv 1 1 0\nf 1 2 3\n", "NaN or infinite"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "part 'quad' have no area"),
        ("v 0 0 0\nv 1 0 x\nv 2 0 0\nf 1 2 3\n", "a 'v' line holds something that is no number"),
        ("v 0 0 0\nv 1 0\nv 2 0 0\nf 1 2 3\n", "a 'v' line has fewer numbers than it needs"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 three\n", "a 'f' line holds something that is no number"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1/2/3/4 2 3\n", "more than three indices"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\n", "there are no faces in it"),
        ("\x00\x01\x02 no model at all", "there are no faces in it"),
    ],
)
def test_broken_meshes(tmp_path, text, message):
    with pytest.raises(MeshError, match=message) as error:
        load_asset(write(tmp_path, text))
    assert "quad.obj" in str(error.value) and "\n" not in str(error.value)


def test_textures_are_looked_for_beside_their_library_then_beside_the_model(tmp_path):
    (tmp_path / "materials").mkdir()
    obj = QUAD.replace("quad.mtl", "materials/quad.mtl")
    (tmp_path / "quad.obj").write_text(obj)
    (tmp_path / "materials" / "quad.mtl").write_text("newmtl paint\nmap_Kd image.png\nmap_Pr beside.png\n")
    (tmp_path / "materials" / "image.png").write_bytes(png(corner_pixels()))
    (tmp_path / "image.png").write_bytes(png(np.zeros((8, 8, 3), np.uint8)))  # the library's own comes first
    (tmp_path / "beside.png").write_bytes(png(np.full((2, 2), 51, np.uint8)))
    asset = load_asset(tmp_path / "quad.obj")
    assert_corner_colors(asset.parts[0])
    np.testing.assert_allclose(asset.parts[0].material.specular[..., 1], 0.2, atol=1e-6)
    assert asset.notes == ()


def test_names_that_differ_in_case_are_found_and_noted(tmp_path):
    (tmp_path / "Textures").mkdir()
    (tmp_path / "Textures" / "Image.PNG").write_bytes(png(corner_pixels()))
    (tmp_path / "Quad.MTL").write_text("newmtl paint\nmap_Kd textures\\image.png\n")
    (tmp_path / "quad.obj").write_text(QUAD)
    asset = load_asset(tmp_path / "quad.obj")
    assert_corner_colors(asset.parts[0])
    assert asset.notes == (
        "material library 'quad.mtl' was taken from 'Quad.MTL', spelt differently",
        "texture 'textures\\image.png' was taken from 'Textures/Image.PNG', spelt differently",
    )


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_text_in_other_encodings(tmp_path, encoding):
    (tmp_path / "quad.obj").write_bytes(QUAD.encode(encoding))
    (tmp_path / "quad.mtl").write_bytes("newmtl paint\nKd 1 0 0\n".encode(encoding))
    (part,) = load_asset(tmp_path / "quad.obj").parts
    np.testing.assert_allclose(part.vertices[:, :2].max(0), [1, 1])
    np.testing.assert_allclose(part.material.base_color[0, 0], [1, 0, 0, 1])
