"""
What subjects at rest share: a first guess from their geometry, and a verdict in their own light.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..judging.comparison import Comparison
from ..judging.evaluate import Judging
from ..model.asset import Asset
from ..model.model import Model
from ..progress import ProgressCallback
from ..scenes.references.reference import Reference
from .subject import Subject


class Still(Subject):
    """
    A subject without an animation, whose geometry stands for it; how it is rendered and judged is left to subclasses.
    """

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


class SelfLit(Still):
    """
    A subject that only a renderer of its own can show: it is fitted to that, and judged beside it.
    """

    def reference(self) -> Reference:
        """See :class:`.subject.Subject`."""
        return self._framed()

    def judge(
        self, candidates: Mapping[str, Asset], judging: Judging = Judging(), progress: ProgressCallback | None = None
    ) -> Comparison:
        """See :class:`.subject.Subject`."""
        return self._judged_in_its_own_light(candidates, judging, progress)
