"""
Scenes made of Mitsuba's own parts (BSDFs, sensors, films, lights), behind the interface of the gradient tests.

A smooth ball floats before whatever else a scene holds; its vertices move, or the light.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from mi_simplify.machine.meshes import POSITIONS, make_mesh
from mi_simplify.machine.upload import upload

from . import meshes
from .finite_difference import State
from .scenes import Parameter

WIDTH, HEIGHT = 48, 36


def camera(kind: str = "perspective", *, film: dict | None = None, rfilter: str = "box", **changes) -> dict:
    """
    A sensor that looks at the origin from (0.4, 0.6, -3).
    """
    place = mi.ScalarTransform4f().look_at([0.4, 0.6, -3], [0.03, -0.02, 0], [0, 1, 0])
    out = {
        "type": kind,
        "to_world": place,
        "film": {
            "type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "pixel_format": "rgba", "component_format": "float32",
            "rfilter": {"type": rfilter}, **(film or {}),
        },
        "sampler": {"type": "multijitter"},
    }  # fmt: skip
    if kind in ("perspective", "thinlens"):
        out["fov"] = 40
    if kind == "orthographic":
        out["to_world"] = place @ mi.ScalarTransform4f().scale([1.3, 1.3, 1])
    return out | changes


def spot() -> dict:
    """
    A point light above, to the side and before the ball.
    """
    return {"type": "point", "position": [1.5, 2.0, -2.5], "intensity": {"type": "rgb", "value": [9.0, 8.0, 7.0]}}


class MitsubaScene:
    """
    A ball in a scene of Mitsuba's own parts.

    Parameters
    ----------
    bsdf : dict
        Of the ball.
    sensor, light, emitter : dict, optional
        ``emitter`` is of the ball; ``light`` False is none.
    others : dict, optional
        More shapes.
    smooth : bool
        Interpolated normals. Without them a face that turns away from the light gets dark gradually; with them all at
        once, and a difference sees a jump that no derivative has.
    integrator : dict
        Options of `direct_edge`.
    """

    def __init__(self, bsdf, *, sensor=None, light=None, emitter=None, others=None, smooth=True, **integrator):
        self.options = integrator
        mesh = meshes.sphere(16, 11, radius=0.8)
        self._index = mesh.position_index
        normals = mesh.normals()[mesh.normal_groups] if smooth else None
        ball = make_mesh("ball", mesh.vertices, mesh.faces, normals, mesh.uvs, mi.load_dict(bsdf))
        if emitter is not None:
            ball = _emitting(ball, emitter, bsdf)
        self.start: State = {"ball": mesh.positions.astype(np.float64)}
        description = {
            "type": "scene", "integrator": {"type": "direct_edge", **integrator}, "sensor": sensor or camera(),
            "ball": ball, **(others or {}),
        }  # fmt: skip
        if light is not False:
            description["light"] = light or spot()
        self.scene = mi.load_dict(description, optimize=False)
        self.params = mi.traverse(self.scene)
        if "light.position" in self.params:
            self.start["light"] = np.float64(self.params["light.position"].numpy()).reshape(3)
        film = self.scene.sensors()[0].film().crop_size()
        self.shape = (1, int(film[1]), int(film[0]), 4)

    def parameters(self) -> list[Parameter]:
        """
        Ways to move the ball, and the light where that is a point.
        """
        p = self.start["ball"]
        out = [
            Parameter("translation", "geometry", 0.008, {"ball": np.float64([0.7, 0.6, -0.4]) + 0 * p}),
            Parameter("growth", "geometry", 0.008, {"ball": p * [1.0, 1.2, 0.9]}),
        ]
        if "light" in self.start:
            out.append(Parameter("light", "geometry", 0.02, {"light": np.float64([0.7, -0.3, 0.4])}))
        return out

    def weights(self) -> np.ndarray:
        """
        The adjoint: slow waves over the film.
        """
        _, height, width, channels = self.shape
        y, x = np.meshgrid(np.arange(height) / height, np.arange(width) / width, indexing="ij")
        wave = 1.2 + np.sin(3 * x + 0.5) - 0.8 * np.cos(2.5 * y)
        return np.stack([wave * a for a in (1.0, 0.7, 1.2, 0.8)[:channels]], -1)[None].astype(np.float32)

    def _apply(self, state: State, attach: tuple[str, ...] = ()) -> dict:
        leaves = {"ball": upload(mi.Float, np.float32(state["ball"]).ravel())}
        if "light" in state:
            leaves["light"] = mi.Point3f(*map(float, state["light"]))
        for name in attach:
            dr.enable_grad(leaves[name])
        index = upload(mi.UInt32, self._index)
        self.params[f"ball.{POSITIONS}"] = dr.ravel(dr.gather(mi.Point3f, leaves["ball"], index))
        if "light" in leaves:
            self.params["light.position"] = leaves["light"]
        self.params.update()
        return leaves

    def image(self, state: State, spp: int, seed: int) -> np.ndarray:
        """Image of a state."""
        with dr.suspend_grad():
            self._apply(state)
            return mi.render(self.scene, spp=spp, seed=seed).numpy()[None]

    def gradient(self, adjoint, spp, seed, attach=None, state=None, integrator=None) -> State:
        """Backward mode."""
        attach = tuple(self.start) if attach is None else attach
        leaves = self._apply(state or self.start, attach)
        counts = {"spp": min(spp, 1), "spp_grad": spp, "seed": seed, "seed_grad": seed + 1}
        image = mi.render(self.scene, self.params, integrator=integrator, **counts)
        weights = mi.TensorXf(upload(mi.Float, adjoint[0].ravel()), adjoint[0].shape)
        dr.backward(dr.sum(image * weights, axis=None))
        return {k: dr.grad(leaves[k]).numpy().reshape(self.start[k].shape) for k in attach}


def _emitting(ball: mi.Mesh, emitter: dict, bsdf: dict) -> dict:
    """The ball as a PLY file's mesh that emits: Mitsuba attaches emitters when it loads a shape."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ball.ply"
        ball.write_ply(str(path))
        return mi.load_dict({"type": "ply", "filename": str(path), "emitter": emitter, "bsdf": bsdf, "id": "ball"})
