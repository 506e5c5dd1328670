"""
An implicit surface as the subject of a job: sphere traced, started from its isosurface, judged in its own light.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..config import SAMPLE_PREFIX, Config
from ..errors import ConfigError
from ..initial.isosurface import isosurface
from ..progress import ProgressCallback
from ..report.evaluate import Comparison, Rendering, compare_renderings
from ..scenes.asset import Asset
from ..scenes.creature import creature
from ..scenes.implicit import implicit_named
from ..scenes.reference import FramedReference, Reference
from ..scenes.sphere_tracing import SphereTraced
from ..scenes.views import held_out_views
from .light import fitted_light
from .subject import Subject


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
            known = {"kind": "color", "color": tuple(self.surface.ambient), "optimize": False}
            ambient = config.latent.ambient.model_copy(update=known)
            config = config.model_copy(update={"latent": config.latent.model_copy(update={"ambient": ambient})})
        super().__init__(config, isosurface(self.surface, settings.resolution))

    def reference(self) -> Reference:
        """See :class:`.subject.Subject`."""
        return FramedReference(self._renderer(self.config.reference.spp), self.frame.scale, self.frame.center)

    def _renderer(self, spp: int) -> SphereTraced:
        """In the surface's own units."""
        shadows = self.config.reference.transport == "baked"
        return SphereTraced(self.surface, spp=spp, shadows=shadows, form=self.config.latent.shading)

    def judge(
        self,
        candidates: Mapping[str, Asset],
        *,
        n_views: int = 8,
        resolution: int = 256,
        spp: int = 64,
        seed: int = 0,
        progress: ProgressCallback | None = None,
    ) -> Comparison:
        """
        Candidates under direct light and their ambient term, beside the surface in the light that they were fitted to.
        """
        views = self.lit_as_fitted(held_out_views(self.geometry.bounds, n_views, resolution, seed))
        settings = {"spp": spp, "seed": seed, "light": "direct", "reference": self.config.reference.transport}
        return compare_renderings(
            Rendering(self.geometry, self._renderer(spp)),
            {name: Rendering(asset, fitted_light(asset, spp, self.config)) for name, asset in candidates.items()},
            views, settings, progress,
        )  # fmt: skip
