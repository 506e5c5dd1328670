"""
Which subject a configuration names.
"""

from __future__ import annotations

from pathlib import Path

from ..config import SAMPLE_PREFIX, Config, code_of
from ..errors import AssetError
from .character import Character
from .external import ExternalSubject
from .images import ImageSubject
from .implicit import ImplicitSubject
from .subject import Subject, open_asset


def open_subject(config: Config) -> Subject:
    """
    The subject that ``config.asset`` names.

    Raises
    ------
    UserError
        It is not there, cannot be read, or cannot be what the configuration wants it to be.
    """
    name = config.asset
    if name == f"{SAMPLE_PREFIX}creature" or code_of(name):
        return ImplicitSubject(config)
    if Path(name).suffix.lower() == ".json":
        return ImageSubject(config)
    geometry = open_asset(name)
    if config.reference.renderer != "mitsuba" or config.reference.command is not None:
        return ExternalSubject(config, geometry)
    if geometry.rig is not None:
        return Character(config, geometry)
    if config.animation.frames is not None:
        raise AssetError(f"{geometry.name} has no skeleton, so it has no frames; leave --frames (animation.frames) out")
    return Subject(config, geometry)
