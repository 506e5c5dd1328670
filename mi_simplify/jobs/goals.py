"""
The least model that is good enough: a likeness, or a size on the screen at which nobody sees the difference.

Each puts first guesses on a scale, and knows about how much a fit adds on it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..config import Config
from ..config.amounts import GoalSettings
from ..config.presets import prefiltering
from ..export import as_exported
from ..judging.evaluate import Judging
from ..judging.metrics import COVERED, flip_maps
from ..judging.screen import Screen
from ..judging.switching import film_of, views_of
from ..model.model import Model
from ..scenes.views import held_out_views
from ..subjects import Subject

THRESHOLD = 0.04
"""FLIP over what is covered, without aliasing, below which a difference is not seen, as between levels of detail."""

LARGEST_FILM = 512
"""A model for larger images than this is an ordinary run: one sample shows it well [pixels]."""

_SPP = 16
"""Samples per pixel of a guess on the screen."""


class Goal(ABC):
    """
    What is to be reached, on a scale that rises about evenly with the logarithm of the triangles.

    Attributes
    ----------
    name : str
        What the goal is called in a message.
    value : float
        As somebody put it.
    """

    name: str
    slope: float
    """How much the scale rises where the triangles double, as a first estimate."""
    gain: float
    """How much a fit adds on it, with the default settings and those of `fast`: the mean of what was measured."""

    def __init__(self, value: float):
        self.value = value

    @property
    @abstractmethod
    def wanted(self) -> float:
        """The goal on the scale."""

    @abstractmethod
    def of_guess(self, subject: Subject, guess: Model) -> float:
        """Where a first guess, in the normalised frame, stands on the scale."""

    @abstractmethod
    def reached(self, subject: Subject, figures: Mapping[str, Any], model: Model) -> float:
        """What a fitted model, in the normalised frame, has reached, in the unit of the goal."""

    def prepared(self, config: Config, subject: Subject) -> Config:
        """The configuration with which such a model is made."""
        return config

    def verdict(self, reached: float, triangles: int) -> tuple[str, bool]:
        """A line for a person, and whether the goal is reached."""
        missed = self._scale(reached) - self.wanted
        is_reached = missed >= -_TOLERANCE * self.slope
        line = f"{self.name} {self.value:g}: {self.shown(reached)} with {triangles} triangles"
        if not is_reached:
            more = round(triangles * 2 ** (-missed / self.slope) / 10) * 10
            line += f", which misses it; ask for about --triangles {more}"
        return line, is_reached

    @abstractmethod
    def _scale(self, value: float) -> float:
        """From the unit of the goal to the scale."""

    def shown(self, value: float) -> str:
        """A figure in the unit of the goal."""
        return f"{value:.4f}"


_TOLERANCE = 0.025
"""Doublings of the triangles by which a goal may be missed unsaid: the noise of figures."""


class Psnr(Goal):
    """PSNR on held-out views, at least so many dB."""

    name, slope, gain = "--psnr", 4.0, 0.35

    @property
    def wanted(self) -> float:
        """See :class:`Goal`."""
        return self.value

    def of_guess(self, subject: Subject, guess: Model) -> float:
        """See :class:`Goal`."""
        return self._scale(_figures(subject, guess)["psnr"])

    def reached(self, subject: Subject, figures: Mapping[str, Any], model: Model) -> float:
        """See :class:`Goal`."""
        return float(figures["candidates"]["result"]["psnr"])

    def _scale(self, value: float) -> float:
        return value

    def shown(self, value: float) -> str:
        """See :class:`Goal`."""
        return f"{value:.2f} dB on held-out views"


class Flip(Goal):
    """FLIP on held-out views, at most so much; the scale is its negative logarithm of base 2."""

    name, slope, gain = "--flip", 0.7, 0.0

    @property
    def wanted(self) -> float:
        """See :class:`Goal`."""
        return self._scale(self.value)

    def of_guess(self, subject: Subject, guess: Model) -> float:
        """See :class:`Goal`."""
        return self._scale(_figures(subject, guess)["flip"])

    def reached(self, subject: Subject, figures: Mapping[str, Any], model: Model) -> float:
        """See :class:`Goal`."""
        return float(figures["candidates"]["result"]["flip"])

    def _scale(self, value: float) -> float:
        return -float(np.log2(max(value, 1e-6)))

    def shown(self, value: float) -> str:
        """See :class:`Goal`."""
        return f"{value:.4f} on held-out views"


class ScreenSize(Flip):
    """
    FLIP below the threshold at which nobody sees a difference, over what either covers, where the bounding sphere has
    this diameter on the screen [pixels].
    """

    name, slope, gain = "--screen-size", 0.7, 0.0

    @property
    def wanted(self) -> float:
        """See :class:`Goal`."""
        return self._scale(THRESHOLD)

    def prepared(self, config: Config, subject: Subject) -> Config:
        """See :class:`Goal`: prefiltered for images of that size."""
        film = film_of(self.value, _bounds(subject), config.views)
        if film > LARGEST_FILM or config.optimizer.target_resolution is not None:
            return config
        config = config.started(prefiltering(film))
        optimizer = config.optimizer.model_copy(update={"target_resolution": film})
        return config.model_copy(update={"optimizer": optimizer})

    def of_guess(self, subject: Subject, guess: Model) -> float:
        """See :class:`Goal`."""
        return self._scale(self._difference(subject, guess))

    def reached(self, subject: Subject, figures: Mapping[str, Any], model: Model) -> float:
        """See :class:`Goal`."""
        return self._difference(subject, model)

    def shown(self, value: float) -> str:
        """See :class:`Goal`."""
        return f"FLIP {value:.4f}, where {THRESHOLD:g} is not seen,"

    def _difference(self, subject: Subject, model: Model) -> float:
        size = int(max(16, 4 * round(self.value / 4)))
        views = held_out_views(_bounds(subject), views_of(size, 6), size, seed=7)
        if not hasattr(self, "_target"):
            self._target = _supersampled(subject).render(views, 7)
        images = Screen(model, form=subject.config.latent.shading, mips="none").images(views, spp=_SPP)
        covered = np.maximum(self._target[..., 3], images[..., 3]) > 1 - COVERED
        return float(flip_maps(self._target, images)[covered].mean()) if covered.any() else 0.0


def goal_of(settings: GoalSettings) -> Goal | None:
    """
    The goal that a configuration has.
    """
    kinds: dict[str, type[Goal]] = {"psnr": Psnr, "flip": Flip, "screen_size": ScreenSize}
    return next((kind(v) for name, kind in kinds.items() if (v := getattr(settings, name)) is not None), None)


def _figures(subject: Subject, guess: Model) -> Mapping[str, Any]:
    """Figures of a first guess as of a result: with fewer samples their noise would count against it."""
    candidates = {"guess": as_exported(subject.frame.restored(guess))}
    comparison = subject.judge(candidates, Judging.of(subject.config))
    return comparison.figures["candidates"]["guess"]


def _bounds(subject: Subject) -> np.ndarray:
    """Box of the subject in the normalised frame, shape (2, 3)."""
    frame = subject.frame
    return np.stack([(corner - frame.center) * frame.scale for corner in subject.geometry.bounds])


def _supersampled(subject: Subject) -> Any:
    """The subject's reference with so many samples that their noise does not count."""
    settings = subject.config.reference.supersampled()
    return subject.under(subject.config.model_copy(update={"reference": settings})).reference()
