"""
USD out: a mesh with a UsdPreviewSurface material, and PNG textures beside it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from ... import __version__
from ...errors import MeshError
from ...machine.files import side_file_stem, write_atomic
from ...model.groups import Group
from ...model.model import Model
from ..origin import recentred
from ..textures import HOLDS_AMBIENT, Textures, encode_textures, png
from .write_skeleton import bind_skeleton


def write_usd(model: Model, path: str | Path, *, extras: dict | None = None) -> Path:
    """
    Write a model as USD + PNG: welded mesh, indexed face-varying ``st`` with v up, +Y up; a character as UsdSkel.

    UsdPreviewSurface has no textured dielectric specular, so gamma of dielectrics is lost.

    Parameters
    ----------
    model : Model
    path : str or Path
        ``.usdc``, ``.usda`` or ``.usd``, in an existing folder; textures are named after it.
    extras : dict, optional
        Strings and numbers for the layer's ``customLayerData``.

    Returns
    -------
    Path

    Raises
    ------
    MeshError
        The mesh has no faces.
    OutputError
        A file cannot be written.
    """
    path = Path(path)
    if not len(model.mesh.faces):
        raise MeshError("nothing to export: the mesh has no faces")
    model, origin = recentred(model)
    stem = side_file_stem(path)
    textures = encode_textures(model)
    for key in ("base_color", "orm", "normal", *(() if textures.emission is None else ("emission",))):
        write_atomic(path.with_name(f"{stem}_{key}.png"), png(getattr(textures, key)))

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    layer = stage.GetRootLayer()
    about = dict(extras or {}) | ({HOLDS_AMBIENT: True} if textures.holds_ambient else {})
    if isinstance(notice := model.metadata.get("copyright"), str):
        about["copyright"] = notice
    layer.customLayerData = {"creator": f"mi_simplify {__version__}", **about}
    kind = UsdGeom.Xform if model.skin is None else UsdSkel.Root
    root = kind.Define(stage, "/" + Tf.MakeValidIdentifier(model.name or "model"))
    stage.SetDefaultPrim(root.GetPrim())
    if origin.any():
        root.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*origin.tolist()))
    Usd.ModelAPI(root).SetKind("component")
    mesh = _mesh(stage, root.GetPath().AppendChild("mesh"), model)
    _bind_groups(stage, root, mesh, model, stem, textures)
    if model.skin is not None:
        bind_skeleton(stage, root, mesh, model.mesh, model.skin)

    def export(temporary: Path) -> None:
        try:
            done = layer.Export(str(temporary))
        except Tf.ErrorException as error:
            raise OSError(0, "USD could not write the file") from error
        if not done:
            raise OSError(0, "USD could not write the file")

    return write_atomic(path, export)


def _bind_groups(
    stage: Usd.Stage, root: UsdGeom.Xform, mesh: UsdGeom.Mesh, model: Model, stem: str, textures: Textures
) -> None:
    """A material for every group, bound to the mesh, or to subsets of its faces where there are several."""
    groups, binding = model.face_groups, UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    several = len(groups.kinds) > 1
    if several:
        binding.SetMaterialBindSubsetsFamilyType(UsdGeom.Tokens.partition)
    for k, group in enumerate(groups.kinds):
        name = f"material_{k}" if several else "material"
        material = _material(stage, root.GetPath().AppendChild(name), group, stem, textures)
        if several:
            faces = Vt.IntArray.FromNumpy(np.flatnonzero(groups.of_face == k).astype(np.int32))
            subset = binding.CreateMaterialBindSubset(f"group_{k}", faces)
            UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
        else:
            binding.Bind(material)


def _mesh(stage: Usd.Stage, path: Sdf.Path, model: Model) -> UsdGeom.Mesh:
    """Points over welded positions, normals over corners, texture coordinates over vertices."""
    source = model.mesh
    mesh = UsdGeom.Mesh.Define(stage, path)
    points = source.positions.astype(np.float32)
    normals = source.normals().astype(np.float32)[source.normal_groups][source.faces].reshape(-1, 3)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(source.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(source.position_faces.ravel().astype(np.int32)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.faceVarying)
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateDoubleSidedAttr(any(kind.double_sided for kind in model.face_groups.kinds))
    uvs = (np.asarray(source.uvs, np.float64) * [1.0, -1.0] + [0.0, 1.0]).astype(np.float32)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    st.Set(Vt.Vec2fArray.FromNumpy(uvs))
    st.SetIndices(Vt.IntArray.FromNumpy(source.faces.ravel().astype(np.int32)))
    return mesh


def _material(stage: Usd.Stage, path: Sdf.Path, group: Group, stem: str, textures: Textures) -> UsdShade.Material:
    """Metallic-roughness UsdPreviewSurface, one texture reader per file."""
    material = UsdShade.Material.Define(stage, path)
    surface = _shader(stage, path, "surface", "UsdPreviewSurface")
    surface.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(0)
    reader = _shader(stage, path, "st", "UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    coordinates = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)

    def texture(key: str, color_space: str) -> UsdShade.Shader:
        shader = _shader(stage, path, key, "UsdUVTexture")
        shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./{stem}_{key}.png"))
        shader.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set(color_space)
        shader.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates)
        for axis in ("wrapS", "wrapT"):
            shader.CreateInput(axis, Sdf.ValueTypeNames.Token).Set("repeat")
        return shader

    def connect(name: str, kind: Sdf.ValueTypeName, shader: UsdShade.Shader, output: str) -> None:
        out = shader.CreateOutput(output, Sdf.ValueTypeNames.Float if len(output) == 1 else Sdf.ValueTypeNames.Float3)
        surface.CreateInput(name, kind).ConnectToSource(out)

    base = texture("base_color", "sRGB")
    connect("diffuseColor", Sdf.ValueTypeNames.Color3f, base, "rgb")
    orm = texture("orm", "raw")
    connect("roughness", Sdf.ValueTypeNames.Float, orm, "g")
    connect("metallic", Sdf.ValueTypeNames.Float, orm, "b")
    normal = texture("normal", "raw")
    normal.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(2, 2, 2, 1))  # [0, 1] to [-1, 1]
    normal.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
    connect("normal", Sdf.ValueTypeNames.Normal3f, normal, "rgb")
    if textures.has_occlusion:
        connect("occlusion", Sdf.ValueTypeNames.Float, orm, "r")
    if textures.emission is not None:
        glow, emission = texture("emission", "sRGB"), textures.emission_strength
        glow.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(emission, emission, emission, 1))
        connect("emissiveColor", Sdf.ValueTypeNames.Color3f, glow, "rgb")
    for key, name in (("clearcoatFactor", "clearcoat"), ("clearcoatRoughnessFactor", "clearcoatRoughness")):
        if (value := group.lobes.get("KHR_materials_clearcoat", {}).get(key)) is not None:
            surface.CreateInput(name, Sdf.ValueTypeNames.Float).Set(float(value))
    if (ior := group.lobes.get("KHR_materials_ior", {}).get("ior")) is not None:
        surface.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(float(ior))
    if group.alpha_mode != "OPAQUE":
        connect("opacity", Sdf.ValueTypeNames.Float, base, "a")
    if group.alpha_mode == "MASK":
        surface.CreateInput("opacityThreshold", Sdf.ValueTypeNames.Float).Set(float(group.alpha_cutoff))
    surface_output = surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(surface_output)
    return material


def _shader(stage: Usd.Stage, parent: Sdf.Path, name: str, identifier: str) -> UsdShade.Shader:
    """A shader of a known type under the material."""
    shader = UsdShade.Shader.Define(stage, parent.AppendChild(name))
    shader.CreateIdAttr(identifier)
    return shader
