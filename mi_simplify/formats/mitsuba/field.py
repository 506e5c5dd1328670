"""
Parameters of Mitsuba's BSDFs as functions over the texture plane, and as images.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from ...machine.upload import upload

#: Side of the image that a procedural texture is sampled to [texels].
PROCEDURAL = 512

#: Largest side of an image [texels]; larger bitmaps are sampled at this.
LARGEST = 4096


@dataclass(frozen=True)
class Field:
    """
    A quantity of C channels over the texture coordinates of a shape.

    Parameters
    ----------
    at : callable
        Values, shape (N, C), linear, at coordinates of shape (N, 2).
    size : tuple of int
        Rows and columns that show all of it; (1, 1) for a constant.
    to_uv : ndarray, shape (2, 3)
        Affine map from the shape's coordinates to those in which it repeats with period 1.
    """

    at: Callable[[np.ndarray], np.ndarray]
    size: tuple[int, int] = (1, 1)
    to_uv: np.ndarray = field(default_factory=lambda: np.eye(2, 3))

    @property
    def is_constant(self) -> bool:
        """Whether one texel holds it."""
        return self.size == (1, 1)

    @staticmethod
    def constant(*values: float) -> Field:
        """
        The same everywhere.
        """
        row = np.array(values, np.float32)[None]
        return Field(lambda uv: np.broadcast_to(row, (len(uv), len(values))))

    @staticmethod
    def texture(texture: mi.Texture, n_channels: int, to_uv: np.ndarray) -> Field:
        """
        A texture of Mitsuba, looked up by texture coordinates alone.

        Parameters
        ----------
        n_channels : int
            1 for luminance, 3 for linear RGB.
        to_uv : ndarray, shape (2, 3)
            The texture's own transform of coordinates.
        """
        if not texture.is_spatially_varying():
            return Field.constant(*_look_up(texture, np.zeros((1, 2)), n_channels)[0])
        columns, rows = texture.resolution()
        if max(columns, rows) <= 1:
            columns = rows = PROCEDURAL
        size = min(int(rows), LARGEST), min(int(columns), LARGEST)
        return Field(lambda uv: _look_up(texture, uv, n_channels), size, to_uv)

    @staticmethod
    def of(function: Callable[..., np.ndarray], *inputs: Field) -> Field:
        """
        ``function`` of the values of other fields, arrays of shape (N, ·).
        """
        varying = [f for f in inputs if not f.is_constant]
        return Field(
            lambda uv: function(*(f.at(uv) for f in inputs)),
            _largest(inputs),
            varying[0].to_uv if varying else np.eye(2, 3),
        )


def image(fields: Sequence[Field], to_uv: np.ndarray) -> np.ndarray:
    """
    Fields side by side over the unit square of the coordinates that ``to_uv`` leads to.

    Returns
    -------
    ndarray, shape (H, W, C), float32
        One texel where all are constant.
    """
    rows, columns = _largest(fields)
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    uv = (np.stack([u.ravel(), v.ravel()], 1) - to_uv[:, 2]) @ np.linalg.inv(to_uv[:, :2]).T
    return np.concatenate([f.at(uv) for f in fields], 1).reshape(rows, columns, -1).astype(np.float32)


def _largest(fields: Sequence[Field]) -> tuple[int, int]:
    return max(f.size[0] for f in fields), max(f.size[1] for f in fields)


def _interaction(uv: np.ndarray) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.uv = upload(mi.Point2f, uv)
    return si


def _look_up(texture: mi.Texture, uv: np.ndarray, n_channels: int) -> np.ndarray:
    si = _interaction(uv)
    value = mi.Color3f(texture.eval(si)) if n_channels == 3 else mi.Color1f(texture.eval_1(si))
    return _rows(value, len(uv))


def vectors(texture: mi.Texture, to_uv: np.ndarray) -> Field:
    """
    The field of a texture that holds three numbers rather than a colour, such as a normal map.
    """
    plain = Field.texture(texture, 3, to_uv)

    def at(uv: np.ndarray) -> np.ndarray:
        return _rows(mi.Color3f(texture.eval_3(_interaction(uv))), len(uv))

    return Field(at, plain.size, plain.to_uv)


def _rows(value: mi.Color3f, n: int) -> np.ndarray:
    """Values, shape (N, C), also of what Dr.Jit holds as one number for all."""
    return np.broadcast_to(value.numpy().T, (n, len(value)))
