"""
Which kinds of subject there are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..config import Config
from ..model.asset import Asset
from ..registry import Registry
from .subject import Subject

#: The asset that the configuration names, read once, when it is first asked for.
Geometry = Callable[[], Asset]


@dataclass(frozen=True)
class _Kind:
    """Which configurations a subject is for, and how it is made."""

    applies: Callable[[Config, Geometry], bool]
    make: Callable[[Config, Geometry], Subject]


SUBJECTS: Registry[_Kind] = Registry("subject")


def register_subject(
    name: str,
    applies: Callable[[Config, Geometry], bool],
    make: Callable[[Config, Geometry], Subject],
    *,
    replace: bool = False,
) -> None:
    """
    Make a kind of subject known: of those that apply to a configuration, the last registered is taken.

    Parameters
    ----------
    name : str
    applies : callable
        ``applies(config, geometry)``; to call ``geometry()`` reads ``config.asset`` as a model file, so look at its
        name first.
    make : callable
        ``make(config, geometry) -> Subject``.

    Raises
    ------
    ValueError
        The name is taken.
    """
    SUBJECTS.register(name, _Kind(applies, make), replace=replace)
