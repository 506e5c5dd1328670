"""
Cameras that follow a character: views of a thing at rest, moved to where it is in a frame of its clip.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..model.rigging import Rigging
from ..scenes.views import Views


def following(draw: Callable, rigging: Rigging | None, per_frame: int) -> Callable:
    """
    A function that draws views of random frames; of what has no rig, the function that was given.

    Parameters
    ----------
    draw : callable
        ``draw(n, rng, resolution) -> list of Views`` of what lies in the box of side 2 around the origin.
    rigging : Rigging, optional
        Says which frames are fitted, and where the character is then.
    per_frame : int
        Views of one frame, which make an instant.
    """
    if rigging is None:
        return draw

    def followed(n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
        out = []
        for views in draw(n, rng, resolution):
            starts = range(0, len(views), per_frame)
            frames = rng.choice(rigging.fitted, len(starts), replace=len(starts) > len(rigging.fitted))
            for start, frame in zip(starts, frames, strict=True):
                index = np.arange(start, min(start + per_frame, len(views)))
                out.append(moved(views.take(index), rigging.boxes[frame], frame))
        return out

    return followed


def moved(views: Views, box: np.ndarray, frame: int) -> Views:
    """
    Views of the box of side 2 around the origin as views of another box, shape (2, 3), in a frame.

    All sizes scale by the box's longest side; intensities follow the squared distance, so that radiance stays.
    """
    scale, center = (box[1] - box[0]).max() / 2, box.mean(0)
    arrays = views.arrays()
    for name in ("origin", "light_position"):
        arrays[name] = arrays[name] * scale + center
    arrays["light_intensity"] = arrays["light_intensity"] * scale**2
    arrays["frame"] = np.full(len(views), frame)
    return Views.from_arrays(arrays, views.width, views.height)
