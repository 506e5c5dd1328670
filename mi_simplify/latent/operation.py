"""
Between the vertices that are optimised and those that are rendered: the paper's mesh operations, as one interface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import mitsuba as mi
import numpy as np

from ..model.mesh import Mesh
from ..model.model import Model
from ..registry import Registry
from ..scenes.views import Views
from .surface import MeshTopology, Surface


class MeshOperation(Protocol):
    """
    How base positions and further parameters make the positions that are rendered.

    Attributes
    ----------
    base : Mesh
        Its welded positions are optimised, with the Laplacian on them.
    mesh : Mesh
        What is rendered, at rest; its topology stays.
    parameters : dict of str to ndarray
        First values of what is optimised besides, flat; each name is one of the configuration's quantities and has a
        rate of that name.
    """

    base: Mesh
    mesh: Mesh
    parameters: dict[str, np.ndarray]

    def positions(self, base: mi.Float, parameters: dict[str, mi.Float], views: Views) -> mi.Float:
        """
        Welded positions of ``mesh``, flat, as these views show them; differentiable in the first two.

        Parameters
        ----------
        base : mi.Float, width P·3
        parameters : dict of str to mi.Float
        views : Views
            All of one film size and of one frame of the animation.
        """
        ...

    def surface(
        self, topology: MeshTopology, positions: mi.Float, base: mi.Float, parameters: dict[str, mi.Float], views: Views
    ) -> Surface:
        """
        What is rendered at the positions that :meth:`positions` made of the rest; differentiable in all three.

        Parameters
        ----------
        topology : MeshTopology
            Of ``mesh``.
        """
        ...

    def written(self, model: Model, parameters: dict[str, np.ndarray]) -> Model:
        """
        The model with these parameters; its positions are up to date.
        """
        ...


class Identity:
    """
    Rendered is what is optimised.
    """

    def __init__(self, model: Model):
        self.base = self.mesh = model.mesh
        self.parameters: dict[str, np.ndarray] = {}

    def positions(self, base: mi.Float, parameters: dict[str, mi.Float], views: Views) -> mi.Float:
        """See :class:`MeshOperation`."""
        return base

    def surface(
        self, topology: MeshTopology, positions: mi.Float, base: mi.Float, parameters: dict[str, mi.Float], views: Views
    ) -> Surface:
        """See :class:`MeshOperation`."""
        return topology.surface(positions)

    def written(self, model: Model, parameters: dict[str, np.ndarray]) -> Model:
        """See :class:`MeshOperation`."""
        return model


@dataclass(frozen=True)
class _Kind:
    """Which models an operation is for, and how it is made."""

    applies: Callable[[Model], bool]
    make: Callable[[Model], MeshOperation]


OPERATIONS: Registry[_Kind] = Registry("mesh operation")


def register_operation(
    name: str, applies: Callable[[Model], bool], make: Callable[[Model], MeshOperation], *, replace: bool = False
) -> None:
    """
    Make a mesh operation known: of those that apply to a model, the last registered is taken.

    Parameters
    ----------
    name : str
    applies : callable
        Whether a model asks for it; a subclass of :class:`..model.model.Model` may hold what it needs.
    make : callable
        The operation of such a model.

    Raises
    ------
    ValueError
        The name is taken.
    """
    OPERATIONS.register(name, _Kind(applies, make), replace=replace)


def operation_of(model: Model) -> MeshOperation:
    """
    The operation that a model asks for.
    """
    return next(kind.make(model) for _, kind in OPERATIONS.latest_first() if kind.applies(model))


register_operation("identity", lambda model: True, Identity)
