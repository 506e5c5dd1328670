"""
Names and what they stand for, open to anybody's own.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Generic, TypeVar

from .errors import ConfigError

T = TypeVar("T")


class Registry(Generic[T]):
    """
    Entries by name, in the order of their registration.

    Parameters
    ----------
    what : str
        What the messages call an entry, and where a configuration names it: 'loss (loss.image)'.
    """

    def __init__(self, what: str):
        self.what = what
        self._entries: dict[str, T] = {}

    def register(self, name: str, entry: T, *, replace: bool = False) -> None:
        """
        Add an entry.

        Raises
        ------
        ValueError
            The name is taken, and ``replace`` is not set.
        """
        if name in self._entries and not replace:
            raise ValueError(f"the {self.what} '{name}' is there already; pass replace=True to put yours in its place")
        self._entries[name] = entry

    def __getitem__(self, name: str) -> T:
        """
        The entry of a name.

        Raises
        ------
        ConfigError
            There is none; lists those that there are, and the nearest.
        """
        if name not in self._entries:
            close = difflib.get_close_matches(name, self._entries, n=1)
            hint = f", did you mean '{close[0]}'?" if close else ""
            raise ConfigError(f"unknown {self.what} '{name}'{hint}; one of {', '.join(self._entries)}")
        return self._entries[name]

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def latest_first(self) -> Iterator[tuple[str, T]]:
        """
        Names and entries, the last registered first: one's own before the built-in ones.
        """
        return iter(reversed(self._entries.items()))
