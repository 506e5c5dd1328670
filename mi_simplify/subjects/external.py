"""
An asset that another renderer shows: the fit converts its look into ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..config import Config
from ..errors import ConfigError
from ..judging.comparison import Comparison
from ..judging.evaluate import Judging
from ..model.asset import Asset
from ..model.model import Model
from ..progress import ProgressCallback
from ..scenes.references.command import CommandReference
from ..scenes.references.reference import Reference
from .subject import Subject, judged_as_fitted


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
        super().__init__(judged_as_fitted(config), geometry)

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
        reference = self.config.reference
        if reference.command is not None:
            return CommandReference(reference.command, self.config.asset)
        from ..scenes.references.vtk import VtkReference

        return VtkReference(self.geometry, spp=spp)

    def judge(
        self, candidates: Mapping[str, Asset], judging: Judging = Judging(), progress: ProgressCallback | None = None
    ) -> Comparison:
        """See :class:`.subject.Subject`."""
        return self._judged_in_its_own_light(candidates, judging, progress)
