"""GLB files in fewer bytes: order, integers, compression; what each variant loses, and that others can read it."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from support.tiny_meshes import charted_sphere

from mi_simplify.config.schema import GlbSettings
from mi_simplify.export import write_glb
from mi_simplify.formats.gltf.order import ordered
from mi_simplify.formats.gltf.quantize import Grid, directions, shares
from mi_simplify.formats.gltf.write import glb_bytes
from mi_simplify.formats.load import load_asset
from mi_simplify.model.model import Model

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
