"""USD: interpolations, orientation, subsets, preview surfaces, instances, skeletons, packages."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt
from support.tiny_models import QUAD, QUAD_ST, assert_corner_colors, corner_pixels, face_normals, png

from mi_simplify.errors import AssetError, MeshError
from mi_simplify.formats.load import load_asset


@pytest.fixture
def stage(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "quad.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetDefaultPrim(stage.DefinePrim("/World", "Xform"))
    return stage


def quad(stage, path="/World/Quad", counts=(4,), indices=(0, 1, 2, 3)) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(QUAD.astype("f4")))
    mesh.CreateFaceVertexCountsAttr(list(counts))
    mesh.CreateFaceVertexIndicesAttr(list(indices))
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


def add_st(mesh, name="st", interpolation="faceVarying", values=QUAD_ST, indices=None):
    kind = Sdf.ValueTypeNames.TexCoord2fArray
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
    primvar.Set(Vt.Vec2fArray.FromNumpy(np.asarray(values, "f4")))
    if indices is not None:
        primvar.SetIndices(indices)


def paint(stage, mesh, path="/World/Paint", **inputs) -> UsdShade.Shader:
    """Bind a UsdPreviewSurface; inputs are values, or (texture file, output, {texture inputs})."""
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    reader = UsdShade.Shader.Define(stage, f"{path}/st")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    types = {"diffuseColor": "Color3f", "normal": "Normal3f", "useSpecularWorkflow": "Int", "emissiveColor": "Color3f"}
    for key, value in inputs.items():
        port = surface.CreateInput(key, getattr(Sdf.ValueTypeNames, types.get(key, "Float")))
        if not (isinstance(value, tuple) and isinstance(value[0], str)):
            port.Set(value)
            continue
        texture = UsdShade.Shader.Define(stage, f"{path}/{key}")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(value[0])
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        for name, setting in value[2].items():
            kind = Sdf.ValueTypeNames.Token if isinstance(setting, str) else Sdf.ValueTypeNames.Float4
            texture.CreateInput(name, kind).Set(setting)
        port.ConnectToSource(texture.ConnectableAPI(), value[1])
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return surface


def save(stage) -> str:
    stage.Save()
    return stage.GetRootLayer().realPath


@pytest.mark.parametrize("interpolation", ["faceVarying", "vertex", "varying", "indexed"])
def test_texture_is_the_right_way_up(stage, tmp_path, interpolation):
    (tmp_path / "image.png").write_bytes(png(corner_pixels()))
    mesh = quad(stage)
    if interpolation == "indexed":
        add_st(mesh, values=QUAD_ST[::-1], indices=[3, 2, 1, 0])
    else:
        add_st(mesh, interpolation=interpolation)
    paint(stage, mesh, diffuseColor=("./image.png", "rgb", {}))
    (part,) = load_asset(save(stage)).parts
    assert len(part.vertices) == 4
    assert_corner_colors(part)
    np.testing.assert_allclose(face_normals(part), [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(part.material.specular, [[[0, 0.5, 0]]])


def test_package_and_silence(stage, tmp_path, capfd):
    (tmp_path / "image.png").write_bytes(png(corner_pixels()))
    mesh = quad(stage)
    add_st(mesh)
    paint(stage, mesh, diffuseColor=("./image.png", "rgb", {}))
    UsdUtils.CreateNewUsdzPackage(save(stage), str(tmp_path / "quad.usdz"))
    (tmp_path / "image.png").unlink()
    capfd.readouterr()
    assert_corner_colors(load_asset(tmp_path / "quad.usdz").parts[0])
    (tmp_path / "bad.usda").write_text("#usda 1.0\n{{{")
    with pytest.raises(AssetError, match="bad.usda: USD cannot read it") as error:
        load_asset(tmp_path / "bad.usda")
    assert "\n" not in str(error.value) and capfd.readouterr() == ("", "")


def test_left_handed_and_mirrored_quads_face_the_same_way(stage):
    left = quad(stage, "/World/Left", indices=(0, 3, 2, 1))
    left.CreateOrientationAttr(UsdGeom.Tokens.leftHanded)
    mirrored = quad(stage, "/World/Mirrored")
    UsdGeom.XformCommonAPI(mirrored).SetScale((-1, 1, 1))
    for part in load_asset(save(stage)).placed():
        np.testing.assert_allclose(face_normals(part), [[0, 0, 1]] * 2)


def test_transforms_and_up_axis(stage):
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    mesh = quad(stage)
    UsdGeom.XformCommonAPI(stage.GetPrimAtPath("/World")).SetTranslate((10, 20, 30))
    UsdGeom.XformCommonAPI(mesh).SetRotate((0, 0, 90))
    (part,) = load_asset(save(stage)).placed()
    # (1, 0, 0) turns to (0, 1, 0), moves to (10, 21, 30); z becomes y, y becomes -z.
    np.testing.assert_allclose(part.vertices[1], [10, 30, -21], atol=1e-6)


def test_normals_of_every_interpolation(stage):
    two = dict(counts=(3, 3), indices=(0, 1, 2, 0, 2, 3))
    up, side = (0, 0, 2), (0, 2, 0)
    smooth = quad(stage, "/World/A", **two)
    smooth.CreateNormalsAttr([up] * 4)
    flat = quad(stage, "/World/B", **two)
    flat.CreateNormalsAttr([up, side])
    flat.SetNormalsInterpolation("uniform")
    corners = quad(stage, "/World/C", **two)
    corners.CreateNormalsAttr([up] * 3 + [up, up, side])
    corners.SetNormalsInterpolation("faceVarying")
    a, b, c = load_asset(save(stage)).parts
    assert [len(p.vertices) for p in (a, b, c)] == [4, 6, 4]
    np.testing.assert_allclose(a.normals, [[0, 0, 1]] * 4)
    np.testing.assert_allclose(b.normals[b.faces], [[[0, 0, 1]] * 3, [[0, 1, 0]] * 3])
    np.testing.assert_allclose(c.normals[c.faces[1]], [[0, 0, 1], [0, 0, 1], [0, 1, 0]])


def test_subsets_become_parts_that_shade_as_one_surface(stage):
    mesh = quad(stage, counts=(3, 3), indices=(0, 1, 2, 0, 2, 3))
    mesh.GetPointsAttr().Set([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1)])
    paint(stage, mesh, "/World/Red", diffuseColor=(1.0, 0.0, 0.0))
    subset = UsdShade.MaterialBindingAPI(mesh.GetPrim()).CreateMaterialBindSubset("blue", [1])
    paint(stage, subset, "/World/Blue", diffuseColor=(0.0, 0.0, 1.0))
    red, blue = load_asset(save(stage)).parts
    np.testing.assert_allclose(red.material.base_color[0, 0, :3], [1, 0, 0])
    np.testing.assert_allclose(blue.material.base_color[0, 0, :3], [0, 0, 1])
    assert len(red.faces) == len(blue.faces) == 1
    at = [p.normals[np.flatnonzero((p.vertices == 0).all(1))[0]] for p in (red, blue)]
    np.testing.assert_allclose(*at)
    assert np.abs(at[0] - face_normals(red)[0]).max() > 0.05


def test_preview_surface_textures(stage, tmp_path):
    for name, value in (("rough", [51, 102, 204]), ("normal", [255, 128, 128])):
        (tmp_path / f"{name}.png").write_bytes(png(np.uint8([[value]])))
    (tmp_path / "color.png").write_bytes(png(np.uint8([[[188, 188, 188, 64]]])))
    mesh = quad(stage)
    add_st(mesh)
    unit = {"scale": Gf.Vec4f(2, 2, 2, 1), "bias": Gf.Vec4f(-1, -1, -1, 0)}
    paint(
        stage, mesh,
        diffuseColor=("color.png", "rgb", {}),
        opacity=("color.png", "a", {}),
        opacityThreshold=0.25,
        roughness=("rough.png", "g", {}),
        metallic=("rough.png", "b", {"scale": Gf.Vec4f(0.5, 0.5, 0.5, 0.5), "bias": Gf.Vec4f(0.1, 0.1, 0.1, 0)}),
        normal=("normal.png", "rgb", {"sourceColorSpace": "raw", **unit}),
    )  # fmt: skip
    material = load_asset(save(stage)).parts[0].material
    # 'auto' is sRGB for the colour, and linear for data.
    np.testing.assert_allclose(material.base_color, [[[0.50289] * 3 + [64 / 255]]], atol=1e-4)
    np.testing.assert_allclose(material.specular, [[[0, 0.4, 0.5]]], atol=1e-6)
    np.testing.assert_allclose(material.normal, [[[1, 0, 0]]], atol=0.01)
    assert (material.alpha_mode, material.alpha_cutoff) == ("MASK", 0.25)


def test_opacity_below_one_blends(stage):
    paint(stage, quad(stage), opacity=0.5)
    material = load_asset(save(stage)).parts[0].material
    assert material.alpha_mode == "BLEND" and material.base_color[0, 0, 3] == 0.5
    np.testing.assert_allclose(material.base_color[0, 0, :3], 0.18)  # the default of the specification


def test_transform_of_coordinates_happens_bottom_up(stage, tmp_path):
    (tmp_path / "image.png").write_bytes(png(corner_pixels()))
    mesh = quad(stage)
    add_st(mesh)
    paint(stage, mesh, diffuseColor=("image.png", "rgb", {}))
    node = UsdShade.Shader.Define(stage, "/World/Paint/move")
    node.CreateIdAttr("UsdTransform2d")
    node.CreateInput("rotation", Sdf.ValueTypeNames.Float).Set(90.0)
    node.CreateInput("scale", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(0.5, 0.5))
    node.CreateInput("translation", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(0.5, 0))
    reader = UsdShade.Shader.Get(stage, "/World/Paint/st")
    node.CreateInput("in", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    texture = UsdShade.Shader.Get(stage, "/World/Paint/diffuseColor")
    texture.GetInput("st").ConnectToSource(node.ConnectableAPI(), "result")
    (part,) = load_asset(save(stage)).parts
    # st (1, 0) is scaled to (.5, 0), turned to (0, .5), moved to (.5, .5); v then points down.
    corner = np.flatnonzero((part.vertices == [1, 0, 0]).all(1))[0]
    np.testing.assert_allclose(part.uvs[corner], [0.5, 0.5], atol=1e-6)
    # A node before it acts first: st (1, 0) is moved to (2, 0), then as above to (.5, 1).
    first = UsdShade.Shader.Define(stage, "/World/Paint/first")
    first.CreateIdAttr("UsdTransform2d")
    first.CreateInput("translation", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(1, 0))
    first.CreateInput("in", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    node.GetInput("in").ConnectToSource(first.ConnectableAPI(), "result")
    (part,) = load_asset(save(stage)).parts
    np.testing.assert_allclose(part.uvs[corner], [0.5, 0], atol=1e-6)


def test_display_colours(stage):
    constant, varying = quad(stage, "/World/A"), quad(stage, "/World/B")
    constant.CreateDisplayColorAttr([(0.2, 0.4, 0.6)])
    colors = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]
    varying.CreateDisplayColorPrimvar("vertex").Set(colors)
    a, b = load_asset(save(stage)).parts
    np.testing.assert_allclose(a.material.base_color[0, 0], [0.2, 0.4, 0.6, 1])
    assert a.colors is None
    np.testing.assert_allclose(b.material.base_color[0, 0], [1, 1, 1, 1])
    np.testing.assert_allclose(b.colors[:, :3], colors)


def test_instances_share_their_part(stage):
    quad(stage, "/World/Prototype/Quad")
    for k in range(3):
        prim = stage.DefinePrim(f"/World/Copy{k}", "Xform")
        prim.GetReferences().AddInternalReference("/World/Prototype")
        prim.SetInstanceable(True)
        UsdGeom.XformCommonAPI(prim).SetTranslate((k + 1, 0, 0))
    asset = load_asset(save(stage))
    assert len(asset.instances) == 4
    assert len(asset.parts) == 2  # one prototype, and the original that is no instance
    assert sorted(i.to_world[0, 3] for i in asset.instances) == [0, 1, 2, 3]


def test_point_instances(stage):
    instancer = UsdGeom.PointInstancer.Define(stage, "/World/Many")
    UsdGeom.XformCommonAPI(instancer).SetTranslate((0, 100, 0))
    child = quad(stage, "/World/Many/Prototypes/A")
    UsdGeom.XformCommonAPI(child).SetTranslate((0, 0, 5))
    instancer.CreatePrototypesRel().AddTarget("/World/Many/Prototypes/A")
    instancer.CreateProtoIndicesAttr([0, 0, 0])
    instancer.CreatePositionsAttr([(0, 0, 0), (10, 0, 0), (20, 0, 0)])
    instancer.CreateScalesAttr([(1, 1, 1), (2, 2, 2), (1, 1, 1)])
    instancer.InvisId(2, Usd.TimeCode.Default())
    asset = load_asset(save(stage))
    assert len(asset.parts) == 1
    corners = [p.vertices[2] for p in asset.placed()]
    np.testing.assert_allclose(corners, [[1, 101, 5], [12, 102, 10]], atol=1e-6)


def test_bind_pose_follows_the_skeleton(stage):
    UsdSkel.Root.Define(stage, "/World/Root")
    skeleton = UsdSkel.Skeleton.Define(stage, "/World/Root/Skeleton")
    skeleton.CreateJointsAttr(["hip"])
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1).SetTranslate((0, 9, 0))])
    UsdGeom.XformCommonAPI(skeleton).SetTranslate((1, 0, 0))
    mesh = quad(stage, "/World/Root/Quad")
    UsdGeom.XformCommonAPI(mesh).SetTranslate((50, 0, 0))  # does not count for a skinned mesh
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 1).Set([0, 0, 0, 0])
    binding.CreateJointWeightsPrimvar(False, 1).Set([1.0] * 4)
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1).SetTranslate((0, 0, 3)))
    asset = load_asset(save(stage))
    np.testing.assert_allclose(asset.placed()[0].vertices, QUAD + [1, 0, 3], atol=1e-6)
    np.testing.assert_allclose(asset.posed().placed()[0].vertices, QUAD + [1, 9, 3], atol=1e-6)
    assert asset.notes == ("skeleton 'Skeleton' has no animation; its one frame is the pose at rest",)


def test_what_is_left_out_is_noted(stage):
    quad(stage).CreateSubdivisionSchemeAttr("catmullClark")
    UsdGeom.BasisCurves.Define(stage, "/World/Ball")
    proxy = quad(stage, "/World/Proxy")
    proxy.CreatePurposeAttr("proxy")
    quad(stage, "/World/Hidden").MakeInvisible()
    holes = quad(stage, "/World/Holes", counts=(3, 3), indices=(0, 1, 2, 0, 2, 3))
    holes.CreateHoleIndicesAttr([0])
    material = UsdShade.Material.Define(stage, "/World/Other")
    UsdShade.MaterialBindingAPI.Apply(holes.GetPrim()).Bind(material)
    asset = load_asset(save(stage))
    assert asset.n_triangles == 2 * 16 + 1 and len(asset.parts) == 2
    notes = " | ".join(asset.notes)
    assert "'Quad', a catmullClark surface, is subdivided 2 times" in notes
    assert "'/World/Ball' was left out: a BasisCurves is no mesh" in notes
    assert "'/World/Proxy' was left out" in notes
    assert "material 'Other' has no UsdPreviewSurface" in notes


def test_missing_files_are_named(stage, tmp_path):
    mesh = quad(stage)
    add_st(mesh)
    paint(stage, mesh, diffuseColor=("./gone.png", "rgb", {}))
    with pytest.raises(AssetError, match="quad.usda: texture './gone.png' does not exist"):
        load_asset(save(stage))
    (tmp_path / "top.usda").write_text('#usda 1.0\ndef "a" (references = @./gone.usda@) {}\n')
    with pytest.raises(AssetError, match="top.usda: it refers to '.*gone.usda', which cannot be opened"):
        load_asset(tmp_path / "top.usda")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(counts=(4,), indices=(0, 1, 2, 9)), "quad.usda: part 'Quad' refers to vertex 9, but there are 4"),
        (dict(counts=(4,), indices=(0, 1, 2, -1)), "refers to vertex -1"),
        (dict(counts=(4, 4)), "the faces of part 'Quad' ask for 8 indices, there are 4"),
        (dict(counts=(), indices=()), "there are no faces in it"),
        (dict(indices=(0, 1, 1, 0)), "have no area"),
    ],
)
def test_broken_meshes(stage, changes, message):
    quad(stage, **changes)
    with pytest.raises(MeshError, match=message):
        load_asset(save(stage))


def test_one_odd_prim_does_not_spoil_the_file(stage):
    quad(stage)
    quad(stage, "/World/Broken", indices=(0, 1, 2, 9))
    path = Path(save(stage))
    odd = 'string points = "none"\n    int[] faceVertexCounts = [3]\n    int[] faceVertexIndices = [0, 1, 2]'
    path, text = path.with_name("odd.usda"), path.read_text()
    path.write_text(text + f'\ndef Mesh "Odd"\n{{\n    {odd}\n}}\n')
    asset = load_asset(path)
    assert [part.name for part in asset.parts] == ["Quad"] and len(asset.instances) == 1
    left_out = [note for note in asset.notes if "was left out, it cannot be read" in note]
    assert [note.split("'")[1] for note in left_out] == ["/World/Broken", "/Odd"]
    assert "refers to vertex 9, but there are 4" in left_out[0]


def materialx(stage, mesh, kind, path="/World/X", images=(), **inputs) -> UsdShade.Material:
    """Bind a surface of MaterialX; ``images`` are (input, file, type of the node)."""
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr(f"ND_{kind}_surfaceshader")
    material.CreateSurfaceOutput("mtlx").ConnectToSource(surface.ConnectableAPI(), "out")
    for key, value in inputs.items():
        kind_of = Sdf.ValueTypeNames.Color3f if isinstance(value, tuple) else Sdf.ValueTypeNames.Float
        surface.CreateInput(key, kind_of).Set(value)
    for key, file, node in images:
        image = UsdShade.Shader.Define(stage, f"{path}/{key}")
        image.CreateIdAttr(node)
        image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
        image.CreateInput("vaddressmode", Sdf.ValueTypeNames.String).Set("mirror")
        surface.CreateInput(key, Sdf.ValueTypeNames.Color3f).ConnectToSource(image.ConnectableAPI(), "out")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return material


def test_standard_surface_has_its_constants_and_images(stage, tmp_path):
    (tmp_path / "image.png").write_bytes(png(corner_pixels()))
    mesh = quad(stage)
    add_st(mesh)
    materialx(
        stage, mesh, "standard_surface", images=[("base_color", "image.png", "ND_image_color3")], base=0.5,
        specular_roughness=0.25, metalness=1.0, emission=2.0, emission_color=(1.0, 0.5, 0.0), coat=0.5,
    )  # fmt: skip
    (part,) = load_asset(save(stage)).parts
    material = part.material
    np.testing.assert_allclose(material.base_color[0, 0], [0.5, 0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(material.specular, [[[0, 0.25, 1]]])
    np.testing.assert_allclose(material.emission, [[[2, 1, 0]]])
    assert material.lobes == {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.1}} or (
        material.lobes["KHR_materials_clearcoat"]["clearcoatRoughnessFactor"] == pytest.approx(0.1)
    )
    assert material.lookup("base_color").wraps == ("repeat", "mirror")


def test_open_pbr_and_gltf_pbr(stage):
    for name, kind, inputs in (
        ("A", "open_pbr_surface", dict(base_color=(0.2, 0.4, 0.6), base_metalness=0.5, geometry_opacity=0.5)),
        ("B", "gltf_pbr", dict(base_color=(0.2, 0.4, 0.6), metallic=0.5, alpha=0.5, roughness=0.3)),
    ):
        materialx(stage, quad(stage, f"/World/{name}"), kind, f"/World/X{name}", **inputs)
    for part in load_asset(save(stage)).parts:
        np.testing.assert_allclose(part.material.base_color, [[[0.2, 0.4, 0.6, 0.5]]], atol=1e-6)
        np.testing.assert_allclose(part.material.specular, [[[0, 0.3, 0.5]]], atol=1e-6)
        assert part.material.alpha_mode == "BLEND"


def test_a_preview_surface_behind_materialx_is_the_material(stage):
    mesh = quad(stage)
    surface = paint(stage, mesh, diffuseColor=(1, 0, 0))
    other = UsdShade.Shader.Define(stage, "/World/Paint/x")
    other.CreateIdAttr("ND_standard_surface_surfaceshader")
    material = UsdShade.Material(surface.GetPrim().GetParent())
    material.CreateSurfaceOutput("mtlx").ConnectToSource(other.ConnectableAPI(), "out")
    asset = load_asset(save(stage))
    np.testing.assert_allclose(asset.parts[0].material.base_color, [[[1, 0, 0, 1]]])
    assert asset.notes == ()


@pytest.mark.parametrize(
    ("kind", "volume", "height"),
    [
        ("Sphere", 4 / 3 * np.pi, 2), ("Cube", 8, 2), ("Cylinder", 2 * np.pi, 2), ("Cone", 2 / 3 * np.pi, 2),
        ("Capsule", np.pi * 0.25 + 4 / 3 * np.pi * 0.125, 2),
    ],
)  # fmt: skip
def test_solids_are_closed_and_face_outwards(stage, kind, volume, height):
    solid = getattr(UsdGeom, kind).Define(stage, "/World/Solid")
    if kind not in ("Sphere", "Cube"):
        solid.CreateAxisAttr("Y")
    UsdGeom.Gprim(solid).CreateDisplayColorAttr([(1, 0, 0)])
    (part,) = load_asset(save(stage)).parts
    p = part.vertices[part.faces]
    found = np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6
    assert 0.975 * volume < found < 1.0001 * volume
    np.testing.assert_allclose(np.ptp(part.vertices[:, 1]), height, atol=1e-9)
    facing = np.einsum("fi,fi->f", np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), part.normals[part.faces].mean(1))
    assert facing.min() > 0
    np.testing.assert_allclose(part.material.base_color[0, 0], [1, 0, 0, 1])


def test_a_plane_stands_across_its_axis(stage):
    plane = UsdGeom.Plane.Define(stage, "/World/Plane")
    plane.CreateAxisAttr("X")
    plane.CreateWidthAttr(4.0)
    (part,) = load_asset(save(stage)).parts
    np.testing.assert_allclose(np.ptp(part.vertices, axis=0), [0, 2, 4])
    np.testing.assert_allclose(face_normals(part), [[1, 0, 0]] * 2)
