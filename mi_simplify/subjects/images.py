"""
Captured images as the subject of a job: started from what their outlines leave, judged on images of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..config import Config
from ..errors import AssetError, ConfigError
from ..formats.captured.read import Captured, read_captured
from ..initial.visual_hull import mean_color, visual_hull
from ..judging.comparison import Comparison
from ..judging.evaluate import Judging
from ..model.asset import Asset
from ..model.model import Model
from ..progress import ProgressCallback
from ..scenes.references.images import ImageReference
from ..scenes.references.reference import Reference
from .subject import Subject, with_ambient

#: Radiance that an unknown environment starts with; what is found has base colours to match.
LIGHT = 0.8


class ImageSubject(Subject):
    """
    A ``transforms.json``, see :mod:`..formats.captured.read`.

    Parameters
    ----------
    config : Config
    """

    def __init__(self, config: Config):
        settings = config.images
        if config.reference.transport == "matched":
            raise ConfigError("reference.transport: images are not path traced; leave it at 'direct'")
        captured = read_captured(config.asset)
        n = len(captured)
        if settings.held_out is None:
            if n < 3:
                raise AssetError(f"{config.asset}: {n} images are too few; some are to be fitted, others to judge by")
            self._held_out = list(range(min(settings.every, n) // 2, n, settings.every))
        else:
            captured = joined(captured, read_captured(settings.held_out))
            self._held_out = list(range(n, len(captured)))
        self._fitted = sorted(set(range(len(captured))) - set(self._held_out))
        self.captured = captured
        light = captured.light if settings.light == "auto" else settings.light
        if light == "point" and captured.light_position is None:
            raise ConfigError(f"images.light: no frame of {config.asset} has a 'light'; take unlit or environment")
        if light != "point" and captured.light_position is not None:
            zeros = np.zeros_like(captured.light_intensity)
            self.captured = replace(captured, light_intensity=zeros)
        self.light = light
        # Radiance of a surface of base colour 1, roughly; a point light leaves half of it in the dark.
        brightness = {"unlit": 1.0, "environment": LIGHT, "point": 0.4}[light]
        geometry = visual_hull(captured, settings.resolution, mean_color(captured) / brightness)
        super().__init__(_completed(config, light), geometry)

    @property
    def display(self) -> Asset | None:
        """See :class:`.subject.Subject`; a hull is no reference."""
        return None

    def guess(self) -> tuple[Model, list[str]]:
        """See :class:`.subject.Subject`."""
        return self._first_guess()

    def baseline(self, triangles: int) -> Model:
        """See :class:`.subject.Subject`."""
        return self._quadrics(triangles)

    def facts(self, model: Model) -> dict[str, Any]:
        """See :class:`.subject.Subject`; there are none."""
        return {}

    def renderer(self, spp: int) -> Reference:
        """See :class:`.subject.Subject`; images are what they are, whatever the samples."""
        return ImageReference(self.captured, 1.0, np.zeros(3), self._fitted, self._held_out)

    def reference(self) -> Reference:
        """See :class:`.subject.Subject`."""
        return ImageReference(self.captured, self.frame.scale, self.frame.center, self._fitted, self._held_out)

    def judge(
        self,
        candidates: Mapping[str, Asset],
        judging: Judging = Judging(),
        progress: ProgressCallback | None = None,
    ) -> Comparison:
        """
        Candidates in the light of the images, beside images that were not fitted.
        """
        judging.require_mitsuba()
        reference = ImageReference(self.captured, 1.0, np.zeros(3), self._fitted, self._held_out)
        views = reference.held_out(judging.n_views, judging.resolution)
        settings = {"spp": judging.spp, "seed": judging.seed, "light": self.light, "held_out": len(self._held_out)}
        return self.compared(reference, candidates, views, settings, progress)


def joined(a: Captured, b: Captured) -> Captured:
    """
    The images of both, which have to be lit alike.
    """
    if a.light != b.light:
        raise AssetError(f"{b.source}: its light is '{b.light}', that of {a.source} is '{a.light}'; it should be one")
    arrays: dict[str, Any] = {}
    for name in ("to_world", "focal", "center", "light_position", "light_intensity"):
        x, y = getattr(a, name), getattr(b, name)
        arrays[name] = None if x is None or y is None else np.concatenate([x, y])
    return replace(a, images=a.images + b.images, names=a.names + b.names, **arrays)


def _completed(config: Config, light: str) -> Config:
    """The configuration with the ambient light that images of this kind need, and what else goes with it."""
    white = (1.0, 1.0, 1.0)
    known: dict[str, dict[str, Any]] = {
        "point": {},
        "unlit": {"kind": "color", "color": white, "optimize": False, "export": "drop"},
        "environment": {"kind": "environment", "color": (LIGHT, LIGHT, LIGHT)},
    }
    if config.latent.ambient.kind == "auto":
        config = with_ambient(config, **known[light])
    if light == "unlit":
        kept = tuple(name for name in config.latent.optimize if name in ("vertices", "base_color", "opacity"))
        config = config.model_copy(update={"latent": config.latent.model_copy(update={"optimize": kept})})
    return config
