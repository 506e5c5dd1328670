"""
The subject that a configuration names; to import this makes the built-in kinds known.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ..config import SAMPLE_PREFIX, Config, code_of
from ..errors import AssetError
from .character import Character
from .external import ExternalSubject
from .images import ImageSubject
from .implicit import ImplicitSubject
from .model_file import ModelFile
from .registry import SUBJECTS, Geometry, register_subject
from .subject import Subject, open_asset


def open_subject(config: Config) -> Subject:
    """
    The subject that ``config.asset`` names.

    Raises
    ------
    UserError
        It is not there, cannot be read, or cannot be what the configuration wants it to be.
    """
    geometry = cache(lambda: open_asset(config.asset))
    return next(kind.make(config, geometry) for _, kind in SUBJECTS.latest_first() if kind.applies(config, geometry))


def _model_file(config: Config, geometry: Geometry) -> Subject:
    if config.animation.frames is not None:
        name = geometry().name
        raise AssetError(f"{name} has no skeleton, so it has no frames; leave --frames (animation.frames) out")
    return ModelFile(config, geometry())


register_subject("model file", lambda config, geometry: True, _model_file)
register_subject(
    "character",
    lambda config, geometry: geometry().rig is not None,
    lambda config, geometry: Character(config, geometry()),
)
register_subject(
    "external",
    lambda config, geometry: config.reference.renderer != "mitsuba" or config.reference.command is not None,
    lambda config, geometry: ExternalSubject(config, geometry()),
)
register_subject(
    "images",
    lambda config, geometry: Path(config.asset).suffix.lower() == ".json",
    lambda config, geometry: ImageSubject(config),
)
register_subject(
    "implicit",
    lambda config, geometry: config.asset == f"{SAMPLE_PREFIX}creature" or bool(code_of(config.asset)),
    lambda config, geometry: ImplicitSubject(config),
)
