"""
Models made by this code at run time; nothing is downloaded, nothing is read.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import AssetError
from ...model.asset import Asset, Instance
from . import relic
from .fish import fish
from .plant import FULL, plant
from .walker import walker

_FULL = {"relic": 180_000, "walker": 13_700, "fish": 8_064, **FULL}
"""About how many triangles each has in full."""


def sample_names() -> list[str]:
    """
    Names that :func:`sample_asset` knows.
    """
    return list(_FULL)


def sample_asset(name: str = "relic") -> Asset:
    """
    An embedded model, the same on every machine.

    Parameters
    ----------
    name : str
        ``relic``, an ornament, ``walker``, a figure that walks, ``fish``, which swims, or one of the plants ``shrub``
        and ``fern``; with a
        rough number of triangles ``relic:20k``, ``shrub:5000``. Below 100k the relic's textures have half the size.

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
    if base not in _FULL:
        if base == "creature":
            raise AssetError("sample:creature is an implicit surface and no mesh: only what is simplified can be one")
        raise AssetError(f"no sample is called {name!r}; there is {', '.join(sample_names())}, and creature")
    share = 1.0
    if count:
        text = count.lower()
        try:
            wanted = float(text[:-1]) * 1000 if text.endswith("k") else float(text)
        except ValueError:
            wanted = 0.0
        if not 2_000 <= wanted <= 4_000_000:
            raise AssetError(f"{name!r}: a number of triangles from 2k to 4000k goes after the colon, as in {base}:20k")
        share = wanted / _FULL[base]
    if base in FULL:
        return replace(plant(base, share), source=f"sample:{name}")
    if base in ("walker", "fish"):
        return replace((walker if base == "walker" else fish)(share), source=f"sample:{name}")
    detail = float(np.sqrt(share))
    parts = (relic.egg(detail), relic.serpent(detail), relic.eyes(detail), relic.foot(detail))
    instances = tuple(Instance(k, name=p.name) for k, p in enumerate(parts))
    return Asset(parts, instances, name=base, source=f"sample:{name}")
