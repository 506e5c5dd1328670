"""
Models made by this code at run time; nothing is downloaded, nothing is read.
"""

from __future__ import annotations

import numpy as np

from ..errors import AssetError
from . import relic
from .asset import Asset, Instance

_FULL = 180_000
"""About how many triangles a relic of detail 1 has."""


def sample_names() -> list[str]:
    """
    Names that :func:`sample_asset` knows.
    """
    return ["relic"]


def sample_asset(name: str = "relic") -> Asset:
    """
    An embedded model, the same on every machine.

    Parameters
    ----------
    name : str
        ``relic``, or with a rough number of triangles ``relic:20k``, ``relic:5000``; below 100k the textures have half
        the size.

    Returns
    -------
    Asset
        Y up, about two units high.

    Raises
    ------
    AssetError
        The name, or what follows the colon, is not known.
    """
    base, _, count = name.partition(":")
    if base not in sample_names():
        raise AssetError(f"no sample is called {name!r}; there is {', '.join(sample_names())}")
    detail = 1.0
    if count:
        text = count.lower()
        try:
            wanted = float(text[:-1]) * 1000 if text.endswith("k") else float(text)
        except ValueError:
            wanted = 0.0
        if not 2_000 <= wanted <= 4_000_000:
            raise AssetError(f"{name!r}: a number of triangles from 2k to 4000k goes after the colon, as in relic:20k")
        detail = float(np.sqrt(wanted / _FULL))
    parts = (relic.egg(detail), relic.serpent(detail), relic.eyes(detail), relic.foot(detail))
    instances = tuple(Instance(k, name=p.name) for k, p in enumerate(parts))
    return Asset(parts, instances, name=base, source=f"sample:{name}")
