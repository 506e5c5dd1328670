"""
Several sets of vertex positions over one topology, blended by the size on the screen: one model for a range of
distances, without popping.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..model.model import Model, VertexSets
from ..scenes.views import Views
from .surface import MeshTopology, Surface


def blend_weights(sizes: tuple[float, ...], resolution: float) -> np.ndarray:
    """
    Share of each set at a film size: linear in its logarithm between the two nearest sizes, which fall.

    Returns
    -------
    ndarray, shape (K,)
    """
    place = np.interp(-np.log2(resolution), -np.log2(sizes), np.arange(len(sizes)))
    return np.maximum(1 - np.abs(np.arange(len(sizes)) - place), 0)


def blended(model: Model, resolution: float) -> Model:
    """
    The model as it is seen in images of this side, without further sets.
    """
    sets = model.vertex_sets
    if sets is None:
        return model
    weights = blend_weights(sets.sizes, resolution)[1:]
    moved = model.mesh.positions + np.tensordot(weights, sets.offsets, axes=1)
    return replace(model, mesh=replace(model.mesh, positions=moved), vertex_sets=None)


class Blended:
    """
    Positions ``v + Σ w_k o_k``: base positions are those of the largest size, every other set is an offset of its own.

    Which sets a view sees is decided by its film size, as mip levels are by the size of a pixel (Hasselgren et al.
    2021, Sect. 4.2); the weights are constants, gradients reach base and offsets.

    Parameters
    ----------
    model : Model
        With vertex sets.
    """

    def __init__(self, model: Model):
        assert model.vertex_sets is not None
        self.base = self.mesh = model.mesh
        self.sizes = model.vertex_sets.sizes
        self._shape = model.vertex_sets.offsets.shape
        self.parameters = {"vertex_sets": model.vertex_sets.offsets.ravel()}

    def positions(self, base: mi.Float, parameters: dict[str, mi.Float], views: Views) -> mi.Float:
        """See :class:`.operation.MeshOperation`."""
        n, offsets, out = dr.width(base), parameters["vertex_sets"], base
        for k, weight in enumerate(blend_weights(self.sizes, views.width)[1:]):
            # All of them, whatever their weight: which are zero must not decide which kernel runs.
            lane = dr.arange(mi.UInt32, n) + k * n
            out = out + dr.gather(mi.Float, offsets, lane) * dr.opaque(mi.Float, float(weight))
        return out

    def surface(
        self, topology: MeshTopology, positions: mi.Float, base: mi.Float, parameters: dict[str, mi.Float], views: Views
    ) -> Surface:
        """See :class:`.operation.MeshOperation`."""
        return topology.surface(positions)

    def written(self, model: Model, parameters: dict[str, np.ndarray]) -> Model:
        """See :class:`.operation.MeshOperation`."""
        offsets = np.asarray(parameters["vertex_sets"], np.float64).reshape(self._shape)
        return replace(model, vertex_sets=VertexSets(self.sizes, offsets))
