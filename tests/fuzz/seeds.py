"""
Small valid inputs of every kind, which are then damaged.
"""

from __future__ import annotations

import functools
import io
import json
import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image
from scene_seeds import scene_seeds
from seed import Seed
from support.tiny_models import QUAD, QUAD_ST, Glb, corner_pixels, png
from usd_seeds import usd_seeds

ROOT = Path(__file__).resolve().parents[2]


@functools.cache
def seeds() -> list[Seed]:
    """
    All inputs, the same every time.
    """
    return [*_obj(), *_ply(), *_stl(), *_gltf(), *usd_seeds(), *scene_seeds(), *_images(), *_yaml()]


_IMAGE = png(corner_pixels())

_MTL = (
    b"newmtl paint\nKd 0.1 0.2 0.3\nd 0.5\nPr 0.25\nPm 1\nmap_Kd -o 0 0 0 -s 1 1 1 image.png\nmap_Pr image.png\n"
    b"norm image.png\nbump -bm 0.5 image.png\nmap_d image.png\nnewmtl plain\nKd 1 0 0\nTr 0.25\nKs 1 1 1\nNs 100\n"
)

_TEXTURED_OBJ = (
    b"mtllib quad.mtl\no first\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    b"vn 0 0 1\nvn 0 0.6 0.8\nusemtl paint\nf 1/1/1 2/2/1 3/3/2 4/4/1\no second\nusemtl plain\nf -5/-4 -4/-3 -1/-2\n"
    b"f 2//1 3//1 5//2 # comment\nl 1 2 3\np 4\n"
)


def _obj() -> list[Seed]:
    ball = _ball()
    plain = "".join(f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in ball[0])
    colored = "".join(f"v {x:.5f} {y:.5f} {z:.5f} 0.5 {abs(y):.3f} 1\n" for x, y, z in ball[0])
    faces = "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in ball[1])
    with_textures = {"quad.obj": _TEXTURED_OBJ, "quad.mtl": _MTL, "image.png": _IMAGE}
    return [
        Seed("obj", "quad.obj", "quad.obj", with_textures),
        Seed("obj", "a.obj", "a.obj", {"a.obj": (plain + faces).encode()}),
        Seed("obj", "a.obj", "a.obj", {"a.obj": (colored + faces).encode()}),
        Seed("mtl", "quad.mtl", "quad.obj", with_textures),
    ]


def _ball() -> tuple[np.ndarray, np.ndarray]:
    """An octahedron split once: 18 positions, 32 faces."""
    v = [tuple(s * np.eye(3)[k]) for k in range(3) for s in (1, -1)]
    f = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    index = {p: i for i, p in enumerate(v)}
    out = []
    for tri in f:
        corner = [np.array(v[i]) for i in tri]
        mid = [(corner[i] + corner[(i + 1) % 3]) / np.sqrt(2) for i in range(3)]
        m = [index.setdefault(tuple(np.round(p, 6)), len(index)) for p in mid]
        a, b, c = tri
        out += [(a, m[0], m[2]), (m[0], b, m[1]), (m[2], m[1], c), tuple(m)]
    return np.array(list(index)), np.array(out)


def _ply() -> list[Seed]:
    positions, faces = _ball()
    header = (
        "element vertex 18\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\n"
        "property float ny\nproperty float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "property uchar alpha\nelement face 32\nproperty uchar flag\nproperty list uchar int vertex_indices\n"
        "end_header\n"
    )
    wedges = (
        "comment TextureFile image.png\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
        "element face 2\nproperty list uchar int vertex_index\nproperty list uchar float texcoord\nend_header\n"
    )
    uvs = [[*QUAD_ST[[0, 1, 2]].ravel()], [*QUAD_ST[[0, 2, 3]].ravel()]]
    out = []
    text = "".join(f"{x:.4f} {y:.4f} {z:.4f} {x:.4f} {y:.4f} {z:.4f} 255 128 0 255\n" for x, y, z in positions)
    text += "".join(f"7 3 {a} {b} {c}\n" for a, b, c in faces)
    out.append(("ply", "format ascii 1.0\n" + header + text, b""))
    text = "".join(f"{x} {y} {z}\n" for x, y, z in QUAD)
    text += "".join(f"3 {f} 6 {' '.join(map(str, uv))}\n" for f, uv in zip(("0 1 2", "0 2 3"), uvs, strict=True))
    out.append(("ply", "format ascii 1.0\n" + wedges + text, b""))
    for order, name in (("<", "little"), (">", "big")):
        body = b"".join(struct.pack(f"{order}6f4B", *p, *p, 255, 128, 0, 255) for p in positions)
        body += b"".join(struct.pack(f"{order}BB3i", 7, 3, *f) for f in faces)
        out.append(("ply-binary", f"format binary_{name}_endian 1.0\n" + header, body))
        body = QUAD.astype(order + "f8").tobytes()
        for f, uv in zip(([0, 1, 2], [0, 2, 3]), uvs, strict=True):
            body += struct.pack(f"{order}B3iB6f", 3, *f, 6, *uv)
        out.append(("ply-binary", f"format binary_{name}_endian 1.0\n" + wedges, body))
    return [
        Seed(kind, "a.ply", "a.ply", {"a.ply": b"ply\n" + head.encode() + body, "image.png": _IMAGE})
        for kind, head, body in out
    ]


def _stl() -> list[Seed]:
    positions, faces = _ball()
    binary = bytes(80) + struct.pack("<I", len(faces))
    text = "solid ball\n"
    for f in faces:
        binary += struct.pack("<12fH", 0, 0, 1, *positions[f].ravel(), 0)
        corners = "".join("vertex {:.4f} {:.4f} {:.4f}\n".format(*p) for p in positions[f])
        text += f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"
    return [
        Seed("stl-binary", "a.stl", "a.stl", {"a.stl": binary}),
        Seed("stl", "a.stl", "a.stl", {"a.stl": (text + "endsolid\n").encode()}),
    ]


def _gltf() -> list[Seed]:
    textured, skinned, placed = Glb(), Glb(), Glb()
    color, orm = textured.texture(corner_pixels()), textured.texture(np.uint8([[[0, 128, 64]]]))
    transform = {"KHR_texture_transform": {"offset": [0.5, 0], "rotation": 0.5, "scale": [2, 1]}}
    textured.material(
        name="paint",
        pbrMetallicRoughness={
            "baseColorTexture": {"index": color, "extensions": transform}, "baseColorFactor": [1, 0.5, 0.5, 0.5],
            "metallicRoughnessTexture": {"index": orm, "extensions": transform}, "roughnessFactor": 0.5,
        },
        normalTexture={"index": orm, "scale": 0.5, "extensions": transform}, alphaMode="MASK", alphaCutoff=0.25,
        extensions={"KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [0.2, 0.3, 0.4]}},
        emissiveFactor=[0, 0, 1],
    )  # fmt: skip
    colors = textured.accessor(np.full((4, 4), 128, np.uint8), normalized=True)
    textured.mesh(textured.quad(0, NORMAL=np.tile(np.float32([0, 0, 1]), (4, 1)), COLOR_0=colors))

    ball, faces = _ball()
    weights = np.tile(np.float32([0.75, 0.25, 0, 0]), (len(ball), 1))
    joints = np.tile(np.uint8([0, 1, 0, 0]), (len(ball), 1))
    attributes = {"POSITION": skinned.accessor(np.float32(ball)), "JOINTS_0": skinned.accessor(joints)}
    attributes["WEIGHTS_0"] = skinned.accessor(weights)
    indices = skinned.accessor(faces.ravel().astype("u2"))
    skinned.mesh({"attributes": attributes, "indices": indices, "targets": [{"POSITION": attributes["POSITION"]}]})
    inverse = skinned.accessor(np.tile(np.eye(4, dtype="f4").reshape(1, 16), (2, 1)))
    skinned.json["skins"] = [{"joints": [1, 2], "inverseBindMatrices": inverse}]
    skinned.nodes(
        {"mesh": 0, "skin": 0}, {"children": [2], "translation": [0, 1, 0]},
        {"rotation": [0, 0, 0, 1], "scale": [1, 2, 1]},
    )  # fmt: skip
    skinned.json["animations"] = [{}]

    primitive = placed.quad()
    strip = {"attributes": {"POSITION": placed.accessor(np.float32(QUAD[[0, 1, 3, 2]]))}, "mode": 5}
    sparse = placed.accessor(np.float32(QUAD))
    placed.json["accessors"][sparse]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": placed.view(struct.pack("<H", 2)), "componentType": 5123},
        "values": {"bufferView": placed.view(struct.pack("<3f", 1, 1, 1))},
    }
    placed.mesh(primitive, strip, {"attributes": {"POSITION": sparse}, "mode": 6})
    offsets = placed.accessor(np.float32([[0, 0, 0], [2, 0, 0], [4, 0, 0]]))
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": offsets}}}
    placed.nodes(
        {"children": [1, 2], "matrix": [*np.eye(4).ravel()]}, {"mesh": 0, "extensions": instancing},
        {"mesh": 0, "scale": [-1, 1, 1], "translation": [0, 3, 0], "children": [3]}, {"mesh": 0},
    )  # fmt: skip
    separate = {**textured.json, "buffers": [{"byteLength": len(textured.binary), "uri": "buffer.bin"}]}
    separate["images"] = [{"uri": "image.png"}, {"uri": "image.png"}]
    files = {"a.gltf": json.dumps(separate, indent=1).encode(), "buffer.bin": textured.binary, "image.png": _IMAGE}
    models = [Seed("glb", "a.glb", "a.glb", {"a.glb": g.bytes()}) for g in (textured, skinned, placed)]
    return [*models, Seed("gltf", "a.gltf", "a.gltf", files)]


def _images() -> list[Seed]:
    pixels = corner_pixels()
    palette = Image.fromarray(pixels).quantize(4)
    grey = Image.fromarray(np.arange(64, dtype=np.uint16).reshape(8, 8) * 1000)
    images = {
        "png": [
            _IMAGE, png(np.concatenate([pixels, pixels[..., :1]], 2)), png(pixels[..., 0]),
            _encoded(palette, "PNG", transparency=0), _encoded(grey, "PNG"),
        ],
        "png-deep": [_deep_png(pixels.astype(np.uint16) * 257)],
        "image": [
            _encoded(Image.fromarray(pixels), kind) for kind in ("JPEG", "WEBP", "TIFF", "TGA", "BMP", "GIF")
        ] + [b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 2\n" + bytes(range(100, 116))],
    }  # fmt: skip
    files = {"quad.obj": _TEXTURED_OBJ, "quad.mtl": _MTL}
    return [
        Seed(kind, "image.png", "quad.obj", {**files, "image.png": data})
        for kind, alike in images.items()
        for data in alike
    ]


def _encoded(image: Image.Image, kind: str, **options: int) -> bytes:
    out = io.BytesIO()
    image.save(out, kind, **options)
    return out.getvalue()


def _deep_png(pixels: np.ndarray) -> bytes:
    """A PNG of 16 bits a channel, which Pillow cannot write."""
    height, width, n = pixels.shape
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels)
    header = struct.pack(">2I5B", width, height, 16, {3: 2, 4: 6}[n], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)))
    out = b"\x89PNG\r\n\x1a\n"
    for kind, body in (*chunks, (b"IEND", b"")):
        out += struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    return out


_EVERY_KEY = """preset: fast
asset: &a sample:relic
seed: 3
reference: {transport: baked, spp: 4, max_depth: 3, pool: 16, refresh: 1, environment: light.exr}
initial:
  kind: decimate
  triangles: 500
  atlas_size: 128
latent:
  optimize: [vertices, base_color]
  min_roughness: 1e-1
views: {distance: 4.0, jitter: 0.1, fov: 30, light: {exponent: 0, irradiance: 2}}
optimizer:
  steps: 10
  resolution: [32, 64]
  rates: {vertices: .01}
loss: {image: l1, laplacian: {weight: 0.5}}
evaluation: {views: 2}
export: {formats: [glb, obj], checkpoint: 5.0}
"""


def _yaml() -> list[Seed]:
    files = [path.read_bytes() for path in sorted((ROOT / "scenes").glob("*.yaml"))]
    texts = [_EVERY_KEY.encode(), *(text for text in files if b"\nasset:" in text)]  # others are no jobs
    return [Seed("yaml", "job.yaml", "job.yaml", {"job.yaml": text}) for text in texts]
