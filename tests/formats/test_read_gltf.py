"""glTF: materials, node transforms, instances, accessors of every kind, and what is wrong said plainly."""

import base64
import json
import struct

import numpy as np
import pytest
from support.tiny_models import QUAD, Glb, assert_corner_colors, corner_pixels, face_normals, png

from mi_simplify.errors import AssetError, MeshError
from mi_simplify.formats.load import load_asset


@pytest.fixture
def glb():
    return Glb()


def textured(glb: Glb, **pbr) -> int:
    return glb.material(pbrMetallicRoughness={"baseColorTexture": {"index": glb.texture(corner_pixels())}, **pbr})


def test_texture_is_the_right_way_up(glb, tmp_path):
    glb.mesh(glb.quad(textured(glb)))
    (part,) = load_asset(glb.save(tmp_path / "quad.glb")).parts
    assert_corner_colors(part)
    np.testing.assert_allclose(face_normals(part), [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(part.material.specular, [[[0, 1, 1]]])  # glTF's defaults, once there is a material


@pytest.mark.parametrize("embedded", [True, False])
def test_separate_files_and_data_uris(glb, tmp_path, embedded):
    glb.mesh(glb.quad(textured(glb)))
    files = {"the buffer.bin": glb.binary, "the%20image.png": png(corner_pixels())}
    glb.json["buffers"] = [{"byteLength": len(glb.binary), "uri": "the%20buffer.bin"}]
    glb.json["images"] = [{"uri": "the%20image.png"}]  # a file of that very name wins over the decoded one
    if embedded:
        data = [base64.b64encode(b).decode() for b in files.values()]
        glb.json["buffers"][0]["uri"] = "data:application/octet-stream;base64," + data[0]
        glb.json["images"][0]["uri"] = "data:image/png;base64," + data[1]
    else:
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
    (tmp_path / "quad.gltf").write_text(json.dumps(glb.json))
    assert_corner_colors(load_asset(tmp_path / "quad.gltf").parts[0])


def test_factors_and_textures_multiply(glb, tmp_path):
    color, orm = np.uint8([[[255, 128, 0, 64]]]), np.uint8([[[0, 128, 64]]])
    normal = np.uint8([[[255, 128, 255]]])
    glb.material(
        name="m",
        pbrMetallicRoughness={
            "baseColorTexture": {"index": glb.texture(color)}, "baseColorFactor": [0.5, 0.5, 0.5, 0.5],
            "metallicRoughnessTexture": {"index": glb.texture(orm)}, "roughnessFactor": 0.5, "metallicFactor": 0.25,
        },
        normalTexture={"index": glb.texture(normal), "scale": 0.5},
        occlusionTexture={"index": 1},
    )  # fmt: skip
    glb.mesh(glb.quad(0))
    material = load_asset(glb.save(tmp_path / "a.glb")).parts[0].material
    np.testing.assert_allclose(material.base_color, [[[0.5, 0.2158605 / 2, 0, 64 / 255 / 2]]], atol=1e-6)
    np.testing.assert_allclose(material.specular, [[[0, 128 / 255 / 2, 64 / 255 / 4]]], atol=1e-6)
    np.testing.assert_allclose(material.normal, [[np.array([0.5, 0.00196, 1]) / np.hypot(0.5, 1)]], atol=1e-4)
    assert material.name == "m"


def test_gamma_comes_back_from_specular_colour(glb, tmp_path):
    texture = glb.texture(np.uint8([[[188, 188, 188], [255, 255, 255]]]))  # sRGB 188 is 0.503 linear
    factor = {"KHR_materials_specular": {"specularColorFactor": [0.2, 0.3, 0.4]}}
    plastic, metal = {"metallicFactor": 0}, {"metallicFactor": 1, "baseColorFactor": [0.9, 0.5, 0.1, 1]}
    image = {"KHR_materials_specular": {"specularColorTexture": {"index": texture}}}
    glb.material(pbrMetallicRoughness=plastic, extensions=image)
    glb.material(pbrMetallicRoughness=plastic, extensions=factor)
    glb.material(pbrMetallicRoughness=metal, extensions=factor)
    glb.mesh(glb.quad(0), glb.quad(1), glb.quad(2))
    first, second, third = (p.material for p in load_asset(glb.save(tmp_path / "a.glb")).parts)
    np.testing.assert_allclose(first.specular[..., 0], [[1 - 0.50289, 0]], atol=1e-4)
    np.testing.assert_allclose(second.specular[..., 0], [[0.7]], atol=1e-6)
    np.testing.assert_allclose(third.specular, [[[0, 1, 1]]], atol=1e-6)  # a metal's lobe has its base colour
    np.testing.assert_allclose(third.base_color, [[[0.9, 0.5, 0.1, 1]]], atol=1e-6)


def test_gamma_between_dielectric_and_metal_is_that_of_the_gltf_formula(glb, tmp_path):
    """Diffuse reflectance and both F0 of ggx_gamma, for the material read, are those that glTF gives the file's."""
    kd, m, s = np.array([0.6, 0.3, 0.1]), 0.4, 0.5
    pbr = {"baseColorFactor": [*kd, 1], "metallicFactor": m}
    glb.material(pbrMetallicRoughness=pbr, extensions={"KHR_materials_specular": {"specularColorFactor": [s] * 3}})
    glb.mesh(glb.quad(0))
    (part,) = load_asset(glb.save(tmp_path / "a.glb")).parts
    color, (gamma, _, metallic) = part.material.base_color[0, 0, :3], part.material.specular[0, 0]
    np.testing.assert_allclose(color * (1 - metallic), kd * (1 - m), rtol=1e-5)
    np.testing.assert_allclose((1 - gamma) * color * metallic, kd * m, rtol=1e-5)
    np.testing.assert_allclose((1 - gamma) * (1 - metallic), s * (1 - m), rtol=1e-5)


def test_alpha_modes(glb, tmp_path):
    for extra in ({}, {"alphaMode": "MASK"}, {"alphaMode": "MASK", "alphaCutoff": 0.75}, {"alphaMode": "BLEND"}):
        glb.material(**extra)
    glb.mesh(*[glb.quad(i) for i in range(4)])
    materials = [p.material for p in load_asset(glb.save(tmp_path / "a.glb")).parts]
    assert [m.alpha_mode for m in materials] == ["OPAQUE", "MASK", "MASK", "BLEND"]
    assert [m.alpha_cutoff for m in materials] == [0.5, 0.5, 0.75, 0.5]


def test_no_material_is_the_grey_of_the_house(glb, tmp_path):
    colors = np.uint8([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [51, 51, 51, 255]])
    glb.mesh(glb.quad(), glb.quad(COLOR_0=glb.accessor(colors, normalized=True)))
    plain, colored = load_asset(glb.save(tmp_path / "a.glb")).parts
    np.testing.assert_array_equal(plain.material.base_color, [[[0.5, 0.5, 0.5, 1]]])
    np.testing.assert_array_equal(plain.material.specular, [[[0, 0.5, 0]]])
    assert plain.colors is None
    np.testing.assert_array_equal(colored.material.base_color, [[[1, 1, 1, 1]]])
    np.testing.assert_allclose(colored.colors, colors / 255, atol=1e-6)  # linear, as glTF has them


def test_nodes_place_instances_of_one_part(glb, tmp_path):
    glb.mesh(glb.quad(NORMAL=np.tile(np.float32([0, 0, 1]), (4, 1))))
    half = float(np.sqrt(0.5))
    matrix = np.diag([-1.0, 1, 1, 1])
    matrix[:3, 3] = 5, 0, 0
    glb.nodes(
        {"name": "root", "translation": [0, 10, 0], "children": [1, 2]},
        {"name": "turned", "mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 1, 1], "translation": [1, 2, 3]},
        {"name": "mirrored", "mesh": 0, "matrix": matrix.T.ravel().tolist()},
    )
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    assert len(asset.parts) == 1 and [i.name for i in asset.instances] == ["turned", "mirrored"]
    assert asset.n_triangles == 4
    turned, mirrored = asset.placed()
    # (1, 0, 0) is scaled to (2, 0, 0), turned by 90° about z, and moved.
    np.testing.assert_allclose(turned.vertices[1], [1, 2 + 2 + 10, 3], atol=1e-6)
    np.testing.assert_allclose(mirrored.vertices[1], [4, 10, 0], atol=1e-6)
    for part in (turned, mirrored):
        np.testing.assert_allclose(face_normals(part), [[0, 0, 1]] * 2, atol=1e-6)
        np.testing.assert_allclose(part.normals, [[0, 0, 1]] * 4, atol=1e-6)


def test_gpu_instances(glb, tmp_path):
    glb.mesh(glb.quad())
    attributes = {
        "TRANSLATION": glb.accessor(np.float32([[0, 0, 0], [5, 0, 0], [0, 0, 7]])),
        "SCALE": glb.accessor(np.float32([[1, 1, 1], [2, 2, 2], [3, 3, 3]])),
    }
    extension = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    glb.nodes({"mesh": 0, "translation": [0, 1, 0], "extensions": extension})
    glb.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    assert len(asset.parts) == 1
    corners = [p.vertices[2] for p in asset.placed()]
    np.testing.assert_allclose(corners, [[1, 2, 0], [7, 3, 0], [3, 4, 7]], atol=1e-6)


def test_accessors_sparse_strided_and_quantised(glb, tmp_path):
    wrong = QUAD.astype("f4")
    wrong[2] = 9
    position = glb.accessor(wrong)
    glb.json["accessors"][position]["sparse"] = {
        "count": 1, "indices": {"bufferView": glb.view(np.uint8([2]).tobytes()), "componentType": 5121},
        "values": {"bufferView": glb.view(QUAD[2].astype("f4").tobytes())},
    }  # fmt: skip
    uvs = np.uint16(np.round(np.stack([QUAD[:, 0], 1 - QUAD[:, 1]], 1) * 65535))
    interleaved = np.concatenate([uvs, np.full((4, 2), 7, np.uint16)], axis=1)
    view = glb.view(interleaved.tobytes())
    glb.json["bufferViews"][view]["byteStride"] = 8
    accessor = {"bufferView": view, "count": 4, "type": "VEC2", "componentType": 5123, "normalized": True}
    glb.json["accessors"].append(accessor)
    normals = glb.accessor(np.int8([[0, 0, 127, 0]] * 4)[:, :3].copy(), normalized=True)
    primitive = glb.quad(textured(glb), POSITION=position, TEXCOORD_0=len(glb.json["accessors"]) - 2, NORMAL=normals)
    glb.mesh(primitive)
    (part,) = load_asset(glb.save(tmp_path / "a.glb")).parts
    np.testing.assert_array_equal(part.vertices, QUAD)
    np.testing.assert_allclose(part.normals, [[0, 0, 1]] * 4)
    assert_corner_colors(part)


def test_texture_transform_of_the_specification(glb, tmp_path):
    # "This example utilizes only the lower left quadrant of the source image, rotated clockwise 90 degrees."
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    info = {"index": glb.texture(corner_pixels()), "extensions": {"KHR_texture_transform": transform}}
    glb.material(pbrMetallicRoughness={"baseColorTexture": info})
    glb.json["extensionsRequired"] = ["KHR_texture_transform"]
    glb.mesh(glb.quad(0))
    (part,) = load_asset(glb.save(tmp_path / "a.glb")).parts
    np.testing.assert_allclose([part.uvs.min(0), part.uvs.max(0)], [[0, 0.5], [0.5, 1]], atol=1e-6)
    np.testing.assert_allclose(part.uvs[3], [0, 1], atol=1e-6)  # the top left of the quad shows the image's bottom left


def test_textures_without_their_coordinates_are_noted(glb, tmp_path):
    texture = glb.texture(corner_pixels())
    glb.material(
        name="m", pbrMetallicRoughness={"baseColorTexture": {"index": texture}},
        normalTexture={"index": texture, "texCoord": 1},
    )  # fmt: skip
    glb.mesh(glb.quad(0))
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    assert asset.notes == ("'quad' has textures but no TEXCOORD_1; they show one texel",)


@pytest.mark.parametrize(("mode", "order"), [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])])
def test_strips_and_fans(glb, tmp_path, mode, order):
    primitive = glb.quad()
    primitive["indices"] = glb.accessor(np.uint8(order))
    primitive["mode"] = mode
    glb.mesh(primitive)
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    assert asset.n_triangles == 2
    np.testing.assert_allclose(face_normals(asset.parts[0]), [[0, 0, 1]] * 2)


def test_skin_stands_in_its_rest_pose(glb, tmp_path):
    joints = np.uint8([[0, 1, 0, 0]] * 4)
    weights = np.float32([[1, 0, 0, 0], [1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1, 0, 0]])
    glb.mesh(glb.quad(JOINTS_0=joints, WEIGHTS_0=weights))
    inverse = np.tile(np.eye(4, dtype="f4"), (2, 1, 1))
    inverse[1, :3, 3] = 0, -1, 0  # the second joint is bound at (0, 1, 0) …
    glb.json["skins"] = [
        {"joints": [1, 2], "inverseBindMatrices": glb.accessor(inverse.transpose(0, 2, 1).reshape(2, 16))}
    ]
    glb.nodes(
        {"name": "man", "mesh": 0, "skin": 0, "translation": [100, 0, 0]},  # … and the mesh's own place does not count
        {"name": "hip", "translation": [0, 5, 0], "children": [2]},
        {"name": "head", "translation": [0, 3, 0]},  # … where it now stands at (0, 8, 0), 7 higher
    )
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    np.testing.assert_allclose(
        asset.posed().placed()[0].vertices - QUAD, [[0, 5, 0], [0, 5, 0], [0, 6, 0], [0, 7, 0]], atol=1e-6
    )
    np.testing.assert_allclose(asset.placed()[0].vertices - QUAD, [[0, 5, 0]] * 4, atol=1e-6)  # as the hip carries it
    assert asset.notes == ("the skeleton has no animation; its one frame is the pose at rest",)


def test_lines_are_noted(glb, tmp_path):
    primitive = glb.quad(glb.material())
    primitive["targets"] = [{"POSITION": primitive["attributes"]["POSITION"]}]
    glb.mesh(primitive, {**glb.quad(), "mode": 1})
    notes = " | ".join(load_asset(glb.save(tmp_path / "a.glb")).notes)
    assert "a primitive of 'quad_1' was left out: lines" in notes


def test_unused_vertices_do_not_count(glb, tmp_path):
    positions = np.concatenate([QUAD, [[np.nan, 0, 0]]]).astype("f4")
    primitive = glb.quad(POSITION=positions, TEXCOORD_0=np.zeros((5, 2), "f4"))
    glb.mesh(primitive)
    assert len(load_asset(glb.save(tmp_path / "a.glb")).parts[0].vertices) == 4


@pytest.mark.parametrize("length", [4, 15, 100, -1])
def test_truncated_glb(glb, tmp_path, length):
    glb.mesh(glb.quad(textured(glb)))
    (tmp_path / "cut.glb").write_bytes(glb.bytes()[:length])
    with pytest.raises(AssetError, match="cut.glb: .* truncated"):
        load_asset(tmp_path / "cut.glb")


def broken_json(glb):
    data = glb.bytes()
    return data[:20] + b"!" + data[21:]


def no_meshes(glb):
    glb.json["nodes"] = [{"name": "empty"}]
    return glb.bytes()


def edited(**changes):
    def edit(glb):
        glb.json.update(changes)
        return glb.bytes()

    return edit


def small_index(glb):
    glb.json["meshes"][0]["primitives"][0]["indices"] = glb.accessor(np.uint8([0, 1, 7]))
    return glb.bytes()


def long_accessor(glb):
    glb.json["accessors"][0]["count"] = 4000
    return glb.bytes()


def nan_vertex(glb):
    position = glb.json["bufferViews"][0]["byteOffset"]
    glb.binary = glb.binary[:position] + struct.pack("<f", np.nan) + glb.binary[position + 4 :]
    return glb.bytes()


def missing_image(glb):
    glb.json["images"] = [{"uri": "gone.png"}]
    glb.json["textures"] = [{"source": 0}]
    glb.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    glb.json["meshes"][0]["primitives"][0]["material"] = 0
    return glb.bytes()


@pytest.mark.parametrize(
    ("make", "kind", "message"),
    [
        (broken_json, AssetError, "a.glb: its JSON cannot be read"),
        (no_meshes, MeshError, "a.glb: there are no faces in it"),
        (edited(asset={"version": "1.0"}), AssetError, "glTF version '1.0' is not 2.0"),
        (edited(extensionsRequired=["EXT_future"]), AssetError, "extension EXT_future"),
        (edited(nodes=[{"mesh": 0, "children": [0]}]), AssetError, "nodes.0. has two parents or lies on a loop"),
        (edited(nodes=[{"mesh": 5}]), AssetError, "refers to meshes.5., which does not exist"),
        (edited(nodes=[{"mesh": 0, "scale": [np.nan, 1, 1]}]), MeshError, "the transform of 'node_0' is not finite"),
        (edited(nodes=[{"mesh": 0, "scale": [0, 0, 0]}]), MeshError, "part 'quad' have no area"),
        (edited(nodes="many"), AssetError, "a.glb"),
        (edited(accessors=[]), AssetError, "refers to accessors.0., which does not exist"),
        (small_index, MeshError, "a.glb: part 'quad' refers to vertex 7, but there are 4"),
        (long_accessor, AssetError, "reads 4000 elements beyond its buffer view"),
        (nan_vertex, MeshError, "1 of 4 vertices of part 'quad' are NaN"),
        (missing_image, AssetError, "a.glb: texture 'gone.png' does not exist"),
    ],
)
def test_broken_files(glb, tmp_path, make, kind, message):
    glb.mesh(glb.quad())
    (tmp_path / "a.glb").write_bytes(make(glb))
    with pytest.raises(kind, match=message) as error:
        load_asset(tmp_path / "a.glb")
    assert "\n" not in str(error.value)


def test_missing_buffer_is_named(glb, tmp_path):
    glb.mesh(glb.quad())
    glb.json["buffers"] = [{"byteLength": len(glb.binary), "uri": "gone.bin"}]
    (tmp_path / "a.gltf").write_text(json.dumps(glb.json))
    with pytest.raises(AssetError, match="a.gltf: buffer 'gone.bin' does not exist"):
        load_asset(tmp_path / "a.gltf")


def test_an_instance_knows_the_nodes_above_it(tmp_path):
    """Siblings of one name are told apart; what hangs in the root has nothing above it."""
    glb = Glb()
    glb.mesh(glb.quad())
    glb.nodes(
        {"name": "plant", "children": [1, 2]}, {"name": "twig", "children": [3]}, {"name": "twig", "children": [4]},
        {"name": "leaf", "mesh": 0}, {"name": "leaf", "mesh": 0}, {"mesh": 0},
    )  # fmt: skip
    glb.json["scenes"] = [{"nodes": [0, 5]}]
    asset = load_asset(glb.save(tmp_path / "plant.glb"))
    assert {(i.name, i.node) for i in asset.instances} == {
        ("leaf", "plant.0/twig.1"), ("leaf", "plant.0/twig.2"), ("node_5", ""),
    }  # fmt: skip


def test_default_weights_of_morph_targets_are_applied(glb, tmp_path):
    primitive = glb.quad(NORMAL=np.tile(np.float32([0, 0, 1]), (4, 1)))
    up, right = np.zeros((4, 3), "f4"), np.zeros((4, 3), "f4")
    up[2:, 2], right[:, 0] = 2, 1
    primitive["targets"] = [
        {"POSITION": glb.accessor(up), "NORMAL": glb.accessor(np.tile(np.float32([0, -1, 0]), (4, 1)))},
        {"POSITION": glb.accessor(right)},
    ]
    glb.mesh(primitive)
    glb.json["meshes"][0]["weights"] = [0.5, 0]
    glb.nodes({"mesh": 0}, {"mesh": 0, "weights": [0, 3]}, {"mesh": 0})
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    assert len(asset.parts) == 2 and [i.part for i in asset.instances] == [0, 1, 0]  # shared where the weights agree
    np.testing.assert_allclose(asset.parts[0].vertices - QUAD, up / 2)
    np.testing.assert_allclose(asset.parts[1].vertices - QUAD, 3 * right)
    np.testing.assert_allclose(asset.parts[0].normals, np.tile(np.array([0, -1, 2]) / 5**0.5, (4, 1)), atol=1e-6)
    np.testing.assert_allclose(asset.parts[1].normals, [[0, 0, 1]] * 4)


def test_everything_left_out_is_one_line(glb, tmp_path):
    glb.mesh(glb.quad(glb.material(name="m", occlusionTexture={"index": glb.texture(corner_pixels())})))
    glb.json["scenes"].append({"nodes": []})
    glb.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    glb.json["asset"]["copyright"] = "2026 A. Author"
    glb.json["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "red"}]}, "KHR_lights_punctual": {
        "lights": [{"type": "point"}]}}  # fmt: skip
    assert set(load_asset(glb.save(tmp_path / "a.glb")).notes) == {
        "1 further scenes were left out", "1 cameras were left out",
        "material variants were left out; the default materials are used", "lights were left out",
    }  # fmt: skip
