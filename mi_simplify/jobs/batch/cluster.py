"""
Where the work is done: Ray, on this machine or on a cluster that runs.
"""

from __future__ import annotations

import logging
import os
import re
import socket
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from ...errors import OutputError, RuntimeUnavailable
from .entries import Entry
from .ledger import Outcome
from .work import OVER_LIMIT, Limits, work

#: Entries handed to Ray for each one that runs: enough to keep all busy, few enough for a small driver.
_AHEAD = 8

#: How often a task is begun anew when the node or the worker under it dies.
_SYSTEM_RETRIES = 5


class Cluster:
    """
    Ray, begun here or joined; a context manager that leaves it as it was.

    Parameters
    ----------
    address : str, optional
        Of a cluster; ``auto`` for the one that this machine belongs to. Without it one is started for the batch alone.
    jobs : int, optional
        How many entries run at once; as many as there are cores and memory for, without it.
    threads : int
        Cores that each of them takes.

    Raises
    ------
    RuntimeUnavailable
        Ray is not installed, or nothing answers at the address.
    """

    def __init__(self, address: str | None = None, jobs: int | None = None, threads: int = 1):
        try:
            import ray
        except ImportError:
            raise RuntimeUnavailable(
                "batch needs Ray, which is not installed: pip install 'mi-simplify[batch]'; or use --shard with a "
                "scheduler of your own"
            ) from None
        self._ray, self._address, self._jobs, self._threads = ray, address, jobs, threads

    def __enter__(self) -> Cluster:
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        os.environ.setdefault("RAY_worker_niceness", "0")  # 15 else: whatever else runs would come first
        options: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
        if self._address is None:
            cpus = self._threads * self._jobs if self._jobs else max(os.cpu_count() or 1, self._threads)
            options |= {"num_cpus": cpus, "include_dashboard": False}
        else:
            _require_answer(self._address)
        try:
            self._ray.init(self._address or "local", **options)  # not one that happens to run here
        except (ConnectionError, ValueError, RuntimeError) as error:
            where = self._address or "this machine"
            raise RuntimeUnavailable(f"no Ray cluster could be used at {where}: {error!s:.200}") from None
        return self

    def __exit__(self, *exception: object) -> None:
        self._ray.shutdown()

    @property
    def running(self) -> int:
        """How many entries run now, by the cores that they hold."""
        held = self._ray.cluster_resources().get("CPU", 0) - self._ray.available_resources().get("CPU", 0)
        return round(max(held, 0) / self._threads)

    @property
    def _ahead(self) -> int:
        """Entries that Ray is given at once: all that may run, or more where nothing but cores decides how many do."""
        if self._jobs and self._address:
            return self._jobs
        return _AHEAD * max(1, int(self._ray.cluster_resources().get("CPU", 1)) // self._threads)

    def run(
        self,
        entries: Iterable[Entry],
        fingerprints: dict[str, str],
        folder: Path,
        limits: Limits,
        memory: Callable[[Entry], int],
    ) -> Iterator[Outcome | None]:
        """
        Outcomes in the order in which they end; None about once a second while nothing does.

        Parameters
        ----------
        memory : callable
            What an entry is expected to take [bytes]; only as many run on a node as fit.
        """
        ray = self._ray
        task = ray.remote(max_retries=_SYSTEM_RETRIES, num_cpus=self._threads)(work)
        room = self._largest_memory()
        todo = iter(entries)
        running: dict[Any, Entry] = {}
        ahead, done = self._ahead, False
        while True:
            while not done and len(running) < ahead:
                entry = next(todo, None)
                if entry is None:
                    done = True
                    break
                options = {"memory": min(memory(entry), room)} if room else {}
                reference = task.options(**options).remote(
                    entry, fingerprints[entry.name], str(folder.resolve()), limits
                )
                running[reference] = entry
            if not running:
                return
            ready, _ = ray.wait(list(running), num_returns=1, timeout=1.0)
            if ready and len(running) > 1:  # whatever else has ended meanwhile
                ready, _ = ray.wait(list(running), num_returns=len(running), timeout=0)
            if not ready:
                yield None
            for reference in ready:
                entry = running.pop(reference)
                yield self._outcome(reference, entry, fingerprints[entry.name])

    def _outcome(self, reference: Any, entry: Entry, fingerprint: str) -> Outcome:
        """Of a task that has ended, also of one that Ray could not finish."""
        exceptions = self._ray.exceptions
        try:
            return self._ray.get(reference)
        except exceptions.RayTaskError as error:
            if isinstance(error.cause, OutputError):  # that of as_instanceof_cause() has a traceback in its text
                raise error.cause from None
            raise
        except exceptions.RayError as error:
            line = f"{type(error).__name__}: the worker or its node died {_SYSTEM_RETRIES + 1} times"
            return Outcome(entry.name, fingerprint, OVER_LIMIT, line)

    def _largest_memory(self) -> int:
        """Of the largest node, as Ray counts it [bytes]; 0 where it does not tell."""
        return int(max((node["Resources"].get("memory", 0) for node in self._ray.nodes() if node["Alive"]), default=0))


def _require_answer(address: str) -> None:
    """Ray itself would try for minutes before it gives up."""
    found = re.fullmatch(r"(?:ray://)?([^:/]+):(\d+)", address)
    if found is None:
        if address not in ("auto", "local"):
            raise RuntimeUnavailable(f"'{address}' is no address of a Ray cluster; write it as HOST:PORT, or 'auto'")
        return
    try:
        socket.create_connection((found[1], int(found[2])), timeout=10).close()
    except OSError as error:
        raise RuntimeUnavailable(
            f"no Ray cluster could be used at {address}: {error.strerror or error}; start one with 'ray start --head'"
        ) from None
