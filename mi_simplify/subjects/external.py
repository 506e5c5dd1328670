"""
An asset that another renderer shows: the fit converts its look into ours.
"""

from __future__ import annotations

from ..config import Config
from ..errors import ConfigError
from ..model.asset import Asset
from ..scenes.references.command import CommandReference
from ..scenes.references.reference import Reference
from .still import SelfLit
from .subject import judged_as_fitted


class ExternalSubject(SelfLit):
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
        super().__init__(judged_as_fitted(config), geometry)

    def renderer(self, spp: int) -> Reference:
        """See :class:`.subject.Subject`."""
        reference = self.config.reference
        if reference.command is not None:
            return CommandReference(reference.command, self.config.asset)
        from ..scenes.references.vtk import VtkReference

        return VtkReference(self.geometry, spp=spp)
