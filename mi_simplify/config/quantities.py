"""
What of the fit's quantities a person wants left alone, in the words that texture sets are named with.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import get_args

from ..errors import ConfigError
from .problems import nearest
from .schema import Config, Quantity

#: Short names for quantities that go together; each quantity's own name is one too.
GROUPS: dict[str, tuple[str, ...]] = {
    "shape": ("vertices", "displacement", "vertex_sets", "skinning"),
    "kd": ("base_color", "opacity"),
    "orm": ("gamma", "roughness", "metallic"),
}


def with_fixed(config: Config, names: Iterable[str]) -> Config:
    """
    The configuration with some quantities taken off ``latent.optimize``; these stay as the first guess has them.

    Parameters
    ----------
    config : Config
    names : iterable of str
        Quantities or groups of them (``GROUPS``).

    Raises
    ------
    ConfigError
        A name is unknown, or nothing is left to fit.
    """
    known = GROUPS | {name: (name,) for name in get_args(Quantity)}
    skipped: set[str] = set()
    for name in names:
        if name not in known:
            raise ConfigError(f"'{name}' is nothing that is fitted{nearest(name, known)}; one of {', '.join(known)}")
        skipped.update(known[name])
    left = tuple(name for name in config.latent.optimize if name not in skipped)
    if not set(left) - {"displacement", "vertex_sets", "skinning"}:  # which most models do not have
        raise ConfigError(
            "nothing is left to fit; skip less, or ask for the first guess alone with --set optimizer.steps=0"
        )
    return config.model_copy(update={"latent": config.latent.model_copy(update={"optimize": left})})
