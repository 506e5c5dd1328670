"""
The look of a Mitsuba BSDF, as fields over texture coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .field import Field
from .file import Node


@dataclass(frozen=True)
class Look:
    """
    What a shape looks like, as fields over its texture coordinates.

    Parameters
    ----------
    color : Field
        Linear RGB.
    gamma, roughness, metallic : Field
    opacity : Field or None
        None for opaque.
    normal : Field or None
        Vectors in tangent space; of the first UV direction and, as bitangent, the cross product of normal and tangent.
    normal_follows_charts : bool
        Whether the bitangent points up the image in mirrored charts too, as MikkTSpace has it.
    cutoff : float
        Opacity threshold, 0 for none.
    at_vertices : bool
        Whether the base colour is to be had at points of the shape only (vertex attributes, BSDFs unknown here).
    has_surface : bool
        False for ``null``, which bounds a medium.
    """

    color: Field = Field.constant(0.5, 0.5, 0.5)  # noqa: RUF009 (immutable)
    gamma: Field = Field.constant(0.0)  # noqa: RUF009
    roughness: Field = Field.constant(0.5)  # noqa: RUF009
    metallic: Field = Field.constant(0.0)  # noqa: RUF009
    opacity: Field | None = None
    normal: Field | None = None
    normal_follows_charts: bool = False
    cutoff: float = 0.0
    at_vertices: bool = False
    has_surface: bool = True


def texture_transform(texture: Node) -> np.ndarray:
    """
    The transform of coordinates of a texture, shape (2, 3).
    """
    if "to_uv" not in texture.values:
        return np.eye(2, 3)
    numbers = np.array(texture.values["to_uv"].matrix, np.float64).reshape(-1)
    m = numbers.reshape(int(round(len(numbers) ** 0.5)), -1)
    return np.column_stack([m[:2, :2], m[:2, -1]])


WHITE = Field.constant(1.0, 1.0, 1.0)

#: Mitsuba's default BSDF, Lambert alone.
DEFAULT = Look(roughness=Field.constant(1.0))
