"""
Central finite differences with common random numbers, and the comparison of gradients with them.

Both renderers place their samples on an even pattern in every pixel, so that the two images of a difference see the
same rays and its noise comes only from the strip that an edge moved through.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .scenes import Parameter, State

#: A pair passes within this fraction of the larger of |difference| and a tenth of the group's RMS.
TOLERANCE = 0.01


class Renderer(Protocol):
    """
    What the comparison asks of a renderer; images and adjoints have shape ``shape``.
    """

    start: State
    shape: tuple[int, ...]

    def image(self, state: State, spp: int, seed: int) -> np.ndarray:
        """Image of a state."""

    def gradient(self, adjoint, spp: int, seed: int, attach=None, state: State | None = None) -> State:
        """Backward mode at a state, ``start`` if not given: the derivative of ``sum(adjoint * image)`` by its parts."""


@dataclass
class Estimate:
    """
    Independent estimates of one number.
    """

    values: list[float] = field(default_factory=list)

    @property
    def mean(self) -> float:
        """Their mean."""
        return float(np.mean(self.values)) if self.values else float("nan")

    @property
    def error(self) -> float:
        """Standard error of the mean."""
        n = len(self.values)
        return float(np.std(self.values, ddof=1) / np.sqrt(n)) if n > 1 else float("inf")


@dataclass
class Pair:
    """
    One (mesh, parameter) pair: the finite difference, and what backward mode makes of it.

    ``colour`` is the difference of the colour channels alone, which ``rival``, an estimator without a derivative of
    alpha, is compared with.
    """

    scene: str
    parameter: Parameter
    difference: Estimate = field(default_factory=Estimate)
    ours: Estimate = field(default_factory=Estimate)
    colour: Estimate = field(default_factory=Estimate)
    rival: Estimate = field(default_factory=Estimate)
    scale: float = float("nan")

    @property
    def deviation(self) -> float:
        """(ours - difference) / scale."""
        return (self.ours.mean - self.difference.mean) / self.scale

    @property
    def noise(self) -> float:
        """Standard error of :attr:`deviation`."""
        return float(np.hypot(self.ours.error, self.difference.error)) / self.scale

    @property
    def rival_deviation(self) -> float:
        """(rival - colour difference) / |colour difference|."""
        return (self.rival.mean - self.colour.mean) / abs(self.colour.mean)

    @property
    def passes(self) -> bool:
        """Within 1 %, or within 3 standard errors where these are below 1 %."""
        return self.noise < TOLERANCE and abs(self.deviation) <= max(TOLERANCE, 3 * self.noise)

    def __str__(self) -> str:
        d, o = self.difference, self.ours
        return (
            f"{self.scene}, {self.parameter.name}: difference {d.mean:.4g} ± {d.error:.2g},"
            f" ours {o.mean:.4g} ± {o.error:.2g}, off by {100 * self.deviation:.2f} ± {100 * self.noise:.2f} %"
        )


def shifted(state: State, direction: State, s: float) -> State:
    """
    ``state + s·direction``.
    """
    return state | {k: state[k] + s * v for k, v in direction.items()}


def central_difference(renderer: Renderer, parameter: Parameter, spp: int, seed: int, eps: float | None = None):
    """
    Derivative of the image along a parameter, shape (B, H, W, 4), from two renders with the same seed.
    """
    eps = parameter.eps if eps is None else eps
    low, high = (renderer.image(shifted(renderer.start, parameter.direction, s), spp, seed) for s in (-eps, eps))
    return (high.astype(np.float64) - low) / (2 * eps)


def along(gradient: State, direction: State) -> float:
    """
    Inner product of a gradient with a direction.
    """
    return float(sum(np.sum(gradient[k].astype(np.float64) * v) for k, v in direction.items()))


def set_scales(pairs: list[Pair]) -> None:
    """
    Set every pair's yardstick: max(|difference|, RMS / 10), the RMS over pairs of one scene and group.
    """
    for pair in pairs:
        mates = [p for p in pairs if (p.scene, p.parameter.group) == (pair.scene, pair.parameter.group)]
        rms = np.sqrt(np.mean([p.difference.mean**2 for p in mates]))
        pair.scale = max(abs(pair.difference.mean), rms / 10)


def compare(
    renderer: Renderer,
    scene: str,
    parameters: list[Parameter],
    adjoint: np.ndarray,
    *,
    spp: int = 512,
    gradient_spp: int = 64,
    target: float = 0.006,
    rounds: tuple[int, int] = (8, 240),
    seed: int = 1,
) -> list[Pair]:
    """
    Measure pairs, adding rounds with new seeds until both standard errors are below ``target`` of the yardstick.

    What moves edges is compared with the mean of our derivative over the interval of the difference, which is what a
    central difference of any width equals exactly. So its step can be wide, which makes its noise small.

    Parameters
    ----------
    spp : int
        Samples a pixel of the finite differences of geometry; four times as many for a single vertex, whose edges
        few of them meet, an eighth for parameters that move no edge.
    gradient_spp : int
        Samples a pixel of one gradient; each round of ours takes two.
    rounds : (int, int)
        Least and most; few pairs need many, a thin tube's sideways move about a hundred.
    """
    pairs = [Pair(scene, p) for p in parameters]
    for k in range(rounds[1]):
        todo = [p for p in pairs if k < rounds[0] or p.difference.error > target * p.scale]
        for pair in todo:
            count = int(spp * {"geometry": 1, "vertex": 4}.get(pair.parameter.group, 1 / 8))
            image = central_difference(renderer, pair.parameter, count, seed + k)
            pair.difference.values.append(float(np.sum(image * adjoint)))
            pair.colour.values.append(float(np.sum((image * adjoint)[..., :3])))
        set_scales(pairs)
        if not todo:
            break
    still = [p for p in pairs if not p.parameter.moves_edges]
    for k in range(rounds[1] if still else 0):
        if k >= rounds[0] and all(p.ours.error <= target * p.scale for p in still):
            break
        gradient = renderer.gradient(adjoint, 2 * gradient_spp, 100_000 + seed + k)
        for pair in still:
            pair.ours.values.append(along(gradient, pair.parameter.direction))
    for pair in (p for p in pairs if p.parameter.moves_edges):
        for k in range(rounds[1]):
            if k >= rounds[0] and pair.ours.error <= target * pair.scale:
                break
            attach = tuple(pair.parameter.direction)

            def gradient(state, seed, attach=attach):
                return renderer.gradient(adjoint, gradient_spp, seed, attach, state)

            pair.ours.values.append(mean_over_interval(gradient, renderer.start, pair.parameter, 100_000 + seed + k))
    return pairs


def mean_over_interval(gradient: Callable[[State, int], State], start: State, parameter: Parameter, seed: int) -> float:
    """
    An unbiased estimate of the mean over ``[-eps, eps]`` of the derivative along a parameter, from two places.

    They mirror each other, so that what is odd in the derivative cancels; those of consecutive seeds are spread evenly.

    Parameters
    ----------
    gradient : callable
        Of a state and a seed.
    """
    s = (0.5 + 0.6180339887 * seed) % 1
    return float(np.mean([
        along(gradient(shifted(start, parameter.direction, t * parameter.eps), 2 * seed + j), parameter.direction)
        for j, t in enumerate((-s, s))
    ]))  # fmt: skip
