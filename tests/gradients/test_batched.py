"""
Gradients of the batched renderer against finite differences: a slice here, more under `make slow`, where every scene
and every parameter has its turn; all pairs of both by ``benchmarks/gradient_table.py``.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mi_simplify.model.mesh import Mesh

from . import meshes, scenes
from .batched import Batched
from .cases import SECTIONS, Case
from .finite_difference import along, compare
from .scenes import Scene, film_weights, parameters

#: Each kind of parameter once, here or in the plugin's slices.
_SLICES = {
    "thin tube": ("along normals", "texels roughness"),
    "two objects": ("front object alone", "texels opacity", "texels gamma"),
    "three faces an edge": ("camera position", "texels metallic"),
}


@pytest.mark.parametrize("name", _SLICES)
def test_slice(name):
    pairs = Case(name, name, Batched, _SLICES[name]).measure(spp=256, gradient_spp=32, rounds=(8, 16))
    assert len(pairs) == len(_SLICES[name])
    assert not [str(p) for p in pairs if not p.passes]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("turn", range(len(scenes.NAMES)), ids=scenes.NAMES)
def test_every_scene(turn):
    case = SECTIONS["Batched renderer"]()[turn]
    assert not [str(p) for p in case.measure(turn) if not p.passes]


@pytest.fixture(scope="module")
def two_objects() -> tuple[Scene, Batched, np.ndarray]:
    scene = scenes.scene("two objects")
    return scene, Batched(scene), film_weights(scene, 2)


def test_forward_mode_equals_backward_mode(two_objects):
    scene, renderer, adjoint = two_objects
    gradient = renderer.gradient(adjoint, 4, 5)
    for parameter in parameters(scene, renderer.start):
        image = renderer.derivative(parameter.direction, 4, 5).astype(np.float64)
        assert np.sum(image * adjoint) == pytest.approx(along(gradient, parameter.direction), rel=1e-4), parameter.name


def test_a_gradient_alone_equals_that_of_all(two_objects):
    """Camera, light and textures get theirs whether or not vertices want one too."""
    _, renderer, adjoint = two_objects
    together = renderer.gradient(adjoint, 4, 5)
    for name in ("positions", "camera", "light_position", "light_intensity", "opacity"):
        alone = renderer.gradient(adjoint, 4, 5, attach=(name,))[name]
        scale = np.abs(together[name]).max()
        np.testing.assert_allclose(alone, together[name], atol=1e-4 * scale, err_msg=name)


def test_growing_square():
    """The derivative of a square's coverage by its size is twice its area on the film."""
    h = 0.5
    corners = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])
    uvs = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
    square = Mesh(corners, np.arange(4), uvs, np.array([[0, 1, 2], [0, 2, 3]]))
    camera = {"origin": [[0, 0, -3]], "target": [0.0, 0, 0], "light": [[0, 1, -3]], "fov": 40}
    renderer = Batched(Scene("square", (square,), camera, (60, 40)))
    renderer.start["opacity"][:] = 1
    adjoint = np.zeros(renderer.shape, np.float32)
    adjoint[..., 3] = 1
    gradient = np.mean([renderer.gradient(adjoint, 16, k)["positions"] for k in range(4)], axis=0)
    area = (2 * h * 60 / (2 * 3 * np.tan(np.radians(20)))) ** 2
    assert np.sum(gradient * corners) == pytest.approx(2 * area, rel=0.01)
    # Nearer by dz it grows by 2 dz / 3; sideways it keeps its size.
    assert gradient[:, 2].sum() == pytest.approx(-2 * area / 3, rel=0.01)
    assert abs(gradient[:, :2].sum(0)).max() < 0.01 * area


@pytest.mark.parametrize("where", ["inside out", "camera inside"])
def test_back_faces_in_view(where):
    """Creases count on back faces too where these are seen."""
    scene = scenes.scene("cube")
    mesh = scene.pieces[0]
    if where == "inside out":
        scene = dataclasses.replace(scene, pieces=(dataclasses.replace(mesh, faces=mesh.faces[:, ::-1]),))
    else:
        camera = scene.camera | {"origin": np.array([[0.1, 0.2, -0.3]]), "light": [[0.0, 0.1, 0.0]], "fov": 80}
        scene = dataclasses.replace(scene, camera=camera, step=0.05)
    renderer = Batched(scene)
    wanted = [p for p in parameters(scene, renderer.start) if p.name in ("translation x", "rotation", "scale")]
    adjoint = film_weights(scene, renderer.shape[0])
    pairs = compare(renderer, where, wanted, adjoint, spp=256, gradient_spp=16, rounds=(8, 16))
    assert not [str(p) for p in pairs if p.noise < 0.01 and not p.passes]
    assert any(p.noise < 0.01 for p in pairs)


def test_nothing_in_view():
    scene = scenes.scene("cube")
    piece = dataclasses.replace(scene.pieces[0], positions=scene.pieces[0].positions + [100, 0, 0])
    renderer = Batched(dataclasses.replace(scene, pieces=(piece,)))
    adjoint = np.ones(renderer.shape, np.float32)
    assert np.abs(renderer.image(renderer.start, 4, 0)).max() == 0
    gradient = renderer.gradient(adjoint, 4, 0, attach=("positions", "camera"))
    assert np.abs(gradient["positions"]).max() == 0 and np.abs(gradient["camera"]).max() == 0


def test_meshes_are_what_they_are_called():
    """Closed or open, how many edges of three faces: the table's names are promises."""
    from mi_simplify.integrators.edges import edge_table

    faces_an_edge = {}
    for name in ("sphere", "torus", "cube", "sheet", "tube", "fin"):
        mesh = getattr(meshes, name)()
        f = mesh.position_faces
        edges = np.sort(np.stack([f, np.roll(f, -1, 1)], 2).reshape(-1, 2), 1)
        faces_an_edge[name] = np.unique(np.unique(edges, axis=0, return_counts=True)[1]).tolist()
        assert edge_table(f, mesh.faces).closed == (faces_an_edge[name] == [2])
    assert faces_an_edge == {
        "sphere": [2], "torus": [2], "cube": [2], "tube": [2], "sheet": [1, 2], "fin": [1, 2, 3],
    }  # fmt: skip
    assert len(meshes.sphere(100, 101).faces) == 20_000
    assert (len(meshes.cube().uvs), len(meshes.cube().positions)) == (24, 8)
