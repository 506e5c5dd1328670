"""
How good predicted transfer is: its mean absolute error, and pictures under skies that no model has seen.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..judging.metrics import tonemap
from .cast import unshadowed
from .dataset import Dataset
from .light import SKIES, sky
from .picture import Camera, seen

Model = Callable[[np.ndarray, np.ndarray], np.ndarray]


def judge(data: Dataset, models: dict[str, Model], size: int = 128) -> dict[str, dict[str, float]]:
    """
    Figures of models over the held-out frames.

    Parameters
    ----------
    data : Dataset
    models : dict
        By name: transfer (T, n², K) from positions and normals (T, n², 3). ``unshadowed`` is added.
    size : int
        Of the pictures [px].

    Returns
    -------
    dict
        By name: ``l1``, mean absolute error of the coefficients; ``psnr`` [dB], tone mapped, over pixels that the
        object covers, mean over frames and the three skies.
    """
    frames = data.held_out
    p, n, truth = data.positions[frames], data.normals[frames], data.transfer[frames]
    order = round(truth.shape[2] ** 0.5) - 1
    guesses = {name: model(p, n) for name, model in models.items()}
    guesses["unshadowed"] = unshadowed(n, order, data.albedo)
    camera = Camera.around(p, 40, 25)
    lights = [sky(name, order) for name in SKIES]
    errors: dict[str, list[float]] = {name: [] for name in guesses}
    for k in range(len(frames)):
        hits = seen(p[k], data.faces, camera, size)
        if not hits.covered.any():
            continue
        for light in lights:
            wanted = tonemap(hits.shaded(truth[k], light))[hits.covered]
            for name, guess in guesses.items():
                shown = tonemap(hits.shaded(guess[k], light))[hits.covered]
                errors[name].append(float(((shown - wanted) ** 2).mean()))
    return {
        name: {
            "l1": float(np.abs(guess - truth).mean()),
            "psnr": float(np.mean(-10 * np.log10(np.maximum(errors[name], 1e-10)))),
        }
        for name, guess in guesses.items()
    }
