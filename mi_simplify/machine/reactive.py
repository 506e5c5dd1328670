"""
Values that are computed from others, each only when something that it reads has changed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Stage:
    """
    One computation, and what it reads: nothing else may change its value.

    Parameters
    ----------
    name : str
    reads : tuple of str
        Inputs and stages before it.
    what : str
        For people.
    """

    name: str
    reads: tuple[str, ...]
    what: str = ""


def affected(stages: Collection[Stage], changing: Collection[str]) -> list[str]:
    """
    The stages whose value changes where these inputs or stages do, in their order.
    """
    marked = set(changing)
    for stage in stages:
        if marked & set(stage.reads):
            marked.add(stage.name)
    return [stage.name for stage in stages if stage.name in marked]


class Reactive:
    """
    Stages with their values.

    Parameters
    ----------
    stages : collection of Stage
        Each after those that it reads; what is read and is no stage is an input.
    compute : mapping of str to callable
        Of every stage, called with what it reads by name.
    """

    def __init__(self, stages: Collection[Stage], compute: dict[str, Callable[..., Any]]):
        self._stages, self._compute = {stage.name: stage for stage in stages}, compute
        self._inputs: dict[str, Any] = {}
        self._stamps: dict[str, int] = {}
        self._values: dict[str, Any] = {}
        self._read: dict[str, tuple[int, ...]] = {}
        self._clock = 0
        self.computed: list[str] = []
        """Names of the stages that were computed since this was last emptied."""

    def set(self, name: str, value: Any) -> None:
        """
        Give an input its value; it has changed unless it is the very same object.
        """
        if name not in self._inputs or self._inputs[name] is not value:
            self._inputs[name] = value
            self.changed(name)

    def changed(self, name: str) -> None:
        """Mark an input that was changed in place."""
        self._clock += 1
        self._stamps[name] = self._clock

    def get(self, name: str) -> Any:
        """
        The value of an input or a stage, computed where something below it has changed.
        """
        if name not in self._stages:
            return self._inputs[name]
        reads = self._stages[name].reads
        values = {read: self.get(read) for read in reads}
        stamps = tuple(self._stamps[read] for read in reads)
        if self._read.get(name) != stamps:
            self._values[name] = self._compute[name](**values)
            self._read[name] = stamps
            self.changed(name)
            self.computed.append(name)
        return self._values[name]
