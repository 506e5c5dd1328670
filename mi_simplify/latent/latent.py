"""
The latent model on the device: a mesh and packed textures, and how a surface is made of them.
"""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np

from .model import Model
from .surface import MeshTopology, Surface
from .textures import Textures


class Latent:
    """
    What is optimised. The paper's mesh operations happen in :meth:`evaluate`.

    Parameters
    ----------
    model : Model
        First guess, in the normalised frame.
    extended : bool
        Keep opacity and γ in the textures.
    """

    def __init__(self, model: Model, extended: bool = False):
        self.topology = MeshTopology(model.mesh)
        self.textures = Textures(model.base_color, model.specular, model.normal, extended)
        self._model = replace(model, mesh=self.topology.mesh)

    def evaluate(self, positions: mi.Float) -> Surface:
        """
        The surface at welded positions, flat, width P·3; differentiable.
        """
        return self.topology.surface(positions)

    def model(self, positions: np.ndarray) -> Model:
        """
        Back to NumPy; ``positions`` has shape (P, 3).
        """
        mesh = replace(self._model.mesh, positions=np.asarray(positions, np.float64).reshape(-1, 3))
        return replace(self._model, mesh=mesh, **self.textures.images())
