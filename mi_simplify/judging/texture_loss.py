"""
What pictures of a model lose where its textures are stored more coarsely.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.glb import GlbSettings
from ..formats.gltf.write import glb_bytes
from ..formats.images import join_channels
from ..formats.load import load_asset
from ..formats.packing import PackedTextures
from ..integrators.deferred import DeferredRenderer
from ..latent.latent import Latent
from ..latent.textures import Textures, needs_extended
from ..machine.upload import upload
from ..model.frame import Frame
from ..model.mesh import Mesh
from ..model.model import Model
from ..scenes.views import held_out_views
from .metrics import tonemap

_TRIANGLE = Mesh(np.eye(3), np.arange(3), np.array([[0, 0], [1, 0], [0, 1]], np.float32), np.array([[0, 1, 2]]))


class TextureLoss:
    """
    Renders one model, at rest and lit directly, with textures as files would have them.

    Parameters
    ----------
    model : Model
        Without displacement, in any units.
    form : {'gltf', 'paper'}
        Mixing of the lobes.
    n_views, resolution : int
        How many square images of how many pixels; the views are held out of any fit.
    """

    def __init__(self, model: Model, *, form: str = "gltf", n_views: int = 4, resolution: int = 256):
        self.model = replace(model, skin=None, vertex_sets=None, morphs=None, mips=())
        points = self.model.mesh.positions
        frame = Frame.around(np.stack([points.min(0), points.max(0)]))
        placed = self.model.transformed(frame.scale, -frame.scale * frame.center)
        bounds = np.stack([placed.mesh.positions.min(0), placed.mesh.positions.max(0)])
        self._views = held_out_views(bounds, n_views, resolution)
        self._extended = needs_extended(model.base_color, model.specular)
        latent = Latent(placed, self._extended)
        positions = upload(mi.Float, latent.operation.base.positions.ravel())
        self._surface = latent.evaluate(positions)
        self._renderer = DeferredRenderer(latent.topology, form=form)
        self._renderer.move(positions)
        self._best = self._pictures(model.base_color, model.specular, model.normal)

    def __call__(self, textures: PackedTextures) -> float:
        """
        Mean squared difference of tone-mapped pictures with these textures and with the model's own.
        """
        # A triangle in place of the mesh: textures are written and read as ever, geometry costs nothing.
        content = glb_bytes(replace(self.model, mesh=_TRIANGLE, groups=None), settings=GlbSettings(), textures=textures)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "textures.glb"
            file.write_bytes(content)
            material = load_asset(file).parts[0].material
        flat = np.array([[[0, 0, 1]]], np.float32) if material.normal is None else material.normal
        side = np.zeros((*self.model.base_color.shape[:2], 1), np.float32)
        joined = join_channels(material.base_color, material.specular, flat, side)
        pictures = self._pictures(joined[..., :4], joined[..., 4:7], joined[..., 7:10])
        return float(((pictures - self._best) ** 2).mean(dtype=np.float64))

    def _pictures(self, base_color: np.ndarray, specular: np.ndarray, normal: np.ndarray) -> np.ndarray:
        textures = Textures(base_color, specular, normal, self._extended)
        with dr.suspend_grad():
            frame = self._renderer.render(
                self._surface, textures, self._views, spp=4, seed=dr.opaque(mi.UInt32, 1)
            )  # fmt: skip
            return tonemap(frame.images())
