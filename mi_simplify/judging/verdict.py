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


#: What may grow, in words, by the key of ``metrics.json``, and the option that mends it.
_GROWING = {
    "bytes": ("bytes", "--compress meshopt --textures webp, or a smaller initial.atlas_size"),
    "vertices": ("vertices", "fewer --triangles, or a larger initial.crease_angle"),
    "texels": ("texels", "a smaller initial.atlas_size"),
}


def larger(figures: Mapping[str, Any], name: str = "result") -> list[str]:
    """
    One line for each of bytes, vertices and texels of which a candidate has more than the reference, with the way out.

    Sizes of files count where both are known and neither is written without its images, as OBJ and USD are; texels
    where the reference has textures.

    Parameters
    ----------
    figures : mapping
        What ``metrics.json`` holds.
    name : str
        The candidate.
    """
    before, now = figures["reference"], figures["candidates"][name]
    lines = []
    for key, (word, option) in _GROWING.items():
        a, b = before.get(key), now.get(key)
        if a is None or b is None or b <= a:
            continue
        if key == "bytes" and not all(str(row.get("file")).lower().endswith(".glb") for row in (before, now)):
            continue
        if key == "texels" and a <= before.get("materials", 1):  # constants
            continue
        lines.append(f"the {name} has {b:,} {word}, more than the asset's {a:,}: {option}")
    return lines
