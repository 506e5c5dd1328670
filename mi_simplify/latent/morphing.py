"""
Morph targets with weights that are optimised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from ..model.model import Model, Morphs
from ..scenes.views import Views
from .operation import Identity, MeshOperation, register_operation
from .placing import Placed, PlacedModel
from .surface import MeshTopology, Surface


@dataclass(frozen=True)
class MorphedModel(PlacedModel):
    """
    A model whose morph targets have weights to be optimised; those of other models stay as they are.
    """

    def moved_to(self, weights: np.ndarray) -> MorphedModel:
        """
        The same base under other weights, shape (K,).
        """
        assert self.morphs is not None
        change = np.asarray(weights, np.float64) - np.asarray(self.morphs.weights)
        positions = self.mesh.positions + np.tensordot(change, self.morphs.offsets, axes=1)
        morphs = Morphs(self.morphs.names, tuple(float(w) for w in weights), self.morphs.offsets)
        return replace(self, mesh=replace(self.mesh, positions=positions), morphs=morphs)


class Morphing:
    """
    Positions ``v + Σ (w_k - w⁰_k) δ_k``: base positions are those under the first weights w⁰, offsets are constants.

    The sum is one product of all offsets with all weights, and so is its derivative: 57 expressions of a face of 11,000
    vertices are two million products.

    Parameters
    ----------
    model : MorphedModel
        With morphs.
    """

    def __init__(self, model: MorphedModel):
        assert model.morphs is not None
        self._inner: MeshOperation = Identity(model) if model.placements is None else Placed(model)
        self.base, self.mesh = self._inner.base, self._inner.mesh
        offsets = model.morphs.offsets
        start = np.array(model.morphs.weights, np.float32)
        self._start = upload(mi.Float, start)
        flat = upload(mi.Float, np.ravel(offsets).astype(np.float32))
        self._offsets = mi.TensorXf(flat, (len(offsets), offsets[0].size))
        self.parameters = {"weights": start}

    def positions(self, base: mi.Float, parameters: dict[str, mi.Float], views: Views) -> mi.Float:
        """See :class:`.operation.MeshOperation`."""
        change = mi.TensorXf(parameters["weights"] - self._start, (self._offsets.shape[0], 1))
        moved = base + dr.sum(self._offsets * change, axis=0).array
        return self._inner.positions(moved, parameters, views)

    def surface(
        self, topology: MeshTopology, positions: mi.Float, base: mi.Float, parameters: dict[str, mi.Float], views: Views
    ) -> Surface:
        """See :class:`.operation.MeshOperation`."""
        return self._inner.surface(topology, positions, base, parameters, views)

    def written(self, model: Model, parameters: dict[str, np.ndarray]) -> Model:
        """See :class:`.operation.MeshOperation`."""
        assert isinstance(model, MorphedModel)
        return model.moved_to(parameters["weights"])


def _make(model: Model) -> MeshOperation:
    assert isinstance(model, MorphedModel)
    return Morphing(model)


register_operation("morphs", lambda model: isinstance(model, MorphedModel) and model.morphs is not None, _make)
