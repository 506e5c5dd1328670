"""
Named sets of overrides, laid between the defaults and the user's own settings.
"""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # On two cores: about a minute, three to four minutes, and as long as it takes.
    "fast": {"optimizer": {"steps": 120}},
    "balanced": {},
    "best": {"optimizer": {"steps": 3000, "spp": 4}, "reference": {"spp": 32}},
}
