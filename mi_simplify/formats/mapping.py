"""
Where the textures of a material are looked up: one set of coordinates, moved once for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .resources import Resources


@dataclass(frozen=True)
class Mapping:
    """
    Texture coordinates of a material.

    Parameters
    ----------
    set : int or str
        glTF's TEXCOORD set, or USD's primvar.
    transform : ndarray, shape (2, 3), or None
        Affine map applied to the coordinates of the file; None for the identity.
    wraps : tuple of {'repeat', 'mirror', 'clamp', 'black'}
        Wrap modes along u and v that the file asks for.
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

    def apply(self, uvs: np.ndarray, part: str, resources: Resources) -> np.ndarray:
        """
        Coordinates of the file, shape (V, 2), moved; notes where textures repeat against the file's wish.
        """
        uvs = np.asarray(uvs, np.float64)
        if self.transform is not None:
            uvs = uvs @ self.transform[:, :2].T + self.transform[:, 2]
        for axis, wrap in enumerate(self.wraps):
            outside = max(-uvs[:, axis].min(initial=0), uvs[:, axis].max(initial=0) - 1)
            if wrap != "repeat" and outside > 1e-3:
                resources.note(f"textures of '{part}' repeat outside [0, 1], where the file asks for '{wrap}'")
        return uvs
