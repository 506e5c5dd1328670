"""Every feature of USD in docs/formats.md in a file of its own: column USD says what becomes of it."""

import re

import numpy as np
import pytest
from support.paths import ROOT
from support.tiny_models import corner_pixels, png

from mi_simplify.formats.load import load_asset
from mi_simplify.model.asset import Asset

TEXTURE = """
    def Shader "image" {{
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./a.png@
        float2 inputs:st.connect = </W/P/{source}.outputs:result>
        {more}
        float3 outputs:rgb
    }}
    def Shader "st" {{
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "{uv}"
        float2 outputs:result
    }}
"""
IMAGE = "</W/P/image.outputs:rgb>"
TRANSFORM = """
    def Shader "moved" {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </W/P/st.outputs:result>
        float2 inputs:scale = (2, 2)
        float2 outputs:result
    }
"""
INSTANCE = """
    def Xform "%s" (
        instanceable = true
        references = </Proto>
    ) {
        double3 xformOp:translate = (%d, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""
ONE = "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"


def textured(key: str, kind: str, more: str = "", uv: str = "st", source: str = "st") -> dict:
    surface = f"{kind} inputs:{key}.connect = {IMAGE}"
    return {"surface": surface, "nodes": TEXTURE.format(more=more, uv=uv, source=source)}


def material(asset: Asset):
    return asset.parts[0].material


#: Of each feature what a file with it has besides: inputs of the surface, nodes of the material, properties of the mesh
#: and of its place, further prims, the layer's metadata; and whether it has come through. What has no test of that is
#: left out, which is a line.
FEATURES: dict[str, tuple] = {
    "base colour": (textured("diffuseColor", "color3f"), lambda a: np.ptp(material(a).base_color[..., :3]) > 0.5),
    "roughness, metalness": (
        {"surface": "float inputs:roughness = 0.25\nfloat inputs:metallic = 0.75"},
        lambda a: np.allclose(material(a).specular[0, 0, 1:], [0.25, 0.75]),
    ),
    "normal map": (
        textured("normal", "normal3f", "float4 inputs:scale = (2, 2, 2, 1)\nfloat4 inputs:bias = (-1, -1, -1, 0)"),
        lambda a: material(a).normal is not None,
    ),
    "occlusion": ({"surface": "float inputs:occlusion = 0.5"}, lambda a: np.allclose(material(a).occlusion, 0.5)),
    "emission": (
        {"surface": "color3f inputs:emissiveColor = (1, 0.5, 0.25)"},
        lambda a: np.allclose(material(a).emission.max((0, 1)), [1, 0.5, 0.25]),
    ),
    "specular colour": ({"surface": "int inputs:useSpecularWorkflow = 1\ncolor3f inputs:specularColor = (1, 0, 0)"},),
    "vertex colours": (
        {"bound": False, "mesh": "color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)] "
         '(interpolation = "vertex")'},
        lambda a: np.ptp(a.parts[0].colors[:, :3]) > 0.5,
    ),
    "further UV sets": (
        textured("diffuseColor", "color3f", uv="other")
        | {"mesh": "texCoord2f[] primvars:other = [(1, 1), (0, 1), (0, 0), (1, 0)] (interpolation = \"vertex\")"},
        lambda a: np.allclose(a.parts[0].uvs[0], [1, 0]),
    ),
    "texture transforms": (
        {**(moved := textured("diffuseColor", "color3f", source="moved")), "nodes": moved["nodes"] + TRANSFORM},
        lambda a: np.ptp(a.parts[0].uvs, axis=0).min() > 1.9,
    ),
    "clamp and mirror": (
        textured("diffuseColor", "color3f", 'token inputs:wrapS = "clamp"\ntoken inputs:wrapT = "mirror"'),
        lambda a: material(a).lookup("base_color").wraps == ("clamp", "mirror"),
    ),
    "mask": (
        {"surface": "float inputs:opacity = 0.75\nfloat inputs:opacityThreshold = 0.25"},
        lambda a: (material(a).alpha_mode, material(a).alpha_cutoff) == ("MASK", 0.25),
    ),
    "blending": ({"surface": "float inputs:opacity = 0.5"}, lambda a: material(a).alpha_mode == "BLEND"),
    "one-sided faces": (
        {"mesh": "uniform bool doubleSided = 0"}, lambda a: not material(a).double_sided and a.notes == ()
    ),
    "clear coat": (
        {"surface": "float inputs:clearcoat = 0.5"}, lambda a: "KHR_materials_clearcoat" in material(a).lobes
    ),
    "index of refraction": (
        {"surface": "float inputs:ior = 1.33"},
        lambda a: material(a).lobes["KHR_materials_ior"] == {"ior": pytest.approx(1.33)},
    ),
    "copyright, extras": (
        {"layer": 'customLayerData = {\nstring copyright = "me"\n}'}, lambda a: a.metadata == {"copyright": "me"}
    ),
    "instances": (
        {"prims": INSTANCE % ("Again", 2) + INSTANCE % ("Once", 4),
         "classes": 'class Xform "Proto" {\ndef Mesh "Q" {%s}\n}'},
        lambda a: len(a.instances) == 3 and len(a.parts) == 2,
    ),
    "morph targets": (
        {"root": "SkelRoot", "api": '"SkelBindingAPI"',
         "mesh": 'uniform token[] skel:blendShapes = ["up"]\nrel skel:blendShapeTargets = </W/Q/up>',
         "below": 'def BlendShape "up" {\nuniform vector3f[] offsets = [(0, 0, 1)]\n'
                  'uniform int[] pointIndices = [0]\n}'},
    ),
    "animated nodes": (
        {"mesh": "double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 10: (1, 0, 0) }\n"
                 'uniform token[] xformOpOrder = ["xformOp:translate"]'},
    ),
    "skeletons, skins": (
        {"root": "SkelRoot", "api": '"SkelBindingAPI"',
         "mesh": "rel skel:skeleton = </W/S>\n"
                 'int[] primvars:skel:jointIndices = [0, 0, 0, 0] (\ninterpolation = "vertex"\nelementSize = 1)\n'
                 'float[] primvars:skel:jointWeights = [1, 1, 1, 1] (\ninterpolation = "vertex"\nelementSize = 1)',
         "prims": f'def Skeleton "S" {{\nuniform token[] joints = ["a"]\nuniform matrix4d[] bindTransforms = [{ONE}]\n'
                  f"uniform matrix4d[] restTransforms = [{ONE}]\n}}"},
        lambda a: a.rig is not None and a.parts[0].skin is not None,
    ),
    "lights": ({"prims": 'def SphereLight "L" {}'},),
    "cameras": ({"prims": 'def Camera "C" {}'},),
}  # fmt: skip

QUAD = """
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    uniform token subdivisionScheme = "none"
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
"""


def read(folder, name: str) -> Asset:
    (folder / "a.png").write_bytes(png(corner_pixels()))
    more = FEATURES[name][0]
    binding = "rel material:binding = </W/P>" if more.get("bound", True) else ""
    schemas = ", ".join(['"MaterialBindingAPI"', *([more["api"]] if "api" in more else [])])
    (folder / "a.usda").write_text(f"""#usda 1.0
(
    defaultPrim = "W"
    upAxis = "Y"
    {more.get("layer", "")}
)
{more.get("classes", "").replace("%s", QUAD)}
def {more.get("root", "Xform")} "W" {{
    def Mesh "Q" (
        prepend apiSchemas = [{schemas}]
    ) {{
        {QUAD}
        {binding}
        {more.get("mesh", "")}
        {more.get("below", "")}
    }}
    def Material "P" {{
        token outputs:surface.connect = </W/P/surface.outputs:surface>
        def Shader "surface" {{
            uniform token info:id = "UsdPreviewSurface"
            token outputs:surface
            {more.get("surface", "")}
        }}
        {more.get("nodes", "")}
    }}
    {more.get("prims", "")}
}}
""")
    return load_asset(folder / "a.usda")


@pytest.mark.parametrize("name", FEATURES)
def test_a_feature_comes_through_or_is_told(name, tmp_path, monkeypatch):
    monkeypatch.setattr("mi_simplify.formats.usd.read.rehearse", lambda path: None)  # a process each
    asset = read(tmp_path, name)
    told = [note for note in asset.notes if "left out" in note]
    if len(FEATURES[name]) == 1:
        assert len(told) == 1, asset.notes
    else:
        assert FEATURES[name][1](asset), (asset.notes, material(asset))
        assert told == []


def test_the_table_of_the_documentation_says_what_happens():
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([^|]+?) \| [^|]+? \| ([^|]+?) \| [^|]+? \|$", text, re.M)
    column = {name: verdict.split()[0] for name, verdict in rows if name not in ("feature", "---")}
    assert {name for name, verdict in column.items() if verdict != "–"} == set(FEATURES)
    assert {name for name, verdict in column.items() if verdict == "left"} == {
        name for name, row in FEATURES.items() if len(row) == 1
    }
