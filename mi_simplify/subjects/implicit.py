"""
An implicit surface as the subject of a job: sphere traced, started from its isosurface, judged in its own light.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..config import SAMPLE_PREFIX, Config
from ..errors import ConfigError
from ..initial.isosurface import isosurface
from ..judging.comparison import Comparison
from ..judging.evaluate import Judging
from ..model.asset import Asset
from ..model.model import Model
from ..progress import ProgressCallback
from ..scenes.implicit.surface import implicit_named
from ..scenes.references.reference import Reference
from ..scenes.references.sphere_tracing import SphereTraced
from ..scenes.samples.creature import creature
from .subject import Subject, judged_as_fitted, with_ambient


class ImplicitSubject(Subject):
    """
    A distance function, or the sample ``creature``.

    Its ambient light is known, so the latent model has the same one, unless the configuration says otherwise.

    Parameters
    ----------
    config : Config
    """

    def __init__(self, config: Config):
        reference, settings = config.reference, config.implicit
        if reference.transport == "matched":
            raise ConfigError(
                "reference.transport: an implicit surface is not path traced; take 'direct', or 'baked' for shadows"
            )
        if reference.environment is not None or reference.scene_lights:
            raise ConfigError("reference: an implicit surface is lit by the views' light and its ambient one alone")
        given = settings.model_dump(include={"material", "bounds", "ambient"})
        if config.asset.startswith(SAMPLE_PREFIX):
            self.surface = creature(**{name: value for name, value in given.items() if value is not None})
        else:
            self.surface = implicit_named(config.asset, **given)
        if config.latent.ambient.kind == "auto" and any(self.surface.ambient):
            config = with_ambient(config, kind="color", color=tuple(self.surface.ambient), optimize=False)
        config = judged_as_fitted(config)
        super().__init__(config, isosurface(self.surface, settings.resolution))

    @property
    def display(self) -> Asset:
        """See :class:`.subject.Subject`."""
        return self.geometry

    def guess(self) -> tuple[Model, list[str]]:
        """See :class:`.subject.Subject`."""
        return self._first_guess()

    def baseline(self, triangles: int) -> Model:
        """See :class:`.subject.Subject`."""
        return self._quadrics(triangles)

    def facts(self, model: Model) -> dict[str, Any]:
        """See :class:`.subject.Subject`; there are none."""
        return {}

    def reference(self) -> Reference:
        """See :class:`.subject.Subject`."""
        return self._framed()

    def renderer(self, spp: int) -> Reference:
        """See :class:`.subject.Subject`."""
        shadows = self.config.reference.transport == "baked"
        return SphereTraced(self.surface, spp=spp, shadows=shadows, form=self.config.latent.shading)

    def judge(
        self, candidates: Mapping[str, Asset], judging: Judging = Judging(), progress: ProgressCallback | None = None
    ) -> Comparison:
        """See :class:`.subject.Subject`."""
        return self._judged_in_its_own_light(candidates, judging, progress)
