"""
Steps on all that the rendered positions are made of: base vertices, and what the mesh operation has besides.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...latent.operation import MeshOperation
from ...scenes.views import Views
from .adam import Adam
from .vertices import VertexSteps


@dataclass
class Pose:
    """
    One evaluation of a mesh operation: leaves to collect gradients in, and what they were made into.

    Parameters
    ----------
    positions : mi.Float, width P·3
        Rendered positions, a leaf: the renderer adds its gradients here.
    base : mi.Float
        Base positions, a leaf: a regulariser may add its gradients here.
    parameters : dict of str to mi.Float
        Of the operation, leaves.
    views : Views
        That it was evaluated for.
    """

    positions: mi.Float
    base: mi.Float
    parameters: dict[str, mi.Float]
    views: Views
    _made: mi.Float
    _smooth: mi.Float


class ShapeSteps:
    """
    Optimisers of the shape.

    Parameters
    ----------
    operation : MeshOperation
    optimize : collection of str
        Quantities that change; others stay as they are.
    rates : mapping of str to float
        Of ``vertices`` and of each parameter of the operation.
    lambda_ : float
        Diffusion of the vertices' steps, see :class:`.vertices.VertexSteps`.
    """

    def __init__(self, operation: MeshOperation, optimize: Collection[str], rates: Mapping[str, float], lambda_: float):
        base = operation.base
        self.operation = operation
        self.vertices = VertexSteps(base.positions, base.position_faces, rates["vertices"], lambda_)
        self._others = {name: Adam(value, rates[name]) for name, value in operation.parameters.items()}
        self._parts: dict[str, VertexSteps | Adam] = {"vertices": self.vertices, **self._others}
        self._moving = [name for name in ("vertices", *self._others) if name in optimize]

    @property
    def moves(self) -> bool:
        """Whether anything of the shape is optimised."""
        return bool(self._moving)

    def pose(self, views: Views) -> Pose:
        """
        The shape as views of one frame and film size show it, its leaves ready to collect gradients.
        """
        smooth = self.vertices.positions()
        base = mi.Float(dr.detach(smooth))
        parameters = {name: mi.Float(adam.value) for name, adam in self._others.items()}
        for name, leaf in (("vertices", base), *parameters.items()):
            if name in self._moving:
                dr.enable_grad(leaf)
        made = self.operation.positions(base, parameters, views)
        positions = mi.Float(dr.detach(made))
        if self.moves:
            dr.enable_grad(positions)
        return Pose(positions, base, parameters, views, made, smooth)

    def still(self, views: Views) -> Pose:
        """
        The shape as views show it, without gradients.
        """
        with dr.suspend_grad():
            base = dr.detach(self.vertices.positions())
            parameters = {name: adam.value for name, adam in self._others.items()}
            positions = self.operation.positions(base, parameters, views)
        return Pose(positions, base, parameters, views, positions, base)

    def step(self, pose: Pose, factor: float) -> None:
        """
        One update from the gradients that were collected in a pose; ``factor`` scales all rates.
        """
        if not self.moves:
            return
        if dr.grad_enabled(pose._made):
            dr.accum_grad(pose._made, dr.grad(pose.positions))
            if pose._made.index_ad != pose.base.index_ad:  # a leaf has nothing behind it
                dr.enqueue(dr.ADMode.Backward, pose._made)
                dr.traverse(dr.ADMode.Backward)
        if "vertices" in self._moving:
            self.vertices.step(dr.grad(pose.base), pose._smooth, factor)
        for name in self._others.keys() & set(self._moving):
            self._others[name].step(dr.grad(pose.parameters[name]), factor)

    def values(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """
        Base positions, flat, and the operation's parameters, in NumPy.
        """
        base = dr.detach(self.vertices.positions()).numpy()
        return base, {name: adam.value.numpy().copy() for name, adam in self._others.items()}

    def parameters(self) -> dict[str, np.ndarray]:
        """
        What is optimised, as copies.
        """
        others = {name: adam.value.numpy().copy() for name, adam in self._others.items()}
        return {"u": self.vertices.state()["u"], **others}

    def restart(self, parameters: Mapping[str, np.ndarray]) -> None:
        """
        Go on from earlier :meth:`parameters`, the moments forgotten.
        """
        self.vertices.restart(parameters["u"])
        for name, adam in self._others.items():
            adam.restart(parameters[name])

    def not_finite(self) -> str | None:
        """
        What is no longer finite; None where all is well.
        """
        return next((name for name, part in self._parts.items() if not part.is_finite()), None)

    def state(self) -> dict:
        """
        All that later steps depend on, as copies.
        """
        return {name: part.state() for name, part in self._parts.items()}

    def restore(self, state: dict) -> None:
        """
        Inverse of :meth:`state`.
        """
        for name, part in self._parts.items():
            part.restore(state[name])
