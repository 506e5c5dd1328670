"""
Valid Mitsuba scenes, with a mesh, a texture and an included file beside them.
"""

from __future__ import annotations

from seed import Seed
from support.tiny_models import corner_pixels, png

_SHAPES = b"""<scene version="3.0.0">
  <default name="radius" value="0.5"/>
  <integrator type="path"><integer name="max_depth" value="3"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/><rfilter type="box"/></film>
  </sensor>
  <emitter type="point"><point name="position" x="0" y="2" z="3"/><rgb name="intensity" value="10, 9, 8"/></emitter>
  <bsdf type="principled" id="paint">
    <texture type="bitmap" name="base_color">
      <string name="filename" value="image.png"/>
      <transform name="to_uv"><scale x="2" y="0.5"/><translate x="0.25"/></transform>
    </texture>
    <float name="roughness" value="0.4"/>
    <float name="metallic" value="0.5"/>
  </bsdf>
  <shape type="sphere">
    <float name="radius" value="$radius"/>
    <transform name="to_world"><scale x="-1" y="2" z="1"/><translate x="3"/></transform>
    <ref id="paint"/>
  </shape>
  <shape type="rectangle">
    <boolean name="flip_normals" value="true"/>
    <bsdf type="twosided"><bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf></bsdf>
  </shape>
  <shape type="cube"><transform name="to_world"><rotate y="1" angle="30"/></transform></shape>
  <include filename="more.xml"/>
</scene>"""

_MORE = b"""<scene version="3.0.0">
  <shape type="ply" id="ball">
    <string name="filename" value="quad.ply"/>
    <bsdf type="mask">
      <float name="opacity" value="0.5"/>
      <bsdf type="diffuse"><texture type="checkerboard" name="reflectance"/></bsdf>
    </bsdf>
  </shape>
  <shape type="shapegroup" id="pair">
    <shape type="cylinder"><point name="p0" value="0, 0, 0"/><point name="p1" value="0, 0, 1"/></shape>
    <shape type="disk"/>
  </shape>
  <shape type="instance"><ref id="pair"/><transform name="to_world"><translate value="10"/></transform></shape>
  <shape type="instance">
    <ref id="pair"/>
    <transform name="to_world"><matrix value="1 0 0 5 0 2 0 0 0 0 1 0 0 0 0 1"/></transform>
  </shape>
</scene>"""

_MESHES = b"""<scene version="3.0.0">
  <shape type="obj">
    <string name="filename" value="quad.obj"/>
    <bsdf type="bumpmap">
      <texture type="bitmap"><string name="filename" value="image.png"/><boolean name="raw" value="true"/></texture>
      <bsdf type="dielectric"/>
    </bsdf>
  </shape>
  <shape type="ply">
    <string name="filename" value="quad.ply"/>
    <boolean name="face_normals" value="true"/>
    <bsdf type="normalmap">
      <texture type="bitmap" name="normalmap"><string name="filename" value="image.png"/></texture>
      <bsdf type="ggx_gamma"><rgb name="base_color" value="1, 0.5, 0"/></bsdf>
    </bsdf>
  </shape>
</scene>"""

_PLY = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float nx
property float ny
property float nz
property float u
property float v
property uchar r
property uchar g
property uchar b
element face 2
property list uchar int vertex_indices
end_header
0 0 0 0 0 1 0 0 255 0 0
1 0 0 0 0 1 1 0 0 255 0
1 1 0 0 0 1 1 1 0 0 255
0 1 0 0 0 1 0 1 9 9 9
3 0 1 2
3 0 2 3
"""

_OBJ = b"""v 0 0 2
v 1 0 2
v 1 1 2
v 0 1 2
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
f 1/1/1 2/2/1 3/3/1
f 1/1/1 3/3/1 4/2/1
"""


def scene_seeds() -> list[Seed]:
    """
    Kinds ``xml`` and, for meshes that Mitsuba itself reads, ``xml-mesh``.
    """
    beside = {"image.png": png(corner_pixels()), "quad.ply": _PLY, "quad.obj": _OBJ}
    shapes, meshes = {"a.xml": _SHAPES, "more.xml": _MORE, **beside}, {"a.xml": _MESHES, **beside}
    return [
        Seed("xml", "a.xml", "a.xml", shapes),
        Seed("xml", "more.xml", "a.xml", shapes),
        Seed("xml", "a.xml", "a.xml", meshes),
        Seed("xml-mesh", "quad.ply", "a.xml", meshes),
        Seed("xml-mesh", "quad.obj", "a.xml", meshes),
    ]
