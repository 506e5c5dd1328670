"""GLB files compressed with Draco: what was encoded comes back, and what is broken is said so."""

import sys

import DracoPy
import numpy as np
import pytest
from support.tiny_meshes import charted_sphere
from support.tiny_models import Glb

from mi_simplify.errors import AssetError
from mi_simplify.formats.load import load_asset

SPHERE = charted_sphere(8)


def compressed(colors: np.ndarray | None = None) -> Glb:
    """A sphere whose accessors have no data of their own."""
    glb, n = Glb(), len(SPHERE.vertices)
    vertices = SPHERE.vertices.astype(np.float32)
    normals, uvs = SPHERE.vertices, SPHERE.uvs.astype(np.float64)
    data = DracoPy.encode(
        vertices, SPHERE.faces.astype(np.uint32), 16, preserve_order=True, normals=normals, tex_coord=uvs, colors=colors
    )
    numbers = {a["attribute_type"]: a["unique_id"] for a in DracoPy.decode(data).attributes}
    kinds = {"POSITION": (0, "VEC3"), "NORMAL": (1, "VEC3"), "COLOR_0": (2, "VEC4"), "TEXCOORD_0": (3, "VEC2")}
    attributes, packed = {}, {}
    for key, (kind, shape) in kinds.items():
        if kind not in numbers:
            continue
        number = {"componentType": 5126, "count": n, "type": shape}
        if key == "COLOR_0":
            number |= {"componentType": 5121, "normalized": True}
        attributes[key], packed[key] = len(glb.json["accessors"]), numbers[kind]
        glb.json["accessors"].append(number)
    glb.json["accessors"].append({"componentType": 5125, "count": SPHERE.faces.size, "type": "SCALAR"})
    extension = {"bufferView": glb.view(data), "attributes": packed}
    glb.mesh(
        {
            "attributes": attributes, "indices": len(attributes),
            "extensions": {"KHR_draco_mesh_compression": extension},
        },
        name="sphere",
    )  # fmt: skip
    glb.json["extensionsUsed"] = glb.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return glb


def test_what_was_encoded_comes_back(tmp_path):
    colors = np.random.default_rng(0).integers(0, 256, (len(SPHERE.vertices), 4)).astype(np.uint8)
    (part,) = load_asset(compressed(colors).save(tmp_path / "a.glb")).parts
    assert np.array_equal(part.faces, SPHERE.faces)
    assert np.abs(part.vertices - SPHERE.vertices).max() < 4 / 2**16
    assert part.normals is not None and part.uvs is not None and part.colors is not None
    assert np.sum(part.normals * SPHERE.vertices, axis=1).min() > 0.99
    assert np.allclose(part.uvs, SPHERE.uvs, atol=1e-6)
    assert np.allclose(part.colors, colors / 255, atol=1e-6)


def test_broken_data_and_wrong_counts(tmp_path):
    glb = compressed()
    glb.binary = glb.binary.replace(b"DRACO", b"DRAGO")
    with pytest.raises(AssetError, match="a.glb: a mesh compressed with Draco is broken"):
        load_asset(glb.save(tmp_path / "a.glb"))
    glb = compressed()
    glb.json["accessors"][0]["count"] += 1
    with pytest.raises(AssetError, match=r"elements, but accessors\[0\] declares"):
        load_asset(glb.save(tmp_path / "b.glb"))
    glb = compressed()
    glb.json["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["attributes"]["POSITION"] = 77
    with pytest.raises(AssetError, match="compressed with Draco is broken"):
        load_asset(glb.save(tmp_path / "c.glb"))


def test_without_the_package_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(AssetError, match=r"pip install 'mi-simplify\[draco\]'"):
        load_asset(compressed().save(tmp_path / "a.glb"))


def test_a_file_that_only_uses_draco_is_read_where_it_has_no_plain_copy(tmp_path, monkeypatch):
    glb = compressed()
    del glb.json["extensionsRequired"]
    (part,) = load_asset(glb.save(tmp_path / "a.glb")).parts
    assert np.abs(part.vertices - SPHERE.vertices).max() < 4 / 2**16
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    for key, index in glb.json["meshes"][0]["primitives"][0]["attributes"].items():
        values = {"POSITION": SPHERE.vertices, "NORMAL": SPHERE.vertices, "TEXCOORD_0": SPHERE.uvs}[key]
        glb.json["accessors"][index]["bufferView"] = glb.view(values.astype("f4").tobytes())
    indices = glb.json["accessors"][glb.json["meshes"][0]["primitives"][0]["indices"]]
    indices["bufferView"] = glb.view(SPHERE.faces.astype("u4").tobytes())
    (part,) = load_asset(glb.save(tmp_path / "b.glb")).parts
    np.testing.assert_allclose(part.vertices, SPHERE.vertices, atol=1e-6)
