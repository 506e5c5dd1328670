"""
Faces by what of their material cannot be painted into a texture: how they are transparent, whether their back is seen,
and lobes that the fit does not know.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .asset import Material, Part

#: Opacity from which a surface counts as opaque.
_OPAQUE = 0.999


@dataclass(frozen=True)
class Group:
    """
    What the faces of a group have in common.

    Parameters
    ----------
    name : str
        Of the material.
    alpha_mode : {'OPAQUE', 'MASK', 'BLEND'}
    alpha_cutoff : float
    double_sided : bool
    lobes : mapping
        See :attr:`.asset.Material.lobes`.
    """

    name: str = "model"
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = True
    lobes: Mapping[str, Any] = field(default_factory=dict)

    def like(self, other: Group) -> bool:
        """Whether both can be one, whatever their names."""
        same = (self.alpha_mode, self.double_sided, self.lobes) == (other.alpha_mode, other.double_sided, other.lobes)
        return same and (self.alpha_mode != "MASK" or self.alpha_cutoff == other.alpha_cutoff)


@dataclass(frozen=True)
class Groups:
    """
    The groups of a mesh.

    Parameters
    ----------
    kinds : tuple of Group
    of_face : ndarray, shape (F,), int64
        Index into ``kinds``.
    """

    kinds: tuple[Group, ...]
    of_face: np.ndarray

    def solid(self, least_opacity: np.ndarray) -> Groups:
        """
        The groups, those opaque whose texels turned out to be, shape (groups,), as decals on what they lie on do; what
        then is alike becomes one. Masks are cut at one half: what a bake averages is the share of a texel that is seen.
        """
        kinds: list[Group] = []
        new = []
        for kind, least in zip(self.kinds, least_opacity, strict=True):
            kind = replace(kind, alpha_mode="OPAQUE") if least >= _OPAQUE else kind
            kind = replace(kind, alpha_cutoff=0.5) if kind.alpha_mode == "MASK" else kind
            k = next((k for k, other in enumerate(kinds) if other.like(kind)), len(kinds))
            kinds += [kind] if k == len(kinds) else []
            new.append(k)
        return Groups(tuple(kinds), np.array(new, np.int64)[self.of_face])

    def split(self, times: int) -> Groups:
        """Of a mesh whose faces are split in four so often, block after block."""
        return Groups(self.kinds, np.tile(self.of_face, 4**times))


def is_see_through(part: Part) -> bool:
    """
    Whether anything can be seen through a part: its material says so, and somewhere it is not opaque.
    """
    material = part.material
    if material.alpha_mode == "OPAQUE":
        return False
    least = float(material.base_color[..., 3].min()) * (1 if part.colors is None else float(part.colors[:, 3].min()))
    return least < _OPAQUE


def group_of(parts: list[Part]) -> Group:
    """
    The group of parts of one material.
    """
    material: Material = parts[0].material
    mode = material.alpha_mode if any(is_see_through(part) for part in parts) else "OPAQUE"
    return Group(material.name, mode, material.alpha_cutoff, material.double_sided, material.lobes)


def overall(groups: Groups) -> tuple[str, float]:
    """
    Alpha mode and cutoff under which all groups look as they should, as opaque ones have opacity 1 in their textures.
    """
    modes = [kind for kind in groups.kinds if kind.alpha_mode != "OPAQUE"]
    if not modes:
        return "OPAQUE", 0.5
    cutoffs = {kind.alpha_cutoff for kind in modes}
    if any(kind.alpha_mode == "BLEND" for kind in modes) or len(cutoffs) > 1:
        return "BLEND", 0.5
    return "MASK", 0.5
