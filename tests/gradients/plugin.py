"""
The ``direct_edge`` plugin (or another integrator) behind the interface of the gradient tests: a plain Mitsuba scene.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mi_simplify.machine.meshes import POSITIONS, make_mesh
from mi_simplify.machine.upload import upload
from mi_simplify.scenes.shapes import bitmap

from .scenes import PLANES, Scene, State


def direct_projective(sppc: int, sppp: int) -> mi.ad.integrators.common.ADIntegrator:
    """
    Mitsuba's own estimator of the same derivative, without its indirect (shadow) term; use with ``spp=0``.
    """
    return mi.load_dict({"type": "direct_projective", "sppc": sppc, "sppp": sppp, "sppi": 0, "hide_emitters": True})


def _tensor(array: np.ndarray) -> mi.TensorXf:
    return mi.TensorXf(upload(mi.Float, array.ravel()), array.shape)


class Plugin:
    """
    A scene rendered by ``mi.render``.

    Parameters
    ----------
    headlight : bool
        The light stands at the camera: no shadow is seen, so integrators with and without shadows agree.
    emitter : dict, optional
        Mitsuba emitter or emitting shape instead of the point light.
    layers : int
        Of `direct_edge`.
    bsdf : dict, optional
        Instead of `ggx_gamma` with the state's textures.
    matte : bool
        Rough dielectric textures, so that lights sampled at random leave little noise.
    """

    def __init__(
        self, scene: Scene, *, headlight=True, rfilter="box", emitter=None, layers=1, bsdf=None, matte=False, **options
    ):
        self.scene = scene
        self.start = scene.state(headlight, n_views=1)
        self.views = scene.views(headlight)
        self.bsdf = bsdf
        self.has_light = emitter is None
        if matte:
            for name, value in (("roughness", 0.8), ("metallic", 0.0)):
                self.start[name] = value + 0.2 * self.start[name]
        if bsdf is not None:
            self.start = {k: v for k, v in self.start.items() if k not in PLANES and k != "normal"}
        if emitter is not None:
            self.start = {k: v for k, v in self.start.items() if not k.startswith("light")}
        self.mi_scene = self._load(rfilter, emitter, {"type": "direct_edge", "layers": layers, **options})
        self._params = mi.traverse(self.mi_scene)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Of an image and of the adjoint: (1, H, W, 4)."""
        return (1, self.views.height, self.views.width, 4)

    @property
    def keys(self) -> list[str]:
        """Parameters of the Mitsuba scene."""
        return list(self._params.keys())

    def _bsdf(self):
        if self.bsdf is not None:
            return mi.load_dict(self.bsdf)
        planes = {name: bitmap(self.start[name].astype(np.float32)) for name in PLANES}
        normal = bitmap((self.start["normal"] * 0.5 + 0.5).astype(np.float32))
        return mi.load_dict({"type": "ggx_gamma", **planes, "normal_map": normal})

    def _load(self, rfilter: str, emitter: dict | None, integrator: dict) -> mi.Scene:
        arrays = self.views.arrays()
        width, height = self.views.width, self.views.height
        self._axes = np.stack([-arrays["right"][0], arrays["up"][0], arrays["forward"][0]], 1).astype(np.float64)
        description = {
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                "type": "perspective",
                "fov_axis": "x",
                "fov": float(np.degrees(2 * np.arctan(arrays["tan_x"][0]))),
                "near_clip": 1e-3,
                "to_world": mi.ScalarTransform4f(self._to_world(self.start["camera"][0])),
                "sampler": {"type": "multijitter", "sample_count": 1},  # for images that nobody looks at
                "film": {
                    "type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgba",
                    "component_format": "float32", "rfilter": {"type": rfilter},
                },
            },
        }  # fmt: skip
        for k, mesh in enumerate(self.scene.pieces):
            normals, name = mesh.normals()[mesh.normal_groups], f"piece_{k}"
            description[name] = make_mesh(name, mesh.vertices, mesh.faces, normals, mesh.uvs, self._bsdf())
        if emitter is None:
            description["light"] = {
                "type": "point", "position": [0.0, 0.0, 0.0], "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]},
            }  # fmt: skip
        else:
            description["light"] = emitter
        return mi.load_dict(description, optimize=False)

    def _to_world(self, origin: np.ndarray) -> np.ndarray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = self._axes, origin
        return out

    def _leaves(self, state: State) -> dict[str, list]:
        """
        Dr.Jit arrays of a state, several where several shapes share a part of it.
        """
        n = len(self.scene.pieces)
        leaves: dict[str, list] = {"positions": [upload(mi.Float, state["positions"].ravel())]}
        for name in (*PLANES, "normal"):
            if name in state:
                leaves[name] = [_tensor(state[name]) for _ in range(n)]
        if self.has_light:
            leaves["light_position"] = [mi.Point3f(*map(float, state["light_position"][0]))]
            leaves["light_intensity"] = [mi.Color3f(*map(float, state["light_intensity"][0]))]
        leaves["camera"] = [mi.Point3f(*map(float, state["camera"][0]))]
        return leaves

    def _apply(self, leaves: dict[str, list]) -> None:
        """
        Hand the leaves to the scene.
        """
        p, first = self._params, 0
        for k, mesh in enumerate(self.scene.pieces):
            index = upload(mi.UInt32, mesh.position_index + first)
            # Duplicates of a UV-split vertex move together.
            p[f"piece_{k}.{POSITIONS}"] = dr.ravel(dr.gather(mi.Point3f, leaves["positions"][0], index))
            first += len(mesh.positions)
            for name in (*PLANES, "normal"):
                if name in leaves:
                    value = leaves[name][k]
                    key = "normal_map" if name == "normal" else name
                    p[f"piece_{k}.bsdf.{key}.data"] = value * 0.5 + 0.5 if name == "normal" else value
        if self.has_light:
            p["light.position"] = leaves["light_position"][0]
            p["light.intensity.value"] = leaves["light_intensity"][0]
        rotation = mi.Transform4f(self._to_world(np.zeros(3)))
        p["sensor.to_world"] = mi.Transform4f().translate(leaves["camera"][0]) @ rotation
        p.update()

    def image(self, state: State, spp: int, seed: int) -> np.ndarray:
        """
        Image without gradients, shape (1, H, W, 4).
        """
        with dr.suspend_grad():
            self._apply(self._leaves(state))
            return mi.render(self.mi_scene, spp=spp, seed=seed).numpy()[None]

    def gradient(
        self,
        adjoint: np.ndarray,
        spp: int,
        seed: int,
        attach: tuple[str, ...] | None = None,
        state: State | None = None,
        integrator=None,
    ) -> State:
        """
        Backward mode: the derivative of ``sum(adjoint * image)`` by what is in ``attach`` (default: the whole state).

        ``spp`` 0 leaves sample counts to the integrator.
        """
        leaves = self.attach(tuple(self.start) if attach is None else attach, state)
        image = self._render(spp, seed, integrator)
        dr.backward(dr.sum(image * _tensor(adjoint[0]), axis=None))
        out = {}
        for name, values in leaves.items():
            grads = [dr.grad(v).numpy() for v in values]
            total = np.sum(grads, axis=0)
            out[name] = total.reshape(self.start[name].shape)
        return {k: v for k, v in out.items() if attach is None or k in attach}

    def derivative(self, direction: State, spp: int, seed: int, integrator=None) -> np.ndarray:
        """
        Forward mode: the derivative of the image along a direction, shape (1, H, W, 4).
        """
        leaves = self.attach(tuple(direction))
        for name, value in direction.items():
            for leaf in leaves[name]:
                if isinstance(leaf, mi.TensorXf):
                    dr.set_grad(leaf, _tensor(value))
                elif name == "positions":
                    dr.set_grad(leaf, upload(mi.Float, value.ravel()))
                else:
                    dr.set_grad(leaf, type(leaf)(*map(float, value[0])))
        # Up to the scene's parameters first: the integrator's own pass stops at them.
        for name in direction:
            for leaf in leaves[name]:
                dr.enqueue(dr.ADMode.Forward, leaf)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
        image = self._render(spp, seed, integrator)
        return dr.forward_to(image).numpy()[None]

    def attach(self, attach: tuple[str, ...], state: State | None = None) -> dict[str, list]:
        """
        Place the scene in a state, ``start`` if not given, with gradients on the leaves of what is in ``attach``.
        """
        leaves = self._leaves(state or self.start)
        for name in attach:
            for leaf in leaves[name]:
                dr.enable_grad(leaf)
        self._apply(leaves)
        return leaves

    def _render(self, spp: int, seed: int, integrator) -> mi.TensorXf:
        """
        An image whose derivative takes ``spp`` samples a pixel; its value is not looked at and takes one.
        """
        counts = {"spp": min(spp, 1), "spp_grad": spp, "seed": seed, "seed_grad": seed + 1}
        return mi.render(self.mi_scene, self._params, integrator=integrator, **counts)
