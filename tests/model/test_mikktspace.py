"""Vertex tangents against the original MikkTSpace: recorded, and live where node has the package."""

import json

import numpy as np
from support.paths import ROOT

from mi_simplify.model.mesh import Mesh
from mi_simplify.model.tangents import split_mirrored, vertex_tangents
from mi_simplify.model.topology import vertex_normals

RECORDED = ROOT / "tests" / "data" / "mikktspace.json"


def recorded() -> tuple[Mesh, np.ndarray]:
    """
    A curved sheet with a mirrored and an unmirrored chart and one fold, and MikkTSpace's corner tangents (F, 3, 4).
    """
    data = json.loads(RECORDED.read_text())
    mesh = Mesh(
        np.array(data["positions"]),
        np.array(data["position_index"]),
        np.float32(data["uvs"]),
        np.array(data["faces"]),
    )
    return mesh, np.array(data["tangents"])


def corner_tangents(mesh: Mesh) -> np.ndarray:
    """Tangent and sign of every corner, shape (F, 3, 4)."""
    mesh = split_mirrored(mesh)
    tangents, w = vertex_tangents(mesh, vertex_normals(mesh.positions, mesh.position_faces))
    return np.concatenate([tangents, w[:, None]], axis=1)[mesh.faces]


def degrees_apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between vectors of about unit length [degrees]."""
    return 2 * np.degrees(np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def test_equals_recorded_mikktspace():
    mesh, expected = recorded()
    ours = corner_tangents(mesh)
    assert {-1.0, 1.0} == set(expected[..., 3].ravel())
    np.testing.assert_array_equal(ours[..., 3], expected[..., 3])
    assert degrees_apart(ours[..., :3], expected[..., :3]).max() < 0.05


def test_equals_mikktspace_on_a_turning_random_surface(node_run):
    rng = np.random.default_rng(11)
    n = 12
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    theta, phi = 5.5 * u, 0.3 + 2.4 * v
    ring = np.sin(phi)
    positions = np.stack([np.cos(theta) * ring, np.cos(phi), np.sin(theta) * ring], -1)
    positions *= 1 + 0.2 * rng.normal(size=(*u.shape, 1))
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    uvs = np.stack([u, v], -1).reshape(-1, 2) + 0.1 / n * rng.normal(size=((n + 1) ** 2, 2))
    mesh = Mesh(positions.reshape(-1, 3), index.ravel(), uvs.astype(np.float32), faces)

    normals = vertex_normals(mesh.positions, mesh.position_faces)
    corners = {
        "p": mesh.vertices[faces].astype(np.float32).ravel().tolist(),
        "n": normals[mesh.position_index][faces].astype(np.float32).ravel().tolist(),
        "t": (mesh.uvs[faces] * [1, -1] + [0, 1]).astype(np.float32).ravel().tolist(),  # v up
    }
    script = """
        const {generateTangents} = require('mikktspace');
        const d = JSON.parse(require('fs').readFileSync(0));
        const [p, n, t] = [d.p, d.n, d.t].map(x => new Float32Array(x));
        console.log(JSON.stringify(Array.from(generateTangents(p, n, t))));
    """
    expected = np.array(json.loads(node_run("mikktspace", script, json.dumps(corners)))).reshape(-1, 3, 4)
    ours = corner_tangents(mesh)
    np.testing.assert_array_equal(ours[..., 3], expected[..., 3])
    assert degrees_apart(ours[..., :3], expected[..., :3]).max() < 0.1
