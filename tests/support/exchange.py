"""Files of exchange formats as text: Collada, FBX, STEP."""

import numpy as np


def _numbers(values) -> str:
    return " ".join(f"{x:.9g}" for x in np.ravel(values))


def collada(points, polygons, uvs, *, unit=1.0, up="Y_UP", diffuse="<color>1 1 1 1</color>", more="", effect="") -> str:
    """One mesh of polygons, a corner's texture coordinates those of its point; ``diffuse`` of its Phong material."""
    corners = [k for polygon in polygons for k in polygon]
    source = '<source id="{0}"><float_array id="{0}a" count="{1}">{2}</float_array><technique_common><accessor source="#{0}a" count="{3}" stride="{4}">{5}</accessor></technique_common></source>'  # noqa: E501

    def array(name, values, axes):
        parameters = "".join(f'<param name="{axis}" type="float"/>' for axis in axes)
        return source.format(name, np.size(values), _numbers(values), len(values), len(axes), parameters)

    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="u" meter="{unit}"/><up_axis>{up}</up_axis></asset>
<library_images><image id="i"><init_from>a.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="f"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="s"><sampler2D><source>f</source></sampler2D></newparam>
<technique sid="t"><phong><diffuse>{diffuse}</diffuse>{effect}</phong></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="m" name="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>{array("p", points, "XYZ")}{array("t", uvs, "ST")}
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="{len(polygons)}" material="x"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="0" set="0"/><vcount>{" ".join(str(len(p)) for p in polygons)}</vcount>
<p>{" ".join(map(str, corners))}</p></polylist></mesh></geometry></library_geometries>{more}
<library_visual_scenes><visual_scene id="w"><node id="n" name="n"><translate>0 0 7</translate>
<instance_geometry url="#g">
<bind_material><technique_common><instance_material symbol="x" target="#m"/></technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene>
</COLLADA>
"""


def fbx(points, polygons, uvs, more: str = "") -> str:
    """One mesh of polygons in FBX's text form, a corner's texture coordinates those of its point."""
    index = [-k - 1 if k == polygon[-1] else k for polygon in polygons for k in polygon]
    corners = [k for polygon in polygons for k in polygon]

    def array(values) -> str:
        values = np.ravel(values)
        return f"*{len(values)} {{\n a: {','.join(f'{x:.9g}' for x in values)}\n}}"

    return f"""; FBX 7.3.0 project file
FBXHeaderExtension:  {{
    FBXHeaderVersion: 1003
    FBXVersion: 7300
}}
Objects:  {{
    Geometry: 10, "Geometry::g", "Mesh" {{
        Vertices: {array(points)}
        PolygonVertexIndex: {array(index)}
        LayerElementUV: 0 {{
            Name: "uv"
            MappingInformationType: "ByPolygonVertex"
            ReferenceInformationType: "Direct"
            UV: {array(np.asarray(uvs)[corners])}
        }}
        LayerElementMaterial: 0 {{
            MappingInformationType: "AllSame"
            ReferenceInformationType: "IndexToDirect"
            Materials: *1 {{
 a: 0
}}
        }}
        Layer: 0 {{
            LayerElement:  {{
                Type: "LayerElementMaterial"
                TypedIndex: 0
            }}
            LayerElement:  {{
                Type: "LayerElementUV"
                TypedIndex: 0
            }}
        }}
    }}
    Model: 20, "Model::n", "Mesh" {{
        Properties70:  {{
            P: "Lcl Translation", "Lcl Translation", "", "A",0,0,7
        }}
    }}
    Material: 30, "Material::m", "" {{
        ShadingModel: "phong"
        Properties70:  {{
            P: "DiffuseColor", "Color", "", "A",1,0.5,0
            P: "EmissiveColor", "Color", "", "A",0,0,0.5
            P: "EmissiveFactor", "Number", "", "A",1
        }}
    }}
    {more}
}}
Connections:  {{
    C: "OO",20,0
    C: "OO",10,20
    C: "OO",30,20
}}
"""


def step(points, faces) -> str:
    """A closed solid of planar triangles, in millimetres, as STEP AP214."""
    points = np.asarray(points, float)
    lines: list[str] = []

    def add(text: str) -> str:
        lines.append(f"#{len(lines) + 1}={text};")
        return f"#{len(lines)}"

    def triple(kind: str, v) -> str:
        return add(f"{kind}('',({','.join(f'{x:.9E}' for x in v)}))")

    corner = [add(f"VERTEX_POINT('',{triple('CARTESIAN_POINT', p)})") for p in points]
    edges: dict[tuple[int, int], str] = {}

    def oriented(a: int, b: int) -> str:
        low, high = min(a, b), max(a, b)
        if (low, high) not in edges:
            way = points[high] - points[low]
            vector = add(f"VECTOR('',{triple('DIRECTION', way / np.linalg.norm(way))},1.)")
            line = add(f"LINE('',{triple('CARTESIAN_POINT', points[low])},{vector})")
            edges[low, high] = add(f"EDGE_CURVE('',{corner[low]},{corner[high]},{line},.T.)")
        return add(f"ORIENTED_EDGE('',*,*,{edges[low, high]},.{'T' if a < b else 'F'}.)")

    sides = []
    for a, b, c in faces:
        loop = add(f"EDGE_LOOP('',({oriented(a, b)},{oriented(b, c)},{oriented(c, a)}))")
        bound = add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        x, normal = points[b] - points[a], np.cross(points[b] - points[a], points[c] - points[a])
        at = f"{triple('CARTESIAN_POINT', points[a])},{triple('DIRECTION', normal)},{triple('DIRECTION', x)}"
        place = add(f"AXIS2_PLACEMENT_3D('',{at})")
        plane = add(f"PLANE('',{place})")
        sides.append(add(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    shell = add(f"CLOSED_SHELL('',({','.join(sides)}))")
    solid = add(f"MANIFOLD_SOLID_BREP('solid',{shell})")
    length = add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    angle = add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    round_ = add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    close = add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-06),{length},'d','c')")
    context = add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)"
        f"GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({close}))GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{round_}))"
        "REPRESENTATION_CONTEXT('',''))"
    )
    shape = add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({solid}),{context})")
    application = add("APPLICATION_CONTEXT('automotive design')")
    context_of_product = add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    product = add(f"PRODUCT('thing','thing','',({context_of_product}))")
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    of_definition = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',{formation},{of_definition})")
    whole = add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    add(f"SHAPE_DEFINITION_REPRESENTATION({whole},{shape})")
    head = "FILE_DESCRIPTION((''),'2;1');FILE_NAME('','',(''),(''),'','','');FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));"
    return f"ISO-10303-21;\nHEADER;\n{head}\nENDSEC;\nDATA;\n" + "\n".join(lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"
