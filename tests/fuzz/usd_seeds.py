"""
Valid USD files: text, the same as crates, and both in packages.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import containers
from seed import Seed
from support.tiny_models import corner_pixels, png

_USDA = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "World"
{
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]

    def Mesh "Quad" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
        normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0.5), (0, 1, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "faceVarying"
        )
        int[] primvars:st:indices = [0, 1, 2, 0, 2, 3]
        color3f[] primvars:displayColor = [(1, 0, 0)]
        uniform token subdivisionScheme = "none"
        uniform token orientation = "leftHanded"
        int[] holeIndices = []
        rel material:binding = </World/Paint>

        def GeomSubset "half" (
            prepend apiSchemas = ["MaterialBindingAPI"]
        )
        {
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1]
            rel material:binding = </World/Plain>
        }
    }

    def Material "Paint"
    {
        token outputs:surface.connect = </World/Paint/surface.outputs:surface>

        def Shader "surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Paint/color.outputs:rgb>
            float inputs:roughness = 0.25
            float inputs:opacity.connect = </World/Paint/color.outputs:a>
            float inputs:opacityThreshold = 0.5
            token outputs:surface
        }

        def Shader "color"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./image.png@
            float4 inputs:scale = (1, 1, 1, 1)
            token inputs:wrapS = "mirror"
            float2 inputs:st.connect = </World/Paint/move.outputs:result>
            float outputs:a
            float3 outputs:rgb
        }

        def Shader "move"
        {
            uniform token info:id = "UsdTransform2d"
            float inputs:rotation = 90
            float2 inputs:scale = (0.5, 2)
            float2 inputs:in.connect = </World/Paint/st.outputs:result>
            float2 outputs:result
        }

        def Shader "st"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }
    }

    def Material "Plain"
    {
        token outputs:surface.connect = </World/Plain/surface.outputs:surface>

        def Shader "surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0, 0, 1)
            token outputs:surface
        }
    }
}
"""

_PLACED_USDA = """#usda 1.0
(
    upAxis = "Y"
    subLayers = [
        @./below.usda@
    ]
)

def Xform "Prototype"
{
    def Mesh "Quad"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points.timeSamples = {
            0: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
            1: [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)],
        }
        color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)] (
            interpolation = "vertex"
        )
        float[] primvars:displayOpacity = [0.5]
    }
}

def Xform "Copy" (
    instanceable = true
    prepend references = </Prototype>
)
{
    matrix4d xformOp:transform = ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (3, 0, 0, 1) )
    uniform token[] xformOpOrder = ["xformOp:transform"]
}

def Xform "Other" (
    prepend payload = @./below.usda@</Below>
    variants = {
        string look = "red"
    }
    prepend variantSets = "look"
)
{
    variantSet "look" = {
        "red" {
            color3f[] primvars:displayColor = [(1, 0, 0)]
        }
    }
}

def PointInstancer "Many"
{
    point3f[] positions = [(0, 0, 0), (10, 0, 0), (20, 0, 0)]
    int[] protoIndices = [0, 0, 0]
    quath[] orientations = [(1, 0, 0, 0), (1, 0, 0, 0), (0, 1, 0, 0)]
    float3[] scales = [(1, 1, 1), (2, 2, 2), (1, 1, 1)]
    int64[] invisibleIds = [2]
    rel prototypes = </Many/Leaf>

    def Mesh "Leaf"
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
        uniform token purpose = "default"
    }
}

def SkelRoot "Root"
{
    def Skeleton "Skeleton"
    {
        uniform token[] joints = ["hip"]
        uniform matrix4d[] bindTransforms = [( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )]
        uniform matrix4d[] restTransforms = [( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 9, 0, 1) )]
    }

    def Mesh "Skin" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 5), (1, 0, 5), (1, 1, 5)]
        int[] primvars:skel:jointIndices = [0, 0, 0] (
            elementSize = 1
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = [1, 1, 1] (
            elementSize = 1
            interpolation = "vertex"
        )
        matrix4d primvars:skel:geomBindTransform = ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 3, 1) )
        rel skel:skeleton = </Root/Skeleton>
    }
}
"""

_BELOW_USDA = """#usda 1.0

def Mesh "Below"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, -3), (1, 0, -3), (1, 1, -3)]
}
"""


def usd_seeds() -> list[Seed]:
    """
    Kinds ``usda``, ``usdc`` and ``usdz``.
    """
    image = png(corner_pixels())
    whole, placed, below = _USDA.encode(), _PLACED_USDA.encode(), _BELOW_USDA.encode()
    crates = _crates(whole, placed.replace(b"below.usda", b"below.usdc"), below)
    packages = [
        {"a.usda": whole, "image.png": image}, {"a.usdc": crates[0], "image.png": image},
        {"a.usda": placed, "below.usda": below}, {"a.usdc": crates[1], "below.usdc": crates[2]},
    ]  # fmt: skip
    return [
        Seed("usda", "a.usda", "a.usda", {"a.usda": whole, "image.png": image}),
        Seed("usda", "a.usda", "a.usda", {"a.usda": placed, "below.usda": below}),
        Seed("usda", "below.usda", "a.usda", {"a.usda": placed, "below.usda": below}),
        Seed("usdc", "a.usdc", "a.usdc", {"a.usdc": crates[0], "image.png": image}),
        Seed("usdc", "a.usdc", "a.usdc", {"a.usdc": crates[1], "below.usdc": crates[2]}),
        Seed("usdc", "below.usdc", "a.usdc", {"a.usdc": crates[1], "below.usdc": crates[2]}),
        *(Seed("usdz", "a.usdz", "a.usdz", {"a.usdz": containers.zipped([*p.items()])}) for p in packages),
    ]


_EXPORT = "import sys; from pxr import Sdf; Sdf.Layer.FindOrOpen(sys.argv[1]).Export(sys.argv[2])"


def _crates(*texts: bytes) -> list[bytes]:
    """Layers in USD's binary form; made in other processes, since USD starts threads and the fuzzer forks."""
    out = []
    with tempfile.TemporaryDirectory() as folder:
        text, crate = Path(folder, "a.usda"), Path(folder, "a.usdc")
        for content in texts:
            text.write_bytes(content)
            subprocess.run([sys.executable, "-c", _EXPORT, str(text), str(crate)], check=True)
            out.append(crate.read_bytes())
    return out
