"""
What `direct_edge` does not cover raises or warns: silence would be a wrong picture.
"""

from __future__ import annotations

import dataclasses
import logging
import subprocess
import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.errors import UserError
from mi_simplify.machine.meshes import POSITIONS, make_mesh

from . import meshes, scenes
from .finite_difference import along
from .plugin import Plugin


def _sensor(**changes) -> dict:
    return {
        "type": "perspective",
        "fov": 40,
        "to_world": mi.ScalarTransform4f().look_at([0, 0.5, -3], [0, 0, 0], [0, 1, 0]),
        "film": _film(),
    } | changes


def _film(**changes) -> dict:
    return {"type": "hdrfilm", "width": 16, "height": 12, "pixel_format": "rgba", "rfilter": {"type": "box"}} | changes


def _scene(sensor=None, integrator=None, **shapes) -> mi.Scene:
    light = {"type": "point", "position": [1.0, 2.0, -3.0]}
    integrator = {"type": "direct_edge"} | (integrator or {})
    sensor = sensor or _sensor()
    return mi.load_dict(
        {"type": "scene", "integrator": integrator, "sensor": sensor, "light": light} | shapes, optimize=False
    )


def _mesh(name: str = "mesh") -> mi.Mesh:
    mesh = meshes.sphere(8, 6)
    return make_mesh(name, mesh.vertices, mesh.faces, None, mesh.uvs, mi.load_dict({"type": "ggx_gamma"}))


def _backward(scene: mi.Scene, key: str, value=None) -> mi.SceneParameters:
    params = mi.traverse(scene)
    leaf = params[key] if value is None else value
    dr.enable_grad(leaf)
    params[key] = leaf
    params.update()
    dr.backward(dr.sum(mi.render(scene, params, spp=1), axis=None))
    return params


def _shifted(transform) -> tuple:
    leaf = mi.Point3f(0)
    dr.enable_grad(leaf)
    return leaf, mi.Transform4f().translate(leaf) @ mi.Transform4f(transform)


def test_moving_sphere_raises():
    scene = _scene(ball={"type": "sphere"})
    _, to_world = _shifted(mi.traverse(scene)["ball.to_world"].matrix)
    with pytest.raises(UserError, match="'ball' is no triangle mesh.*turn it into a mesh"):
        _backward(scene, "ball.to_world", to_world)


def test_camera_moving_before_a_sphere_raises():
    scene = _scene(ball={"type": "sphere"}, mesh=_mesh())
    _, to_world = _shifted(mi.traverse(scene)["sensor.to_world"].matrix)
    with pytest.raises(UserError, match="'ball' is no triangle mesh"):
        _backward(scene, "sensor.to_world", to_world)


def test_texture_of_a_sphere_is_no_motion():
    scene = _scene(ball={"type": "sphere"}, mesh=_mesh())
    params = _backward(scene, "ball.bsdf.reflectance.value")
    assert dr.any(dr.grad(params["ball.bsdf.reflectance.value"]) != 0)


def test_still_sphere_beside_a_moving_mesh_is_fine():
    scene = _scene(ball={"type": "sphere", "radius": 0.3, "center": [0, 1, 0]}, mesh=_mesh())
    params = _backward(scene, f"mesh.{POSITIONS}")
    assert np.abs(dr.grad(params[f"mesh.{POSITIONS}"]).numpy()).max() > 0


def test_moving_instance_raises():
    group = mi.load_dict({"type": "shapegroup", "mesh": _mesh()})
    scene = _scene(group=group, copy={"type": "instance", "group": group})
    _, to_world = _shifted(mi.traverse(scene)["copy.to_world"].matrix)
    with pytest.raises(UserError, match="'copy' is no triangle mesh"):
        _backward(scene, "copy.to_world", to_world)


def test_mesh_moving_inside_an_instance_raises():
    group = mi.load_dict({"type": "shapegroup", "mesh": _mesh()})
    scene = _scene(group=group, copy={"type": "instance", "group": group})
    key = next(k for k in mi.traverse(scene).keys() if k.endswith(POSITIONS))  # noqa: SIM118
    with pytest.raises(UserError, match="moves inside an instance.*place the mesh itself"):
        _backward(scene, key)


def test_sensors_without_a_film_plane_are_refused_by_name():
    sensor = {
        "type": "radiancemeter",
        "id": "meter",
        "origin": [0, 0, -3],
        "direction": [0, 0, 1],
        "film": _film(width=1, height=1),
    }
    scene = _scene(sensor, mesh=_mesh())
    with pytest.raises(UserError, match="sensor 'meter' .*RadianceMeter.* use `perspective`, `thinlens`"):
        _backward(scene, f"mesh.{POSITIONS}")
    params = _backward(_scene(sensor, mesh=_mesh()), "mesh.bsdf.roughness.value")  # textures move no edge
    assert np.isfinite(dr.grad(params["mesh.bsdf.roughness.value"]).numpy()).all()


def test_rectangle_stands_still_beside_a_moving_mesh():
    """Mitsuba calls it a mesh; it has no vertices."""
    scene = _scene(floor={"type": "rectangle"}, mesh=_mesh())
    params = _backward(scene, f"mesh.{POSITIONS}")
    assert np.abs(dr.grad(params[f"mesh.{POSITIONS}"]).numpy()).max() > 0


def test_shapes_without_ids_in_a_file(tmp_path):
    """Their parameters have made-up names; they are no instances for that."""
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><integrator type="direct_edge"/><sensor type="perspective">'
        '<film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/></film></sensor>'
        '<shape type="rectangle"/><shape type="cube"><transform name="to_world"><scale value="0.3"/>'
        '<translate z="3"/></transform></shape><emitter type="constant"/></scene>'
    )
    scene = mi.load_file(str(tmp_path / "scene.xml"), optimize=False)
    key = next(k for k in mi.traverse(scene).keys() if k.endswith(POSITIONS))  # noqa: SIM118
    params = _backward(scene, key)
    assert np.abs(dr.grad(params[key]).numpy()).max() > 0


@pytest.mark.parametrize("kind", ["rectangle", "disk", "cylinder"])
def test_moving_shapes_that_are_no_meshes_are_named(kind):
    scene = _scene(floor={"type": kind}, mesh=_mesh())
    _, to_world = _shifted(mi.traverse(scene)["floor.to_world"].matrix)
    with pytest.raises(UserError, match="'floor' is no triangle mesh"):
        _backward(scene, "floor.to_world", to_world)


def test_shadows_of_soft_lights_warn_once(caplog):
    scene = _scene(integrator={"shadows": True}, mesh=_mesh(), sky={"type": "constant"})
    with caplog.at_level(logging.WARNING, "mi_simplify"):
        _backward(scene, f"mesh.{POSITIONS}")
        _backward(scene, f"mesh.{POSITIONS}")
    assert [r.message for r in caplog.records] == [
        "direct_edge: derivatives of the shadows of sky are not computed; they are constants"
    ]


def test_sharp_shadows_do_not_warn(caplog):
    scene = _scene(integrator={"shadows": True}, mesh=_mesh())
    with caplog.at_level(logging.WARNING, "mi_simplify"):
        _backward(scene, f"mesh.{POSITIONS}")
    assert not caplog.records


def test_still_shadows_do_not_warn(caplog):
    scene = _scene(integrator={"shadows": True}, mesh=_mesh())
    with caplog.at_level(logging.WARNING, "mi_simplify"):
        _backward(scene, "mesh.bsdf.roughness.value")
        _backward(scene, "light.intensity.value")
    assert not caplog.records


def test_variant_without_gradients_raises():
    script = (
        "import mi_simplify, mitsuba as mi; mi.set_variant('scalar_rgb');"
        "mi.load_dict({'type': 'direct_edge'})"
    )  # fmt: skip
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    assert "variant 'scalar_rgb' cannot be used: choose one of llvm_ad_rgb, cuda_ad_rgb" in done.stderr


def test_field_of_view_moves_edges():
    """An attached field of view is a moving camera: growing it shrinks the object, by as much as the area says."""
    scene = _scene(_sensor(fov=60), mesh=_mesh())
    params = mi.traverse(scene)
    fov = mi.Float(60.0)

    def coverage(value):
        params["sensor.x_fov"] = value
        params.update()
        return mi.render(scene, params, spp=256, spp_grad=256, seed=3)

    dr.enable_grad(fov)
    image = coverage(fov)
    weights = dr.zeros(mi.TensorXf, image.shape)
    weights[..., image.shape[2] - 1] = 1
    dr.backward(dr.sum(image * weights, axis=None))
    with dr.suspend_grad():
        area = float(coverage(mi.Float(60.0)).numpy()[..., -1].sum())
    # Area on the film is proportional to 1 / tan²(fov/2).
    half = np.radians(30)
    expected = -2 * area / np.tan(half) / np.cos(half) ** 2 * np.radians(0.5)
    assert dr.grad(fov).numpy()[0] == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("offset", [0.0, 300.0])
def test_scenes_far_off_the_origin(offset):
    """The step to either side of an edge follows what float32 resolves there."""
    base = scenes.scene("cube")
    shift = np.array([offset, 0, -offset])
    piece = dataclasses.replace(base.pieces[0], positions=base.pieces[0].positions + shift)
    camera = base.camera | {k: np.asarray(base.camera[k]) + shift for k in ("origin", "target", "light")}
    far = dataclasses.replace(base, pieces=(piece,), camera=camera)
    parameter = next(p for p in scenes.parameters(base, base.state(True, 1)) if p.name == "along normals")
    adjoint = scenes.film_weights(base, 1)
    here, there = (along(Plugin(s).gradient(adjoint, 64, 5), parameter.direction) for s in (base, far))
    assert there == pytest.approx(here, rel=0.03)
