"""
The latent model on the device: a mesh, what moves it, packed textures, and how a surface is made of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..model.mesh import Mesh
from ..model.model import Model
from ..model.tangents import split_mirrored
from ..scenes.views import Views
from . import operations as operations  # makes them known
from .operation import operation_of
from .surface import MeshTopology, Surface
from .textures import Textures


class Latent:
    """
    What is optimised. The paper's mesh operations happen in ``operation`` and in :meth:`evaluate`.

    Parameters
    ----------
    model : Model
        First guess, in the normalised frame.
    extended : bool
        Keep opacity and γ in the textures.
    mips : {'none', 'derived', 'custom'}
        Coarser levels of the textures, see :class:`.textures.Textures`; custom ones start from the model's own.
    """

    def __init__(self, model: Model, extended: bool = False, mips: str = "none"):
        self._model = replace(model, mesh=split_mirrored(model.mesh))
        self.operation = operation_of(self._model)
        self.topology = MeshTopology(self.operation.mesh, density=mips != "none")
        self.textures = Textures(
            model.base_color, model.specular, model.normal, extended, mips, model.mips, model.cells
        )

    def evaluate(
        self,
        positions: mi.Float,
        base: mi.Float | None = None,
        parameters: dict[str, mi.Float] | None = None,
        views: Views | None = None,
    ) -> Surface:
        """
        The surface at rendered welded positions, flat, width P·3; differentiable.

        Parameters
        ----------
        positions : mi.Float
        base, parameters, views
            What the operation made the positions of; without them all of the surface is that of the mesh at these.
        """
        if base is None or parameters is None or views is None:
            return self.topology.surface(positions)
        return self.operation.surface(self.topology, positions, base, parameters, views)

    def model(self, base: np.ndarray, parameters: Mapping[str, np.ndarray] | None = None) -> Model:
        """
        Back to NumPy: all that is optimised.

        Parameters
        ----------
        base : ndarray, shape (P, 3) or flat
            Welded base positions.
        parameters : mapping of str to ndarray, optional
            Of the operation; its first values where left out.
        """
        model = self._with(self._model.mesh, base)
        return self.operation.written(model, {**self.operation.parameters, **(parameters or {})})

    def as_rendered(self, positions: np.ndarray, surface: Surface) -> Model:
        """
        The rendered mesh at rendered positions, with the normals of its surface and the textures, as a model without an
        operation.
        """
        mesh = self.topology.mesh
        normals = surface.packets.numpy().reshape(-1, 12)[:, 4:7].astype(np.float64)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)  # means are shorter
        model = self._with(replace(mesh, normal_index=np.arange(len(mesh.uvs)), own_normals=normals), positions)
        return Model(model.mesh, model.base_color, model.specular, model.normal, model.alpha_mode, model.alpha_cutoff)

    def _with(self, mesh: Mesh, positions: np.ndarray) -> Model:
        mesh = replace(mesh, positions=np.asarray(positions, np.float64).reshape(-1, 3))
        own = range(1, self.textures.n_levels) if self.textures.mips == "custom" else ()
        mips = tuple(self.textures.images(level) for level in own)
        images: dict[str, Any] = self.textures.images()
        return replace(self._model, mesh=mesh, mips=mips, **images)
