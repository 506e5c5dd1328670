"""
What the fuzzer starts from.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Seed:
    """
    A valid input.

    Parameters
    ----------
    kind : str
        'obj', 'ply', 'glb', 'usda', 'png', 'yaml', …: which inputs it may be spliced with, and how it is mutated.
    target : str
        The file that is mutated.
    entry : str
        The file that is opened.
    files : dict
        Bytes by name.
    """

    kind: str
    target: str
    entry: str
    files: dict[str, bytes]
