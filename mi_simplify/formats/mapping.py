"""
Where the textures of a material are looked up: coordinates of the file, moved, and what lies beyond the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.asset import PLAIN, Lookup


@dataclass(frozen=True)
class Mapping:
    """
    Texture coordinates of one texture.

    Parameters
    ----------
    set : int or str
        glTF's TEXCOORD set, or USD's primvar.
    transform : ndarray, shape (2, 3), or None
        Affine map applied to the coordinates of the file; None for the identity.
    wraps : tuple of {'repeat', 'mirror', 'clamp'}
        Wrap modes along u and v.
    """

    set: int | str = 0
    transform: np.ndarray | None = None
    wraps: tuple[str, str] = ("repeat", "repeat")

    def same_place(self, other: Mapping) -> bool:
        """
        Whether both look up at the same coordinates.
        """
        a, b = ((np.eye(2, 3) if m.transform is None else m.transform) for m in (self, other))
        return self.set == other.set and np.allclose(a, b, atol=1e-7)

    def apply(self, uvs: np.ndarray) -> np.ndarray:
        """
        Coordinates of the file, shape (V, 2), moved.
        """
        uvs = np.asarray(uvs, np.float64)
        return uvs if self.transform is None else uvs @ self.transform[:, :2].T + self.transform[:, 2]


def placed(places: Sequence[Mapping], found: Sequence[np.ndarray | None]) -> list[Any]:
    """
    The coordinates of a part, moved to where its textures are looked up.

    Parameters
    ----------
    places : sequence of Mapping
        Of the material; none where it has no textures.
    found : sequence of ndarray, shape (V, 2), or None
        The file's coordinates for each of them, None where it has none; one entry without textures.

    Returns
    -------
    list of ndarray, shape (V, 2), or None
        :attr:`..model.asset.Part.uvs`, then the further ones; those that are missing are 0 where others are there.
    """
    moved = [x if x is None or not places else places[k].apply(x) for k, x in enumerate(found)]
    n = next((len(x) for x in moved if x is not None), None)
    return moved if n is None else [np.zeros((n, 2)) if x is None else x for x in moved]


class Mappings:
    """
    The mappings of all textures of a material, as its reader meets them.
    """

    def __init__(self) -> None:
        self._of: dict[str, Mapping] = {}

    def take(self, texture: str, mapping: Mapping) -> bool:
        """
        Note where an image for a texture of :class:`..model.asset.Material` is looked up.

        Returns
        -------
        bool
            False where another image of the same texture is looked up elsewhere, so that this one cannot join it.
        """
        known = self._of.setdefault(texture, mapping)
        return known.same_place(mapping) and known.wraps == mapping.wraps

    def same(self, first: str, second: str) -> bool:
        """
        Whether images of two textures lie on one another; so does one without an image.
        """
        a, b = self._of.get(first), self._of.get(second)
        return a is None or b is None or (a.same_place(b) and a.wraps == b.wraps)

    @property
    def places(self) -> tuple[Mapping, ...]:
        """The distinct coordinates, those of the normal map first; empty without textures."""
        out: list[Mapping] = []
        for texture in sorted(self._of, key=lambda name: name != "normal"):
            if not any(self._of[texture].same_place(other) for other in out):
                out.append(self._of[texture])
        return tuple(out)

    @property
    def lookups(self) -> dict[str, Lookup]:
        """What :attr:`..model.asset.Material.lookups` is, over :attr:`places`."""
        places, out = self.places, {}
        for texture, mapping in self._of.items():
            k = next(k for k, place in enumerate(places) if place.same_place(mapping))
            if (lookup := Lookup(k, mapping.wraps)) != PLAIN:
                out[texture] = lookup
        return out
