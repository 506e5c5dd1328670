"""
Models in the light that they were fitted to.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config import Config
from ..errors import AssetError
from ..integrators.deferred import DeferredRenderer
from ..judging.self_check import as_written, stored_tangents
from ..latent.environment import looked_up
from ..model.asset import Asset, Part
from ..scenes.references.path_traced import make_reference
from ..scenes.references.reference import Reference
from ..scenes.views import Views


def fitted_light(asset: Asset, spp: int, config: Config) -> Reference:
    """
    A model as the fit sees it: lit directly, and by the ambient light or the environment that belongs to it.

    Parameters
    ----------
    asset : Asset
        Its ``ambient`` is that light.
    spp : int
        Samples per pixel.
    config : Config
    """
    form = config.latent.shading
    if asset.ambient is not None and len(asset.ambient) > 1:
        return InEnvironment(asset, spp, form)
    return make_reference(asset, transport="direct", spp=spp, form=form, ambient=asset.ambient)


def _atlas(part: Part) -> int:
    """A number that parts share whose textures are the same."""
    return hash(part.material.base_color.tobytes())


class InEnvironment:
    """
    A written file under its environment: by the renderer of the fit, as a reference renderer.
    """

    def __init__(self, asset: Asset, spp: int, form: str):
        parts = asset.placed()
        if any(part.uvs is None for part in parts) or len({_atlas(part) for part in parts}) > 1:
            raise AssetError(f"{asset.name}: only a model with one atlas can be shown in the light it was fitted to")
        self.topology, self.surface, self.textures, positions = as_written(parts, stored_tangents(asset))
        self.spp = spp
        self._ambient = looked_up(asset.ambient)
        self._renderer = DeferredRenderer(self.topology, form=form)
        self._renderer.move(positions)

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """See :class:`..scenes.references.reference.Reference`."""
        with dr.suspend_grad():
            frame = self._renderer.render(
                self.surface, self.textures, views.under(self._ambient), spp=self.spp, seed=dr.opaque(mi.UInt32, seed)
            )
        return frame.images()
