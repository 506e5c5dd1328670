"""
How far a job is: the one callback through which every stage reports, and times in words.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from .errors import ConfigError


@dataclass(frozen=True)
class Progress:
    """
    One report of a running stage.

    Parameters
    ----------
    stage : str
        What is being done, in a user's words: ``"load"``, ``"first guess"``, ``"fit"``, ``"evaluate"``.
    step, n_steps : int
        ``step`` of ``n_steps`` are done; 0 of 0 where a stage cannot say.
    loss : float or None
        Loss of the newest step that was read back.
    psnr : float or None
        PSNR on a held-out view [dB], as of the last time it was measured.
    message : str
        One line for the log, empty where the numbers say it all.
    figures : mapping of str to float
        What else was measured with the PSNR.
    """

    stage: str
    step: int = 0
    n_steps: int = 0
    loss: float | None = None
    psnr: float | None = None
    message: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)


ProgressCallback = Callable[[Progress], None]


def silent(progress: Progress) -> None:
    """
    The callback that shows nothing.
    """


def in_words(seconds: float) -> str:
    """
    A time for a person: 4.1 s, 41 s, 3 min 05 s, 2 h 10 min.
    """
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{seconds:.2g} s"


def seconds_of(text: str) -> float:
    """
    Seconds of a time as people write it: ``30s``, ``1.5 min``, ``2h``; a plain number is in seconds.

    Raises
    ------
    ConfigError
        It is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|sec|m|min|h)?\s*", text, re.IGNORECASE)
    if not found or not float(found[1]):
        raise ConfigError(f"'{text}' is no time; write it as 30s, 5min or 1h")
    return float(found[1]) * {"s": 1, "m": 60, "h": 3600}[(found[2] or "s")[0].lower()]
