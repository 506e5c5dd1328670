"""
Whether a result is plainly unlike its asset, which nobody should have to find out by looking.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MOST_FLIP = 0.2
"""Mean FLIP over what is covered above which a result is another thing to the eye."""

MOST_SILHOUETTE_ERROR = 0.08
"""Silhouette error above which parts are missing, or were added."""


def unlike(figures: Mapping[str, Any], name: str = "result") -> str | None:
    """
    One line that says so, with the way out, where a candidate is plainly unlike the reference; else None.

    Parameters
    ----------
    figures : mapping
        What ``metrics.json`` holds.
    name : str
        The candidate.
    """
    row = figures["candidates"][name]
    found = []
    if row["silhouette_error"] > MOST_SILHOUETTE_ERROR:
        found.append(f"silhouette error {row['silhouette_error']:.1%}, above {MOST_SILHOUETTE_ERROR:.0%}")
    if row["flip"] > MOST_FLIP:
        found.append(f"FLIP {row['flip']:.2f}, above {MOST_FLIP:.2f}")
    if not found:
        return None
    more = 2 * max(2, row["triangles"])
    return (
        f"the {name} is plainly unlike the asset ({'; '.join(found)}): look at the report; "
        f"ask for more triangles, such as --triangles {more}, or for foliage --mode cards"
    )
