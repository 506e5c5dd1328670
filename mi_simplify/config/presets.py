"""
Named sets of overrides, laid between the defaults and the user's own settings: first the start's, then the preset's.
"""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # On two cores: about a minute, three to four minutes, and as long as it takes.
    "fast": {"optimizer": {"steps": 120}},
    "balanced": {},
    "best": {"optimizer": {"steps": 3000, "spp": 4}, "reference": {"spp": 32}},
}

STARTS: dict[str, dict[str, Any]] = {
    # By `initial.kind`. A sphere has a long way to go: outlines pull most, on the surface as a whole, coarse to fine.
    "sphere": {
        "initial": {"textures": "constant"},
        "optimizer": {
            "resolution": [64, 128, 256],
            "rates": {"vertices": 0.2, "base_color": 0.1, "specular": 0.01, "normal": 0.02},
            "large_steps": {"lambda_": 19.0},
        },
        "loss": {"coverage": 10.0, "laplacian": {"weight": 0.0}},
    },
}
