"""
Steps on the cameras that look at a head, and on its scale.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.upload import upload
from ...scenes.views import Views
from ..parameters.adam import Adam


class PoseSteps:
    """
    Poses ``x = R Q p + t`` of a point p of the model in the frames of B cameras, X to the right, Y down, Z ahead: R is
    where they start, Q a rotation about the origin in Rodrigues' parameters a, ``Q v = v + 2 (a × v + a × (a × v)) /
    (1 + |a|²)``.

    Parameters
    ----------
    rotations : ndarray, shape (B, 3, 3)
    translations : ndarray, shape (B, 3)
    scale : float
        Units of the depth maps by units of the model.
    tan : float
        Tangent of half the field of view of the square film.
    resolution : int
        Its side [pixels].
    rate, scale_rate : float
        Typical step of poses [radians, units of the model], and of the scale's logarithm.
    """

    def __init__(
        self,
        rotations: np.ndarray,
        translations: np.ndarray,
        scale: float,
        tan: float,
        resolution: int,
        rate: float,
        scale_rate: float,
    ):
        n = len(rotations)
        self._axes = [upload(mi.Vector3f, rotations[:, k]) for k in range(3)]
        self._still = {
            "tan_x": dr.opaque(mi.Float, tan, n), "frame": dr.opaque(mi.Float, 0, n), "width": resolution,
            "height": resolution, "light_position": dr.opaque(mi.Point3f, 0, n),
            "light_intensity": dr.opaque(mi.Color3f, 0, n),
        }  # fmt: skip
        self._steps = {
            "turn": Adam(np.zeros((n, 3)), rate / 2),
            "place": Adam(translations, rate),
            "scale": Adam(np.log([scale]), scale_rate),
        }

    def leaves(self) -> dict[str, mi.Float]:
        """The parameters, ready to collect gradients."""
        out = {name: mi.Float(adam.value) for name, adam in self._steps.items()}
        dr.enable_grad(*out.values())
        return out

    def views(self, leaves: dict[str, mi.Float]) -> Views:
        """The cameras; differentiable in :meth:`leaves`."""
        index = dr.arange(mi.UInt32, len(self))
        a, t = (dr.gather(mi.Vector3f, leaves[name], index) for name in ("turn", "place"))
        factor = 2 * dr.rcp(1 + dr.squared_norm(a))
        right, down, forward = (r + factor * dr.cross(a, dr.cross(a, r) - r) for r in self._axes)  # by -a: backwards
        origin = mi.Point3f(-(right * t.x + down * t.y + forward * t.z))
        return Views(origin=origin, right=right, up=-down, forward=forward, **self._still)

    def scale(self, leaves: dict[str, mi.Float]) -> mi.Float:
        """Units of the depth maps by units of the model, width 1; differentiable."""
        return dr.exp(leaves["scale"])

    def still(self) -> Views:
        """The cameras as they are, without gradients."""
        with dr.suspend_grad():
            views = self.views({name: adam.value for name, adam in self._steps.items()})
        for field in dataclasses.fields(views):
            dr.eval(getattr(views, field.name))
        return views

    def step(self, leaves: dict[str, mi.Float], factor: float) -> None:
        """One update from the gradients of leaves; ``factor`` scales all rates."""
        for name, adam in self._steps.items():
            adam.step(dr.grad(leaves[name]), factor)

    def value_of_scale(self) -> float:
        """The scale, read back."""
        return float(np.exp(self._steps["scale"].value.numpy()[0]))

    def __len__(self) -> int:
        return dr.width(self._axes[0])
