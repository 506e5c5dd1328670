"""Files out, read back by other people's readers: trimesh, pygltflib, usd-core, the Khronos validator."""

import io
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import trimesh
from PIL import Image
from pxr import Usd, UsdGeom, UsdShade, UsdValidation
from support.paths import ROOT

from mi_simplify.errors import ConfigError, MeshError, OutputError
from mi_simplify.export import export_model, write_glb, write_obj
from mi_simplify.formats.gltf.order import ordered
from mi_simplify.formats.gltf.write import glb_bytes
from mi_simplify.formats.textures import encode_textures, to_8bit
from mi_simplify.formats.usd.write import write_usd
from mi_simplify.model.color import linear_to_srgb, srgb_to_linear
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.model import Model
from mi_simplify.model.tangents import split_mirrored, vertex_tangents

DATA = ROOT / "tests" / "data" / "mikktspace.json"


@pytest.fixture
def model() -> Model:
    """
    A sheet with a mirrored chart, an unmirrored one and a fold; non-square random textures; roughness, metal.
    """
    data = json.loads(DATA.read_text())
    mesh = Mesh(
        np.array(data["positions"]) * 3 + [10, 0, -2],
        np.array(data["position_index"]),
        np.float32(data["uvs"]),
        np.array(data["faces"]),
    )
    rng = np.random.default_rng(3)
    normal = rng.normal(0, 0.3, (24, 40, 3)) + [0, 0, 1]
    return Model(
        mesh,
        base_color=rng.random((24, 40, 4), np.float32),
        specular=np.concatenate([np.zeros((24, 40, 1)), rng.random((24, 40, 2))], 2).astype(np.float32),
        normal=(normal / np.linalg.norm(normal, axis=2, keepdims=True)).astype(np.float32),
        name="sheet one",
    )


def with_specular(model: Model, gamma: float, metallic: float) -> Model:
    """The model with constant gamma and metal."""
    specular = np.zeros((24, 40, 3), np.float32) + np.float32([gamma, 0.4, metallic])
    return replace(model, specular=specular)


# --- textures -----------------------------------------------------------------------------------------------------


def test_srgb_known_values_and_exact_round_trip():
    np.testing.assert_array_equal(to_8bit(linear_to_srgb(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]))), [0, 0, 188, 255, 255])
    assert linear_to_srgb(np.array(0.002)) == pytest.approx(0.02584)
    steps = np.arange(256)
    np.testing.assert_array_equal(to_8bit(linear_to_srgb(srgb_to_linear(steps / 255))), steps)


def test_rounding_is_to_nearest():
    values = np.linspace(0, 1, 10_001)
    assert np.abs(to_8bit(values) / 255 - values).max() <= 0.5 / 255 + 1e-12


def test_channels(model):
    textures = encode_textures(model)
    assert textures.base_color.shape == (24, 40, 4) and textures.orm.shape == (24, 40, 3)
    assert (textures.base_color[..., 3] == 255).all(), "an OPAQUE model's opacity is 255"
    assert (textures.orm[..., 0] == 255).all(), "red is occlusion, and none"
    np.testing.assert_array_equal(textures.orm[..., 1:], to_8bit(model.specular[..., 1:]))
    decoded = textures.normal / 255 * 2 - 1
    assert np.abs(decoded - model.normal).max() < 1.01 / 255
    assert textures.specular_color is None
    masked = encode_textures(replace(model, alpha_mode="MASK"))
    np.testing.assert_array_equal(masked.base_color[..., 3], to_8bit(model.base_color[..., 3]))


def test_normals_are_normalised_and_stay_above_the_surface(model):
    normal = np.float32([[[0, 0, 7], [0, 3, 0], [0.6, 0, -0.8], [0, 0, 0]]])
    encoded = encode_textures(replace(model, normal=normal)).normal
    np.testing.assert_array_equal(encoded[0], [[128, 128, 255], [128, 255, 128], [255, 128, 128], [128, 128, 255]])


@pytest.mark.parametrize("metallic", [0.0, 0.3, 0.9, 1.0])
def test_gamma_scales_the_specular_lobe(model, metallic):
    """The F0 and the diffuse reflectance that glTF reads from the textures are those of the material with gamma."""
    gamma = 0.5
    textures = encode_textures(with_specular(model, gamma, metallic))
    kd, m = srgb_to_linear(textures.base_color[..., :3] / 255), textures.orm[..., 2:] / 255
    color = 1.0 if textures.specular_color is None else srgb_to_linear(textures.specular_color / 255)
    read = 0.04 * color * (1 - m) + kd * m
    wanted = (1 - gamma) * (0.04 * (1 - metallic) + model.base_color[..., :3] * metallic)
    np.testing.assert_allclose(read, wanted, atol=0.005)
    np.testing.assert_allclose(kd * (1 - m), model.base_color[..., :3] * (1 - metallic), atol=0.005)
    assert (textures.specular_color is None) == (metallic == 1.0)


def test_gamma_of_specular_textures_of_another_size(model):
    specular = np.zeros((1, 2, 3), np.float32)
    specular[0, 1] = 0.5, 0.4, 1.0  # the right half is metal with gamma
    textures = encode_textures(replace(model, specular=specular))
    plain = encode_textures(model)
    np.testing.assert_array_equal(textures.base_color[:, :20], plain.base_color[:, :20])
    assert (textures.base_color[:, 20:, :3] <= plain.base_color[:, 20:, :3]).all()
    expected = to_8bit(linear_to_srgb(model.base_color[:, 20:, :3].astype(np.float64) * 0.5))
    np.testing.assert_array_equal(textures.base_color[:, 20:, :3], expected)


def test_textures_that_are_not_finite_are_named(model):
    base = model.base_color.copy()
    base[3, 4, 1] = np.nan
    with pytest.raises(ValueError, match="base_color: 1 values are not finite"):
        encode_textures(replace(model, base_color=base))


# --- glTF ---------------------------------------------------------------------------------------------------------


def accessor(glb: pygltflib.GLTF2, index: int) -> np.ndarray:
    """An accessor's values by the letter of the specification."""
    entry = glb.accessors[index]
    view = glb.bufferViews[entry.bufferView]
    kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[entry.componentType]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[entry.type]
    data = np.frombuffer(glb.binary_blob(), kind, entry.count * width, view.byteOffset)
    return data.reshape(-1, width)


def image(glb: pygltflib.GLTF2, texture: int) -> np.ndarray:
    """A texture's texels."""
    view = glb.bufferViews[glb.images[glb.textures[texture].source].bufferView]
    blob = glb.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    return np.asarray(Image.open(io.BytesIO(blob)))


def test_glb_geometry_read_by_pygltflib(model, tmp_path):
    path = write_glb(model, tmp_path / "model.glb", extras={"transport": "baked"})
    glb = pygltflib.GLTF2().load(path)
    attributes = glb.meshes[0].primitives[0].attributes
    positions = accessor(glb, attributes.POSITION)
    faces = accessor(glb, glb.meshes[0].primitives[0].indices).reshape(-1, 3)
    mesh = ordered(split_mirrored(model.mesh))
    assert len(mesh.uvs) == len(model.mesh.uvs) + 4, "four vertices lie on the fold"
    np.testing.assert_array_equal(faces, mesh.faces)
    np.testing.assert_array_equal(positions, mesh.vertices.astype(np.float32))
    np.testing.assert_array_equal(accessor(glb, attributes.TEXCOORD_0), mesh.uvs)
    np.testing.assert_array_equal(glb.accessors[attributes.POSITION].min, positions.min(0).astype(float))
    np.testing.assert_array_equal(glb.accessors[attributes.POSITION].max, positions.max(0).astype(float))
    normals = accessor(glb, attributes.NORMAL)
    expected = mesh.normals()[mesh.position_index]
    np.testing.assert_allclose(normals, expected, atol=1e-6)
    tangents = accessor(glb, attributes.TANGENT)
    direction, sign = vertex_tangents(mesh, mesh.normals())  # test_mikktspace.py holds them against the original
    np.testing.assert_allclose(tangents, np.column_stack([direction, sign]), atol=1e-5)
    np.testing.assert_allclose((tangents[:, :3] * normals).sum(1), 0, atol=1e-6)
    assert glb.asset.extras == {"transport": "baked"} and glb.asset.generator.startswith("mi_simplify")


def test_bitangent_points_up_the_image_in_every_face(model):
    glb = pygltflib.GLTF2().load_from_bytes(glb_bytes(model))
    attributes = glb.meshes[0].primitives[0].attributes
    p, n, t, uv = (
        accessor(glb, getattr(attributes, k)).astype(float) for k in ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_0")
    )
    faces = accessor(glb, glb.meshes[0].primitives[0].indices).reshape(-1, 3)
    p, n, t, uv = p[faces], n[faces], t[faces], uv[faces]
    assert np.ptp(t[..., 3], axis=1).max() == 0, "w is one per triangle"
    edges = np.stack([p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]], 1)
    steps = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], 1)
    du, dv = np.moveaxis(np.linalg.solve(steps, edges), 1, 0)  # dp/du, dp/dv with v down
    bitangent = np.cross(n, t[..., :3]) * t[..., 3:]
    assert ((t[..., :3] * du[:, None]).sum(-1) > 0).all()
    # -dp/dv is up the image; a sheared chart leaves it some way off, never on the other side
    up = -dv / np.linalg.norm(dv, axis=1, keepdims=True)
    assert np.median((bitangent * up[:, None]).sum(-1)) > 0.9
    assert ((bitangent * up[:, None]).sum(-1).mean(1) > 0).all()


def test_glb_material_texels_read_by_pygltflib(model):
    glb = pygltflib.GLTF2().load_from_bytes(glb_bytes(model))
    material, textures = glb.materials[0], encode_textures(model)
    pbr = material.pbrMetallicRoughness
    np.testing.assert_array_equal(image(glb, pbr.baseColorTexture.index), textures.base_color[..., :3])
    np.testing.assert_array_equal(image(glb, pbr.metallicRoughnessTexture.index), textures.orm)
    np.testing.assert_array_equal(image(glb, material.normalTexture.index), textures.normal)
    assert (pbr.metallicFactor, pbr.roughnessFactor, material.doubleSided, material.alphaMode) == (1, 1, True, "OPAQUE")
    assert not material.extensions and not glb.extensionsUsed


def test_glb_carries_gamma_as_specular_color(model):
    glb = pygltflib.GLTF2().load_from_bytes(glb_bytes(with_specular(model, 0.5, 0.0)))
    assert glb.extensionsUsed == ["KHR_materials_specular"] and not glb.extensionsRequired
    extension = glb.materials[0].extensions["KHR_materials_specular"]
    assert list(extension) == ["specularColorFactor"], "specularFactor would scale F90 too"
    np.testing.assert_allclose(extension["specularColorFactor"], 0.5, atol=0.003)  # 188 of 255, by sRGB


@pytest.mark.parametrize(("mode", "cutoff"), [("OPAQUE", None), ("MASK", 0.3), ("BLEND", None)])
def test_glb_alpha_modes(model, mode, cutoff):
    content = glb_bytes(replace(model, alpha_mode=mode, alpha_cutoff=0.3))
    (length,) = struct.unpack_from("<I", content, 12)
    (material,) = json.loads(content[20 : 20 + length])["materials"]
    assert (material["alphaMode"], material.get("alphaCutoff")) == (mode, cutoff)


def test_glb_read_by_trimesh(model, tmp_path):
    scene = trimesh.load(write_glb(model, tmp_path / "model.glb"), force="scene", process=False)
    assert isinstance(scene, trimesh.Scene)
    (geometry,) = scene.geometry.values()
    mesh = ordered(split_mirrored(model.mesh))
    np.testing.assert_array_equal(geometry.faces, mesh.faces)
    np.testing.assert_array_equal(np.float32(geometry.vertices), mesh.vertices.astype(np.float32))
    np.testing.assert_allclose(geometry.visual.uv * [1, -1] + [0, 1], mesh.uvs, atol=1e-6)
    texels = np.asarray(geometry.visual.material.baseColorTexture)
    np.testing.assert_array_equal(texels[..., :3], encode_textures(model).base_color[..., :3])


def test_many_vertices_take_wide_indices():
    """65,536 vertices do not fit 16 bits, as 65535 is reserved."""
    # Triangles that share nothing stay where they are.
    for count, component in ((65535, pygltflib.UNSIGNED_SHORT), (65538, pygltflib.UNSIGNED_INT)):
        positions = np.random.default_rng(0).random((count, 3))
        faces = np.arange(count).reshape(-1, 3)
        mesh = Mesh(positions, np.arange(count), positions[:, :2].astype(np.float32), faces)
        one = np.ones((1, 1, 4), np.float32)
        glb = pygltflib.GLTF2().load_from_bytes(glb_bytes(Model(mesh, one, one[..., :3], one[..., :3])))
        indices = glb.meshes[0].primitives[0].indices
        assert glb.accessors[indices].componentType == component
        np.testing.assert_array_equal(accessor(glb, indices).reshape(-1, 3), faces)


def test_glb_satisfies_the_khronos_validator(model, node_run):
    script = """
        const validator = require('gltf-validator');
        const bytes = new Uint8Array(require('fs').readFileSync(0));
        validator.validateBytes(bytes, {maxIssues: 0}).then(r => console.log(JSON.stringify(r.issues)));
    """
    variants = [model, with_specular(model, 0.5, 0.0), replace(model, alpha_mode="MASK"), model.transformed(1e-3, 0)]
    for variant in variants:
        issues = json.loads(node_run("gltf-validator", script, glb_bytes(variant, extras={"transport": "direct"})))
        found = [
            m for m in issues["messages"] if m["severity"] <= 2 and m["code"] != "IMAGE_NPOT_DIMENSIONS"
        ]  # not hints
        assert not found, found


# --- OBJ ----------------------------------------------------------------------------------------------------------


def test_obj_read_by_trimesh(model, tmp_path):
    write_obj(model, tmp_path / "model.obj")
    scene = trimesh.load(tmp_path / "model.obj", force="scene", process=False)
    assert isinstance(scene, trimesh.Scene)
    (loaded,) = scene.geometry.values()
    corners = model.mesh.vertices[model.mesh.faces]
    np.testing.assert_allclose(loaded.vertices[loaded.faces], corners, rtol=1e-7)
    uv = loaded.visual.uv[loaded.faces] * [1, -1] + [0, 1]
    np.testing.assert_allclose(uv, model.mesh.uvs[model.mesh.faces], atol=1e-6)
    normals = model.mesh.normals()[model.mesh.position_faces]
    np.testing.assert_allclose(loaded.vertex_normals[loaded.faces], normals, atol=1e-6)
    texels = np.asarray(loaded.visual.material.image.convert("RGB"))
    np.testing.assert_array_equal(texels, encode_textures(model).base_color[..., :3])


def test_obj_library_names_the_files_that_are_there(model, tmp_path):
    write_obj(replace(model, alpha_mode="MASK"), tmp_path / "my model.obj")
    text = (tmp_path / "my_model.mtl").read_text()
    assert "mtllib my_model.mtl\n" in (tmp_path / "my model.obj").read_text()
    maps = dict(line.split() for line in text.splitlines() if line.startswith(("map_", "norm ")))
    assert list(maps) == ["map_Kd", "norm", "map_Pr", "map_Pm", "map_d"]
    images = {key: np.asarray(Image.open(tmp_path / name)) for key, name in maps.items()}
    textures = encode_textures(replace(model, alpha_mode="MASK"))
    np.testing.assert_array_equal(images["norm"], textures.normal)
    np.testing.assert_array_equal(images["map_Pr"], textures.orm[..., 1])
    np.testing.assert_array_equal(images["map_Pm"], textures.orm[..., 2])
    np.testing.assert_array_equal(images["map_d"] == 255, textures.base_color[..., 3] >= 127.5)
    assert set(np.unique(images["map_d"])) == {0, 255}


def test_obj_positions_stay_welded(model, tmp_path):
    lines = write_obj(model, tmp_path / "model.obj").read_text().splitlines()
    assert sum(line.startswith("v ") for line in lines) == len(model.mesh.positions) < len(model.mesh.uvs)


# --- USD ----------------------------------------------------------------------------------------------------------


def read_usd(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh, UsdShade.Shader]:
    """The stage, its one mesh, and the surface shader bound to it."""
    stage = Usd.Stage.Open(str(path))
    mesh = next(UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    material, _ = UsdShade.MaterialBindingAPI(mesh.GetPrim()).ComputeBoundMaterial()
    return stage, mesh, material.ComputeSurfaceSource()[0]


def source(shader: UsdShade.Shader, name: str) -> tuple[UsdShade.Shader, str]:
    """The shader and output that an input is connected to."""
    info = shader.GetInput(name).GetConnectedSources()[0][0]
    return UsdShade.Shader(info.source), str(info.sourceName)


def test_usd_geometry(model, tmp_path):
    stage, mesh, _ = read_usd(write_usd(model, tmp_path / "model.usdc", extras={"transport": "baked"}))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and stage.GetDefaultPrim().GetName() == "sheet_one"
    assert stage.GetRootLayer().customLayerData["transport"] == "baked"
    points = np.array(mesh.GetPointsAttr().Get())
    np.testing.assert_array_equal(points, model.mesh.positions.astype(np.float32))
    index = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    np.testing.assert_array_equal(index, model.mesh.position_faces)
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert st.GetInterpolation() == UsdGeom.Tokens.faceVarying
    uv = np.array(st.ComputeFlattened()).reshape(-1, 3, 2) * [1, -1] + [0, 1]
    np.testing.assert_allclose(uv, model.mesh.uvs[model.mesh.faces], atol=1e-6)
    assert mesh.GetNormalsInterpolation() == UsdGeom.Tokens.faceVarying
    normals = model.mesh.normals()[model.mesh.position_faces].reshape(-1, 3)
    np.testing.assert_allclose(np.array(mesh.GetNormalsAttr().Get()), normals, atol=1e-6)
    np.testing.assert_array_equal(np.array(mesh.GetExtentAttr().Get()), [points.min(0), points.max(0)])
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"


def test_usd_material(model, tmp_path):
    masked = replace(model, alpha_mode="MASK", alpha_cutoff=0.25)
    stage, _, surface = read_usd(write_usd(masked, tmp_path / "model.usda"))
    textures = encode_textures(masked)
    expected = {
        "diffuseColor": ("rgb", "sRGB", textures.base_color),
        "opacity": ("a", "sRGB", textures.base_color),
        "roughness": ("g", "raw", textures.orm),
        "metallic": ("b", "raw", textures.orm),
        "normal": ("rgb", "raw", textures.normal),
    }
    for name, (output, color_space, texels) in expected.items():
        texture, read = source(surface, name)
        assert (read, texture.GetInput("sourceColorSpace").Get()) == (output, color_space), name
        np.testing.assert_array_equal(np.asarray(Image.open(texture.GetInput("file").Get().resolvedPath)), texels)
    normal, _ = source(surface, "normal")
    assert tuple(normal.GetInput("scale").Get()) == (2, 2, 2, 1)
    assert tuple(normal.GetInput("bias").Get()) == (-1, -1, -1, 0)
    assert surface.GetInput("opacityThreshold").Get() == 0.25
    stage, _, opaque = read_usd(write_usd(model, tmp_path / "opaque.usda"))
    assert not opaque.GetInput("opacity")


@pytest.mark.parametrize("mode", ["OPAQUE", "MASK", "BLEND"])
def test_usd_satisfies_usd_validation(model, tmp_path, mode):
    path = write_usd(replace(model, alpha_mode=mode), tmp_path / "model.usdc")
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    assert not errors, [(e.GetName(), e.GetMessage()) for e in errors]


# --- all of them --------------------------------------------------------------------------------------------------


def test_export_model_writes_all_and_nothing_else(model, tmp_path):
    paths = export_model(model, tmp_path / "new" / "out", extras={"transport": "direct"})
    assert {key: path.name for key, path in paths.items()} == {
        "glb": "model.glb",
        "obj": "model.obj",
        "usd": "model.usdc",
    }
    images = [f"model_{k}.png" for k in ("base_color", "metallic", "normal", "orm", "roughness")]
    assert sorted(p.name for p in (tmp_path / "new" / "out").iterdir()) == sorted(
        ["model.glb", "model.obj", "model.mtl", "model.usdc", *images]
    )
    before = paths["glb"].read_bytes()
    export_model(model, tmp_path / "new" / "out", formats=["glb"], extras={"transport": "direct"})
    assert paths["glb"].read_bytes() == before, "the same model gives the same bytes"


def test_errors_say_what_to_do(model, tmp_path):
    with pytest.raises(ConfigError, match=r"unknown export format \(export.formats\) 'fbx'; one of glb, obj, usd"):
        export_model(model, tmp_path, formats=["fbx"])
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write .*file.*choose another output folder"):
        export_model(model, tmp_path / "file")
    for write, name in ((write_glb, "a.glb"), (write_obj, "a.obj"), (write_usd, "a.usdc")):
        with pytest.raises(OutputError, match="cannot write .*missing"):
            write(model, tmp_path / "missing" / name)
        (tmp_path / name).mkdir()
        with pytest.raises(OutputError, match="cannot write"):
            write(model, tmp_path / name)
        empty = replace(model, mesh=replace(model.mesh, faces=np.zeros((0, 3), np.int64)))
        with pytest.raises(MeshError, match="no faces"):
            write(empty, tmp_path / f"empty_{name}")
    assert not [p for p in tmp_path.iterdir() if p.name.startswith((".", "empty"))], "nothing half-written"


def test_a_failed_write_leaves_the_old_file(model, tmp_path, monkeypatch):
    path = write_glb(model, tmp_path / "model.glb")
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_glb(replace(model, name="other"), path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
