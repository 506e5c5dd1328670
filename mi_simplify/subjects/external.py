"""
An asset that another renderer shows: the fit converts its look into ours.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..config import Config
from ..errors import ConfigError
from ..progress import ProgressCallback
from ..report.evaluate import Comparison, Rendering, compare_renderings
from ..scenes.asset import Asset
from ..scenes.reference import FramedReference, Reference
from ..scenes.views import held_out_views
from .command import CommandReference
from .light import fitted_light
from .subject import Subject


class ExternalSubject(Subject):
    """
    A model file, seen by ``reference.renderer`` or ``reference.command`` at cameras and lights of our choosing.

    Judged by that renderer's images; candidates are lit directly, as in the fit.

    Parameters
    ----------
    config : Config
    geometry : Asset
    """

    def __init__(self, config: Config, geometry: Asset):
        reference = config.reference
        if reference.transport == "matched":
            raise ConfigError("reference.transport: another renderer cannot be matched; take 'direct', or 'baked'")
        super().__init__(config, geometry)

    def reference(self) -> Reference:
        """See :class:`.subject.Subject`."""
        return FramedReference(self._renderer(self.config.reference.spp), self.frame.scale, self.frame.center)

    def _renderer(self, spp: int) -> Reference:
        """In the units of the asset."""
        reference = self.config.reference
        if reference.command is not None:
            return CommandReference(reference.command, self.config.asset)
        from ..scenes.vtk_reference import VtkReference

        return VtkReference(self.geometry, spp=spp)

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
        Candidates under direct light and their ambient term, beside the images of the other renderer.
        """
        views = self.lit_as_fitted(held_out_views(self.geometry.bounds, n_views, resolution, seed))
        reference = self.config.reference
        settings = {"spp": spp, "seed": seed, "light": "direct", "reference": reference.command or reference.renderer}
        return compare_renderings(
            Rendering(self.geometry, self._renderer(spp)),
            {name: Rendering(asset, fitted_light(asset, spp, self.config)) for name, asset in candidates.items()},
            views, settings, progress,
        )  # fmt: skip
