"""
Progress shown to a person: a bar on a terminal, plain lines elsewhere, or nothing.

Each is a context manager that is called with every :class:`mi_simplify.progress.Progress`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

from .progress import Progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID


class Silent:
    """
    Shows nothing.
    """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        pass

    def __call__(self, progress: Progress) -> None:
        pass


class Lines(Silent):
    """
    A line when a stage begins, when it ends, and every few seconds between.

    Parameters
    ----------
    write : callable
        Takes one line of text.
    interval : float
        Least time between two lines of a stage [s].
    """

    def __init__(self, write: Callable[[str], object], interval: float = 5.0):
        self.write, self.interval = write, interval
        self._clock = _Clock()
        self._written = 0.0

    def __call__(self, progress: Progress) -> None:
        begins = self._clock.update(progress)
        ends = 0 < progress.n_steps == progress.step
        now = time.monotonic()
        if begins or ends or progress.message or now - self._written >= self.interval:
            self._written = now
            self.write(self._line(progress))

    def _line(self, progress: Progress) -> str:
        parts = [progress.stage]
        if progress.n_steps:
            parts.append(f"{progress.step}/{progress.n_steps}")
        parts += [text for text in (self._clock.figures(progress), progress.message) if text]
        left = self._clock.left(progress)
        return "  ".join([*parts, f"{_duration(left)} left"] if left else parts)


class Bar(Silent):
    """
    A live bar with loss, PSNR on a held-out view and the time left.

    Parameters
    ----------
    console : rich.console.Console
    """

    def __init__(self, console: Console):
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
        from rich.progress import Progress as Display

        self._clock = _Clock()
        self._task: TaskID | None = None
        self._display = Display(
            TextColumn("{task.description:12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            console=console,
        )

    def __enter__(self) -> Self:
        self._display.start()
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self._display.stop()

    def __call__(self, progress: Progress) -> None:
        if self._clock.update(progress) or self._task is None:
            if self._task is not None:  # the stage before is done
                total = self._display.tasks[-1].total or 1
                self._display.update(self._task, total=total, completed=total)
            self._task = self._display.add_task(progress.stage, total=progress.n_steps or None, note="")
        left = self._clock.left(progress)
        notes = [self._clock.figures(progress), f"{_duration(left)} left" if left else "", progress.message]
        self._display.update(
            self._task,
            total=progress.n_steps or None,
            completed=progress.step,
            note="  ".join(note for note in notes if note),
        )


class _Clock:
    """What is remembered of a stage: since when it runs, and the PSNR that was measured last."""

    def __init__(self):
        self._stage: str | None = None
        self._first = (0, 0.0)
        self._psnr: float | None = None

    def update(self, progress: Progress) -> bool:
        """Whether this is the first report of its stage."""
        begins = progress.stage != self._stage
        if begins or self._first[0] == 0:  # the first step compiles, so time is counted from its end
            self._stage, self._first = progress.stage, (progress.step, time.monotonic())
        if begins or progress.psnr is not None:
            self._psnr = progress.psnr
        return begins

    def figures(self, progress: Progress) -> str:
        """Loss and PSNR as far as they are known."""
        loss = "" if progress.loss is None else f"loss {progress.loss:.4g}"
        psnr = "" if self._psnr is None else f"PSNR {self._psnr:.1f} dB"
        return "  ".join(text for text in (loss, psnr) if text)

    def left(self, progress: Progress) -> float:
        """Seconds, 0 where nothing is known yet."""
        step, start = self._first
        done = progress.step - step
        return (time.monotonic() - start) / done * (progress.n_steps - progress.step) if done > 0 else 0.0


def _duration(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
