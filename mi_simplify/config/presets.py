"""
Named sets of overrides, laid between the defaults and the user's own settings.
"""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "fast": {
        "optimizer": {"steps": 150, "batch": 2},
        "initial": {"atlas_size": 512},
    },
    "balanced": {},
    "best": {
        "optimizer": {"steps": 1200, "batch": 8},
    },
}
