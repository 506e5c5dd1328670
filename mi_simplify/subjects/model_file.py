"""
A model file as the subject of a job: rendered by Mitsuba, judged by path tracing.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..judging.comparison import Comparison
from ..judging.evaluate import Judging, compare_assets
from ..model.asset import Asset
from ..progress import ProgressCallback
from ..scenes.references.reference import Reference
from .still import Still
from .subject import reference_for, renderer_of


class ModelFile(Still):
    """
    An asset at rest, or a Mitsuba scene; see :class:`.subject.Subject`.
    """

    keeps_nodes = True

    def reference(self) -> Reference:
        """See :class:`.subject.Subject`."""
        return reference_for(self.frame.normalised(self.shown), self.config)

    def renderer(self, spp: int) -> Reference:
        """See :class:`.subject.Subject`."""
        return renderer_of(self.geometry, self.config, spp)

    def judge(
        self, candidates: Mapping[str, Asset], judging: Judging = Judging(), progress: ProgressCallback | None = None
    ) -> Comparison:
        """See :class:`.subject.Subject`: relit, or in the light that was fitted where the configuration says so."""
        if self.config.evaluation.light == "relit":
            return compare_assets(self.geometry, candidates, judging, progress, self.kept)
        return self._judged_in_its_own_light(candidates, judging, progress)
