"""
The budget of triangles for a goal.

First guesses are quick to make and to judge, and a fit improves all of them by about as much. So the budget is searched
for among first guesses, with that much taken off the goal; then one model is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..config import Config, load_config
from ..config.amounts import LEAST_TRIANGLES, GoalSettings
from ..errors import ConfigError, MeshError
from ..judging.kept_pictures import KeptPictures
from ..progress import Progress, ProgressCallback, silent
from ..subjects import Subject, open_subject
from .goals import Goal, ScreenSize, goal_of

LEVEL_SIZES = (512, 256, 128, 64)
"""Diameters of the bounding sphere that levels are looked for at [pixels]."""

_APART = 0.7
"""A level has at most this share of the triangles of the one above, or it is none."""

_ROUNDS = 4
"""Numbers of triangles that are tried at most."""

_NEAR = 0.05
"""Logarithm of the triangles by which a next guess must differ to be worth making."""


@dataclass(frozen=True)
class Found:
    """
    The budget for a goal.

    Parameters
    ----------
    config : Config
        With the budget in place of the goal, so that it can be run again as it is.
    goal : Goal
    tried : dict of int to float
        Where first guesses of so many triangles stood on the goal's scale.
    kept : KeptPictures
        Of the subject.
    """

    config: Config
    goal: Goal
    tried: dict[int, float]
    kept: KeptPictures


def find_budget(config: Config, progress: ProgressCallback = silent) -> Found | None:
    """
    The least budget whose fitted model is expected to reach the goal of a configuration; None where it has none.

    Raises
    ------
    ConfigError
        The subject is no surface that is decimated.
    """
    goal = goal_of(config.goal)
    if goal is None:
        return None
    if config.initial.kind not in ("decimate", "cards", "auto"):
        raise ConfigError(f"{goal.name} finds a budget of triangles, which kind: {config.initial.kind} does not take")
    subject = open_subject(goal.prepared(config, open_subject(config)))
    n, tried = least(goal, subject, progress)
    prepared = goal.prepared(config, subject).model_copy(update={"goal": GoalSettings()})
    return Found(with_budget(prepared, n), goal, tried, subject.kept)


def least(
    goal: Goal, subject: Subject, progress: ProgressCallback = silent, first: int | None = None
) -> tuple[int, dict[int, float]]:
    """
    Triangles with which a model is expected to reach a goal once it is fitted, and what first guesses were worth.

    Secants over the logarithm of the triangles, within a bracket once there is one.

    Parameters
    ----------
    first : int, optional
        Where to begin; a fiftieth of the asset if not given, at least 500.
    """
    most = subject.geometry.n_triangles
    if first is None:
        first = max(500, most // 50)

    def judge(n: int) -> float:
        progress(Progress("budget", message=f"{n} triangles"))
        try:
            guess, _ = subject.under(with_budget(subject.config, n)).guess()
        except MeshError:  # so few triangles make no surface
            return goal.wanted - 2 * goal.slope
        return goal.of_guess(subject, guess) + goal.gain

    return crossing(judge, goal.wanted, first, goal.slope, LEAST_TRIANGLES, most)


def crossing(
    judge: Callable[[int], float], wanted: float, first: int, slope: float, few: int, most: int
) -> tuple[int, dict[int, float]]:
    """
    The number, from ``few`` to ``most``, at which a function that rises with its logarithm is what is wanted; ``most``
    where it never is.

    Parameters
    ----------
    slope : float
        First estimate of its rise where the number doubles.

    Returns
    -------
    n : int
    tried : dict of int to float
    """
    tried: dict[int, float] = {}
    x = float(np.log2(np.clip(first, few, most)))
    for _ in range(_ROUNDS):
        n = int(round(2**x))
        if n in tried:
            break
        tried[n] = judge(n)
        x_next = _estimate(tried, wanted, slope)
        x_next = float(np.clip(x_next, np.log2(few), np.log2(most)))
        if abs(x_next - x) * np.log(2) < _NEAR:
            x = x_next
            break
        x = x_next
    return int(np.clip(np.ceil(2**x), few, most)), tried


def _estimate(tried: Mapping[int, float], wanted: float, slope: float) -> float:
    """Logarithm of base 2 of where the function is what is wanted, by what was tried."""
    n = np.array(sorted(tried))
    x, y = np.log2(n), np.array([tried[k] for k in n])
    enough = np.flatnonzero(y >= wanted)
    if len(enough) and enough[0] > 0:  # between two that were tried
        a, b = enough[0] - 1, enough[0]
        return float(np.interp(wanted, y[[a, b]], x[[a, b]]))
    near = 0 if len(enough) else len(n) - 1
    if len(n) > 1:
        other = 1 if near == 0 else near - 1
        measured = (y[near] - y[other]) / (x[near] - x[other])
        slope = float(np.clip(measured, 0.4 * slope, 2.5 * slope))  # noise must not send it anywhere
    return float(x[near] + np.clip((wanted - y[near]) / slope, -3, 3))


def level_budgets(subject: Subject, finest: int | None, progress: ProgressCallback = silent) -> list[int]:
    """
    Falling budgets of a chain of levels of detail: for sizes on the screen that halve, each the least that looks like
    the asset; of levels that hardly differ one.

    Parameters
    ----------
    finest : int, optional
        Of the finest level; that of the largest size if not given.
    """
    budgets: list[int] = [] if finest is None else [finest]
    first = finest
    for size in LEVEL_SIZES:
        n, _ = least(ScreenSize(size), subject, progress, first)
        first = max(n // 2, LEAST_TRIANGLES)
        if not budgets or n < _APART * budgets[-1]:
            budgets.append(n)
    return budgets


def with_stored_budget(config: Config, file: Path) -> Config:
    """
    The configuration with what :func:`find_budget` found when the run was begun whose ``config.yaml`` this is.
    """
    stored = load_config(file)
    return config.model_copy(update={name: getattr(stored, name) for name in ("initial", "optimizer", "goal")})


def with_budget(config: Config, triangles: int) -> Config:
    """
    The configuration with so many triangles.
    """
    initial = config.initial.model_copy(update={"triangles": triangles, "vertices": None})
    return config.model_copy(update={"initial": initial})
