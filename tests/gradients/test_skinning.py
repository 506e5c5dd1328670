"""Gradients of skinned characters: of bind positions and of weights, of the operation alone and through the image."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.latent.latent import Latent
from mi_simplify.latent.surface import MeshTopology
from mi_simplify.machine.upload import upload
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.model import Model
from mi_simplify.model.rig import deform, normal_matrices, turn
from mi_simplify.model.rigging import Rigging
from mi_simplify.scenes.samples.catalogue import sample_asset
from mi_simplify.scenes.views import Views, look_at

FRAME = 6


@pytest.fixture(scope="module")
def character() -> Model:
    """A leg of the sample, with the weights of all joints blurred."""
    asset = sample_asset("walker:2000")
    (k,) = (k for k, part in enumerate(asset.parts) if part.name == "leg_l")
    part = asset.placed()[k]
    used = np.unique(part.faces)
    positions, index = np.unique(np.round(part.vertices[used], 9), axis=0, return_inverse=True)
    faces = np.searchsorted(used, part.faces)
    mesh = Mesh(positions, index.reshape(-1), part.uvs[used], faces)
    weights = np.zeros((len(positions), len(asset.rig.names)), np.float32)
    weights[index.reshape(-1)] = part.skin.taken(used).matrix(len(asset.rig.names)).toarray()
    weights = 0.97 * weights + 0.03 / weights.shape[1]
    image = np.random.default_rng(1).random((16, 16, 4), np.float32)
    flat = np.zeros((16, 16, 3), np.float32)
    flat[..., 2] = 1
    specular = np.zeros((16, 16, 3), np.float32)
    specular[..., 1] = 0.6
    boxes = np.zeros((asset.rig.n_frames + 1, 2, 3))
    return Model(mesh, image, specular, flat, skin=Rigging(weights, asset.rig, boxes, np.arange(24), 8))


def shot(size: int = 8) -> Views:
    return look_at(
        [1.6, 0.6, 1.2],
        [0.1, 0.5, 0],
        [1.5, 2, 1.5],
        width=size,
        height=size,
        fov=50,
        frame=float(FRAME),
        irradiance=np.pi,
    )


def noise_of(values: list[float]) -> float:
    """Standard error of their mean."""
    return float(np.std(values) / np.sqrt(len(values)))


def softmax(logits: np.ndarray) -> np.ndarray:
    e = np.exp(logits)
    return e / e.sum(1, keepdims=True)


def test_the_surface_is_that_of_numpy(character):
    """Positions, normals and tangents of the operation against linear blend skinning as files have it."""
    latent = Latent(character)
    base = upload(mi.Float, latent.operation.base.positions.ravel())
    parameters = {"skinning": upload(mi.Float, latent.operation.parameters["skinning"])}
    positions = latent.operation.positions(base, parameters, shot())
    packets = latent.evaluate(positions, base, parameters, shot()).packets.numpy().reshape(-1, 3, 4)
    rig, skin = character.skin.rig, character.skin.skin()
    moved = deform(character.mesh.positions, skin, rig.matrices(FRAME))
    np.testing.assert_allclose(positions.numpy().reshape(-1, 3), moved, atol=1e-5)
    mesh = latent.topology.mesh
    np.testing.assert_allclose(packets[:, 0, :3], moved[mesh.position_index], atol=1e-5)
    own = skin.taken(mesh.position_index)
    normals = turn(mesh.normals()[mesh.normal_groups], own, normal_matrices(rig.matrices(FRAME)))
    np.testing.assert_allclose(packets[:, 1, :3], normals, atol=1e-4)
    np.testing.assert_allclose((packets[:, 1, :3] * packets[:, 2, :3]).sum(1), 0, atol=1e-5)
    rest = MeshTopology(mesh).surface(base).packets.numpy().reshape(-1, 3, 4)
    np.testing.assert_array_equal(packets[:, :, 3], rest[:, :, 3])  # texture coordinates and handedness


@pytest.mark.parametrize("name", ["vertices", "skinning"])
def test_positions_follow_weights_and_bind_positions(character, name):
    """Every direction drawn agrees with central differences in float64 within 0.1 %."""
    operation, rng = Latent(character).operation, np.random.default_rng(2)
    logits, bind = operation.parameters["skinning"].reshape(len(operation.base.positions), -1), operation.base.positions
    target = rng.normal(size=bind.shape)
    flat = character.skin.rig.matrices(FRAME)[:, :3].reshape(-1, 12)

    def value(p: np.ndarray, x: np.ndarray) -> float:
        m = (softmax(x) @ flat).reshape(-1, 3, 4)
        return float(((np.einsum("pij,pj->pi", m[..., :3], p) + m[..., 3]) * target).sum())

    base, leaf = upload(mi.Float, bind.ravel()), upload(mi.Float, logits.ravel())
    dr.enable_grad(base, leaf)
    dr.backward(dr.sum(operation.positions(base, {"skinning": leaf}, shot()) * upload(mi.Float, target.ravel())))
    found = dr.grad(base if name == "vertices" else leaf).numpy().astype(np.float64)
    for _ in range(3):
        d = rng.normal(size=bind.shape if name == "vertices" else logits.shape)
        step = [(1e-6 * d, 0), (-1e-6 * d, 0)] if name == "vertices" else [(0, 1e-6 * d), (0, -1e-6 * d)]
        high, low = (value(bind + p, logits.astype(float) + x) for p, x in step)
        assert found @ d.ravel() == pytest.approx((high - low) / 2e-6, rel=1e-3)


@pytest.mark.parametrize("name", ["vertices", "skinning"])
def test_images_follow_weights_and_bind_positions(character, name):
    """
    The whole image, outlines and normals with it, within 1 % of central differences along smooth directions: the leg
    bends, and it is drawn to another joint.
    """
    latent = Latent(character)
    operation, views = latent.operation, shot(32)
    renderer = DeferredRenderer(latent.topology)
    bind, start = operation.base.positions, operation.parameters["skinning"]
    weight = np.random.default_rng(3).random((1, 32 * 32)).astype("f4")
    if name == "vertices":
        d = np.stack([np.sin(5 * bind[:, 1]), 0.3 * np.cos(4 * bind[:, 1]), 0 * bind[:, 1]], 1).ravel()
        step = 4e-3
    else:
        towards = np.zeros((len(bind), len(character.skin.rig.names)))
        towards[:, character.skin.rig.names.index("shin_l")] = 1 + 0.5 * np.sin(3 * bind[:, 1])
        d, step = towards.ravel(), 0.12

    def image(offset: float, seed: int):
        base = upload(mi.Float, bind.ravel() + (offset * d if name == "vertices" else 0))
        leaf = upload(mi.Float, start + (offset * d if name == "skinning" else 0))
        return base, leaf, lambda: operation.positions(base, {"skinning": leaf}, views)

    def loss(offset: float, seed: int) -> float:
        base, leaf, positions = image(offset, seed)
        moved = positions()
        renderer.move(moved)
        with dr.suspend_grad():
            surface = latent.evaluate(moved, base, {"skinning": leaf}, views)
            frame = renderer.render(surface, latent.textures, views, spp=1024, seed=dr.opaque(mi.UInt32, seed))
        return float((frame.image.numpy() * weight).sum())

    expected = np.mean([(loss(step, s) - loss(-step, s)) / (2 * step) for s in range(24)])
    slopes = []
    for seed in range(160):
        if seed >= 24 and noise_of(slopes) < 0.003 * abs(expected):
            break
        base, leaf, positions = image(0.0, seed)
        dr.enable_grad(base, leaf)
        made = positions()
        rendered = mi.Float(dr.detach(made))
        dr.enable_grad(rendered)
        renderer.move(dr.detach(rendered))
        surface = latent.evaluate(rendered, base, {"skinning": leaf}, views)
        opaque = dr.opaque(mi.UInt32, seed + 50)
        frame = renderer.render(surface, latent.textures, views, spp=256, seed=opaque)
        renderer.backward(
            frame, mi.Vector4f(upload(mi.Float, weight[0])), surface, latent.textures, rendered, opaque + 1000
        )
        dr.set_grad(made, dr.grad(rendered))
        dr.enqueue(dr.ADMode.Backward, made)
        dr.traverse(dr.ADMode.Backward)
        slopes.append(float(dr.grad(base if name == "vertices" else leaf).numpy().astype(np.float64) @ d))
    assert noise_of(slopes) < 0.004 * abs(expected)
    assert np.mean(slopes) == pytest.approx(expected, rel=0.01)
