"""
The batched renderer behind the interface of the gradient tests.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.latent.surface import MeshTopology
from mi_simplify.latent.textures import Textures
from mi_simplify.machine.upload import upload
from mi_simplify.scenes.views import Views

from .scenes import Scene, State

#: Where the planes of a state lie among the channels of the packed texture gradient.
_CHANNELS = {
    "base_color": (0, 3), "roughness": (3, 4), "metallic": (4, 5), "normal": (5, 8), "opacity": (8, 9),
    "gamma": (9, 10),
}  # fmt: skip


class Batched:
    """
    Images and gradients of a scene by :class:`DeferredRenderer`, with mip levels of this kind.
    """

    def __init__(self, scene: Scene, mips: str = "none", **options):
        self.scene, self.mips = scene, mips
        self.start = scene.state()
        self.views = scene.views()
        self.topology = MeshTopology(scene.mesh, density=mips != "none")
        self.renderer = DeferredRenderer(self.topology, **options)
        self.steepness: float | None = None

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Of an image and of the adjoint: (B, H, W, 4)."""
        return (len(self.views), self.views.height, self.views.width, 4)

    def _textures(self, state: State) -> Textures:
        base = np.concatenate([state["base_color"], state["opacity"]], axis=2)
        specular = np.concatenate([state["gamma"], state["roughness"], state["metallic"]], axis=2)
        textures = Textures(base, specular, state["normal"], extended=True, mips=self.mips)
        if self.steepness is not None:
            textures.steepness = dr.opaque(mi.Float, self.steepness)
        return textures

    def _views(self, state: State) -> Views:
        arrays = self.views.arrays()
        arrays |= {k: state[k] for k in ("light_position", "light_intensity")} | {"origin": state["camera"]}
        return Views.from_arrays(arrays, self.views.width, self.views.height)

    def _place(self, state: State, attach: tuple[str, ...] = ()):
        """
        Everything a render needs, with gradients enabled where asked for.
        """
        positions = upload(mi.Float, state["positions"].ravel())
        views = self._views(state)
        for name, value in self._leaves(positions, views).items():
            if name in attach:
                dr.enable_grad(value)
        self.renderer.move(positions)
        return positions, views, self.topology.surface(positions), self._textures(state)

    @staticmethod
    def _leaves(positions: mi.Float, views: Views) -> dict:
        return {
            "positions": positions,
            "light_position": views.light_position,
            "light_intensity": views.light_intensity,
            "camera": views.origin,
        }

    def image(self, state: State, spp: int, seed: int) -> np.ndarray:
        """
        Image without gradients, shape (B, H, W, 4); the same seed gives the same film positions.
        """
        with dr.suspend_grad():
            _, views, surface, textures = self._place(state)
            frame = self.renderer.render(surface, textures, views, spp=spp, seed=dr.opaque(mi.UInt32, seed))
            return frame.image.numpy().T.reshape(self.shape)

    def gradient(self, adjoint: np.ndarray, spp: int, seed: int, attach=None, state: State | None = None) -> State:
        """
        Backward mode: the derivative of ``sum(adjoint * image)`` by what is in ``attach`` (default: the whole state).
        """
        attach = tuple(self.start) if attach is None else attach
        positions, views, surface, textures = self._place(state or self.start, attach)
        frame = self.renderer.render(surface, textures, views, spp=spp, seed=dr.opaque(mi.UInt32, seed))
        grad = upload(mi.Vector4f, adjoint.reshape(-1, 4))
        edge_seed = dr.opaque(mi.UInt32, seed + 7919)
        texels = self.renderer.backward(frame, grad, surface, textures, positions, edge_seed)
        out = {}
        for name, leaf in self._leaves(positions, views).items():
            if name in attach:
                value = dr.grad(leaf).numpy()
                out[name] = value.reshape(-1, 3) if name == "positions" else value.T
        n = self.scene.n_texels
        packed = np.zeros((n, n, 12))
        if texels is not None:
            packed = texels.by_parameters(textures).dense(textures).numpy().reshape(n, n, -1)
        for name, (low, high) in _CHANNELS.items():
            if name in attach:
                out[name] = packed[..., low:high]
        return out

    def derivative(self, direction: State, spp: int, seed: int) -> np.ndarray:
        """
        Forward mode: the derivative of the image along a direction, shape (B, H, W, 4).
        """
        positions, views, surface, textures = self._place(self.start, tuple(direction))
        frame = self.renderer.render(surface, textures, views, spp=spp, seed=dr.opaque(mi.UInt32, seed))
        for name, leaf in self._leaves(positions, views).items():
            if name in direction:
                value = direction[name].ravel() if name == "positions" else direction[name]
                dr.set_grad(leaf, upload(type(leaf), value))
        planes = {k: direction.get(k, 0 * v) for k, v in self.start.items()}
        edge_seed = dr.opaque(mi.UInt32, seed + 7919)
        image = self.renderer.forward(frame, surface, textures, positions, edge_seed, self._textures(planes))
        return image.numpy().T.reshape(self.shape)
