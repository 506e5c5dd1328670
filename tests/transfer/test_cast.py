"""Transfer by ray casting: closed forms, quadrature, interreflection, and a path tracer under the same light."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh

from mi_simplify.judging.metrics import psnr
from mi_simplify.machine.meshes import make_mesh
from mi_simplify.model.light.harmonics import environment_image, harmonics
from mi_simplify.model.topology import vertex_normals
from mi_simplify.transfer.cast import Caster, unshadowed
from mi_simplify.transfer.picture import Camera, seen

UP = np.array([0.0, 1.0, 0.0])


def plane(n: int, size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A square in y = 0 that faces up, n × n vertices."""
    x, z = np.meshgrid(np.linspace(-size, size, n), np.linspace(-size, size, n), indexing="ij")
    k = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([k, k + 1, k + n], 1), np.stack([k + n, k + 1, k + n + 1], 1)])
    return np.stack([x.ravel(), np.zeros(n * n), z.ravel()], 1), faces


def ball(subdivisions: int, radius: float = 1.0, center=(0, 0, 0)) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.asarray(mesh.vertices) * radius + center, np.asarray(mesh.faces)


def joined(*meshes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(v) for v, _ in meshes)])
    return np.concatenate([v for v, _ in meshes]), np.concatenate(
        [f + s for (_, f), s in zip(meshes, starts, strict=False)]
    )


def quadrature(normal: np.ndarray, visible, n: int, order: int = 3, albedo: float = 0.8) -> np.ndarray:
    """The definition itself: a sum over a fine grid of directions, n rows."""
    theta, phi = np.meshgrid((np.arange(n) + 0.5) / n * np.pi, (np.arange(2 * n) + 0.5) / n * np.pi, indexing="ij")
    d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    t = albedo / np.pi * np.maximum(0, d @ normal) * visible(d) * np.sin(theta) * (np.pi / n) ** 2
    basis = np.broadcast_arrays(*harmonics(order, d[..., 0], d[..., 1], d[..., 2]))
    return np.array([(t * b).sum() for b in basis])


@pytest.mark.parametrize(("vertices", "faces"), [plane(9), ball(2)], ids=["plane", "ball"])
def test_what_nothing_occludes_has_the_closed_form(vertices, faces):
    normals = vertex_normals(vertices, faces)
    out = Caster(vertices, faces)(vertices, normals)
    wanted = np.stack([quadrature(n, lambda d: 1.0, 100) for n in normals[::9]])
    np.testing.assert_allclose(out[::9], wanted, atol=1e-3)


def test_a_vertex_in_a_box_receives_nothing():
    """All directions are blocked: what is left is the error of the sampling itself."""
    box = trimesh.creation.box((2, 2, 2))
    vertices, faces = joined((np.asarray(box.vertices), np.asarray(box.faces)), plane(9, 0.2))
    normals = np.tile(UP, (len(vertices), 1))
    out = Caster(vertices, faces)(vertices, normals)[8:]
    assert np.abs(out).max() < 5e-3
    assert np.sqrt((out**2).mean()) < 1e-3


def test_a_ball_over_a_plane_agrees_with_quadrature():
    vertices, faces = joined(plane(5), ball(4, 0.4, (0, 0.7, 0)))
    normals = np.concatenate([np.tile(UP, (25, 1)), vertices[25:] / 0.4 - [0, 1.75, 0]])
    out = Caster(vertices, faces, n_directions=2048)(vertices, normals)[:25]

    some = [0, 7, 12, 13, 22]

    def visible(p):
        c = np.array([0, 0.7, 0]) - p

        def test(d):
            along = d @ c
            return ~((along > 0) & (c @ c - along**2 < 0.16))

        return test

    wanted = np.stack([quadrature(UP, visible(p), 500) for p in vertices[some]])
    assert np.abs(wanted - unshadowed(UP)).max() > 0.1
    np.testing.assert_allclose(out[some], wanted, atol=1e-3)


def test_lower_orders_are_the_first_coefficients():
    vertices, faces = joined(plane(5), ball(2, 0.4, (0, 0.7, 0)))
    normals = np.tile(UP, (len(vertices), 1))
    whole, part = (Caster(vertices, faces, order=order)(vertices, normals) for order in (3, 1))
    np.testing.assert_allclose(part, whole[:, :4], atol=1e-6)


def picture_pair(bounces: int) -> float:
    """PSNR of a picture from coefficients against Mitsuba's path tracer, the same light and depth."""
    vertices, faces = joined(plane(64), ball(4, 0.45, (0, 0.5, 0)))
    normals = np.concatenate([np.tile(UP, (4096, 1)), (vertices[4096:] - [0, 0.5, 0]) / 0.45])
    light = np.zeros((16, 3), np.float32)
    light[0], light[1], light[2], light[3], light[7] = 1.4, [0.5, 0.4, 0.3], [0.2, 0.1, 0], [0.1, 0.2, 0.4], 0.1
    transfer = Caster(vertices, faces, bounces=bounces, n_directions=512)(vertices, normals)
    camera = Camera(np.array([1.5, 1.8, 2.4]), np.array([0, 0.3, 0]))
    fine = seen(vertices, faces, camera, 256).shaded(transfer, light)
    ours = fine.reshape(64, 4, 64, 4, 4).mean((1, 3))
    diffuse = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}})
    bitmap = mi.Bitmap(environment_image(light, 256))
    scene = mi.load_dict({
        "type": "scene", "object": make_mesh("object", vertices, faces, normals=normals, bsdf=diffuse),
        "light": {"type": "envmap", "bitmap": bitmap},
        "integrator": {"type": "path", "max_depth": 2 + bounces, "hide_emitters": True},
        "sensor": {
            "type": "perspective", "fov": 35.0,
            "to_world": mi.ScalarTransform4f().look_at([1.5, 1.8, 2.4], [0, 0.3, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}},
        },
    })  # fmt: skip
    theirs = np.array(mi.render(scene, spp=1024, seed=1))
    dr.flush_malloc_cache()
    return float(psnr(theirs[None, ..., :3], ours[None, ..., :3])[0])


def test_a_picture_is_that_of_a_path_tracer():
    assert picture_pair(0) > 40


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [1, 2])
def test_a_picture_with_interreflection_is_that_of_a_path_tracer(bounces):
    assert picture_pair(bounces) > 40


def test_only_the_front_reflects():
    """A ceiling that faces up sends nothing down; one that faces down does."""
    ceiling, faces = plane(9)
    results = []
    for flip in (False, True):
        vertices, all_faces = joined(plane(9), (ceiling + [0, 0.5, 0], faces[:, ::-1] if flip else faces))
        normals = np.concatenate([np.tile(UP, (81, 1)), np.tile(-UP if flip else UP, (81, 1))])
        plain, bounced = (Caster(vertices, all_faces, bounces=b)(vertices, normals) for b in (0, 1))
        results.append(np.abs(bounced - plain)[:81].max())
    assert results[0] == 0 and results[1] > 1e-3
