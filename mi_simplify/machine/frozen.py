"""
Functions that are traced once: ``dr.freeze`` where it is safe.
"""

from __future__ import annotations

import dataclasses
import gc
import inspect
from typing import Any

import drjit as dr


@dataclasses.dataclass(frozen=True)
class Frozen:
    """
    A recorded function, during whose calls Python collects no garbage: that of others, such as whole scenes, would be
    freed in the middle of a recording, which knows nothing of it; the process has been seen to abort there.
    """

    recorded: Any

    def __call__(self, *args):
        was_enabled = gc.isenabled()
        gc.disable()
        try:
            return self.recorded(*args)
        finally:
            if was_enabled:
                gc.enable()

    @property
    def n_recordings(self) -> int:
        """How many times it was recorded."""
        return self.recorded.n_recordings


def frozen(*varying: str):
    """
    Record the kernels of a function at its first call and replay them from then on, which costs no tracing.

    A replay allocates what the recording allocated. ``dr.freeze`` by itself replays for arguments of any width, and
    kernels then write past the end of buffers that were made for another mesh; a function decorated with this is
    recorded anew where an argument has a width or a plain number that it never had, or where the number of threads has
    changed, for each of which some buffers have a private copy.

    Parameters
    ----------
    varying : str
        Parameters whose arrays may have any width all the same: those that no *buffer* of the function is as wide as
        (results are no buffers, nor what is gathered).

    Notes
    -----
    Arguments are positional: Dr.Jit arrays, dataclasses of them, plain values. Objects of other kinds are told apart by
    identity, and their arrays must not be used. Rays are not traced in it: every change of the scene would be recorded
    anew.
    """

    def decorate(function):
        names = list(inspect.signature(function).parameters)

        def state(*args):
            named = zip(names, args, strict=True)
            # One text: a number that equals an earlier one is not compared (Dr.Jit 1.5), so that 32 samples a pixel
            # were taken for 64 where the film was 64 wide and a texture 32.
            return repr([dr.thread_count(), *(_state(value, name not in varying) for name, value in named)])

        return Frozen(dr.freeze(function, state_fn=state, warn_after=1000))

    return decorate


def _state(value, with_widths: bool):
    """
    Widths of all arrays in a value, where asked for, and its plain numbers.
    """
    if dr.is_array_v(value):
        return dr.width(value) if with_widths else None
    if dataclasses.is_dataclass(value):
        return [_state(getattr(value, f.name), with_widths) for f in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return [_state(item, with_widths) for item in value]
    return value if isinstance(value, (bool, int, float, str)) else None
