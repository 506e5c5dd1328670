"""
Named sets of overrides, laid between the defaults and the user's own settings: first the start's, then the preset's.
"""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # On two idle cores: half a minute, a minute, and as long as it takes.
    "fast": {"optimizer": {"steps": 80}},
    "balanced": {},
    "best": {
        "optimizer": {"steps": 3000, "spp": 4, "tolerance": 0.0},
        "reference": {"spp": 16, "refresh": 2},
        "evaluation": {"spp": 64},
    },
}

#: For what has farther to go than a decimated model at rest under direct light.
_LONG: dict[str, Any] = {"steps": 600, "tolerance": 0.001}

#: What ``--evaluate full`` adds: the samples of the ``evaluate`` command, and quadric decimation beside.
FULL_EVALUATION: dict[str, Any] = {"spp": 64, "baseline": True}


def prefiltering(target: int) -> dict[str, Any]:
    """
    Settings for a model that is seen at ``target`` pixels: textures of a few texels a pixel, averaged as viewers
    do, shaded once a pixel, against an image whose noise is small beside one pixel's.
    """
    return {
        # A crease is finer than any pixel: it would flicker.
        "initial": {
            "atlas_size": min(max(4 << (target - 1).bit_length(), 64), 1024),
            "oversample": 4 if target <= 256 else 1,
            "crease_angle": 180.0,
        },
        "latent": {"mips": "derived"},
        "optimizer": {
            **_LONG,
            "resolution": target,
            "batch": min(max(2 * 65536 // target**2, 2), 32),
            "spp": 8,
            "shade": "pixel",
            "rates": {"base_color": 0.001, "specular": 0.003, "normal": 0.003},
        },
        "reference": {
            "spp": min(max((1 << 20) // target**2, 16), 256),
            "refresh": 1,
            "pool": 512 if target <= 128 else 128,
        },
        "evaluation": {"resolution": max(target, 16)},
    }


STARTS: dict[str, dict[str, Any]] = {
    # By `initial.kind`; `images` for a `transforms.json`; of a character on top of `sphere`, once its file is read.
    # A sphere has a long way to go: outlines pull most, on the surface as a whole, coarse to fine.
    "sphere": {
        "initial": {"textures": "constant"},
        "optimizer": {
            **_LONG,
            "resolution": [64, 128, 256],
            "rates": {"vertices": 0.2, "base_color": 0.1, "specular": 0.01, "normal": 0.02},
            "large_steps": {"lambda_": 19.0},
        },
        "loss": {"coverage": 10.0, "laplacian": {"weight": 0.0}},
    },
    # `transport: baked` or `matched`: a path tracer is noisy everywhere, not in edges alone.
    # Shadows and indirect light may be finer than the asset's own textures.
    "path traced": {"initial": {"atlas_size": 1024}, "reference": {"spp": 16, "refresh": 2}, "optimizer": _LONG},
    # Each step shows one frame of many.
    "character": {"optimizer": _LONG},
    # Smaller steps, and less smooth ones, than for a thing at rest, so that it keeps thin limbs.
    "sphere of a character": {"optimizer": {"rates": {"vertices": 0.05}, "large_steps": {"lambda_": 4.0}}},
    # Of images: their hull has the outlines, but no hollows and no colours.
    "images": {
        "initial": {"textures": "constant", "crease_angle": 180.0, "atlas_size": 1024},
        "optimizer": {
            **_LONG,
            "resolution": [128, 256],
            "rates": {"vertices": 0.02, "base_color": 0.15, "specular": 0.01, "normal": 0.01},
            "large_steps": {"lambda_": 10.0},
        },
        "loss": {"coverage": 10.0, "laplacian": {"weight": 0.0}},
    },
    # Foliage: a few samples, since those of one pixel are noise that gradients would learn, and no gloss, which the
    # normals of many leaves would blur.
    "cards": {
        "latent": {
            "optimize": ["vertices", "base_color", "opacity", "roughness", "normal"],
            "min_roughness": 0.6,
        },
        "reference": {"spp": 16, "refresh": 2},
        "optimizer": {
            "steps": 200,
            "tolerance": 0.001,
            "batch": 4,
            "spp": 4,
            "rates": {"vertices": 0.003, "base_color": 0.01, "specular": 0.001, "normal": 0.01},
        },
        "loss": {"coverage": 1.0, "laplacian": {"weight": 1.0}},
    },
}
