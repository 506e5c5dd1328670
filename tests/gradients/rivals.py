"""
Mitsuba's own estimators of visibility gradients, on scenes where they render the image that `direct_edge` does.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from .finite_difference import Pair, along, compare, mean_over_interval
from .mitsuba_cases import CASES
from .mitsuba_scene import MitsubaScene

#: Plugins, and options that limit them to direct light.
RIVALS = {"direct_projective": {}, "prb_projective": {"max_depth": 2}}

#: Where the light stands: on the line from the ball to the camera, three times as far. It sees all of the ball that the
#: camera sees and more: no shadow is in the picture, and the surface is lit where it turns away from the viewer.
_BEHIND = np.float64([1.2, 1.8, -9.0])


def rival(name: str, samples: int, *, edges: int | None = None, shadows: int = 0, hide_emitters: bool = True):
    """
    One of :data:`RIVALS`; use with ``spp=0``.

    Parameters
    ----------
    samples, edges : int
        A pixel, of camera rays and of silhouettes (``samples`` if None).
    shadows : int
        A pixel, of the borders of shadows: its indirect term.
    """
    counts = {"sppc": samples, "sppp": samples if edges is None else edges, "sppi": shadows}
    return mi.load_dict({"type": name, **RIVALS[name], **counts, "hide_emitters": hide_emitters})


def without_shadows(title: str) -> MitsubaScene:
    """
    A scene of :data:`CASES`, with its point light where no shadow is seen, unless it is about shadows.
    """
    scene = CASES[title]()
    if "light" in scene.start and not scene.options.get("shadows"):
        brighter = np.sum(_BEHIND**2) / np.sum(scene.start["light"] ** 2)
        scene.start["light"] = _BEHIND
        scene.params["light.intensity.value"] *= float(brighter)
        scene.params.update()
    return scene


@dataclass
class Beside:
    """
    One pair, and what each rival makes of it: values of independent seeds, or the first line of its error.
    """

    pair: Pair
    rivals: dict[str, list[float] | str]


def measure_beside(
    title: str, names: tuple[str, ...] = ("translation", "growth"), repeats: int = 4, **options
) -> list[Beside]:
    """
    Colour alone, since the rivals have no derivative of alpha; 64 camera and 64 edge samples a pixel for each of them,
    at ``repeats`` pairs of places in the interval of the difference. ``options`` go to :func:`compare`.
    """
    scene = without_shadows(title)
    wanted = [p for p in scene.parameters() if p.name in names]
    adjoint = scene.weights() * np.float32([1, 1, 1, 0])
    pairs = compare(scene, title, wanted, adjoint, **({"spp": 256, "gradient_spp": 32} | options))
    out = [Beside(pair, {}) for pair in pairs]
    for name in RIVALS:
        shadows = 64 if scene.options.get("shadows") else 0
        integrator = rival(name, 64, shadows=shadows, hide_emitters=scene.options.get("hide_emitters", True))
        for beside in out:
            beside.rivals[name] = _values(scene, beside.pair, integrator, adjoint, repeats)
    return out


def _values(scene, pair: Pair, integrator, adjoint: np.ndarray, repeats: int) -> list[float] | str:
    attach = tuple(pair.parameter.direction)

    def gradient(state, seed):
        return scene.gradient(adjoint, 0, seed, attach, state, integrator)

    try:
        along(gradient(scene.start, 1), pair.parameter.direction)
    except Exception as error:  # Mitsuba raises plain ones, too, where it cannot
        return str(error).strip().splitlines()[-1]
    return [mean_over_interval(gradient, scene.start, pair.parameter, 200_000 + k) for k in range(repeats)]
