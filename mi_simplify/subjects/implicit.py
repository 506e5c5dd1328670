"""
An implicit surface as the subject of a job: sphere traced, started from its isosurface, judged in its own light.
"""

from __future__ import annotations

from ..config import SAMPLE_PREFIX, Config
from ..errors import ConfigError
from ..initial.isosurface import isosurface
from ..scenes.implicit.surface import implicit_named
from ..scenes.references.reference import Reference
from ..scenes.references.sphere_tracing import SphereTraced
from ..scenes.samples.creature import creature
from .still import SelfLit
from .subject import judged_as_fitted, with_ambient


class ImplicitSubject(SelfLit):
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

    def renderer(self, spp: int) -> Reference:
        """See :class:`.subject.Subject`."""
        shadows = self.config.reference.transport == "baked"
        return SphereTraced(self.surface, spp=spp, shadows=shadows, form=self.config.latent.shading)
