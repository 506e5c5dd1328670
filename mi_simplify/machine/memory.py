"""
How much memory there is and how much something will take, asked before it is taken.

The operating system's own limits are of no use here: LLVM and Embree reserve addresses that they never fill. So
whatever may be large says its size first, and is refused with one line where that does not fit.
"""

from __future__ import annotations

import contextlib
import contextvars
import gc
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from ..errors import ConfigError, MemoryLimitError

_LIMIT: contextvars.ContextVar[int | None] = contextvars.ContextVar("memory limit", default=None)

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


def parse_size(text: str) -> int:
    """
    Bytes of a size as people write it: ``4GB``, ``1.5G``, ``800 MiB``; units are powers of 1024.

    Raises
    ------
    ConfigError
        It is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    if not found or not float(found[1]):
        raise ConfigError(f"'{text}' is no size of memory; write it as 4GB or 800MB")
    return int(float(found[1]) * _UNITS[found[2].upper()])


def shown_size(n_bytes: float) -> str:
    """
    For a person: ``1.5 GB``, ``12 MB``.
    """
    return f"{n_bytes / (1 << 30):.1f} GB" if n_bytes >= 0.95 * (1 << 30) else f"{max(n_bytes / (1 << 20), 1):.0f} MB"


@contextlib.contextmanager
def limited(n_bytes: int | None) -> Iterator[None]:
    """
    Everything inside keeps the process below ``n_bytes``, or what the machine has where that is None.
    """
    token = _LIMIT.set(n_bytes)
    try:
        yield
    finally:
        _LIMIT.reset(token)


def left() -> int | None:
    """
    Bytes that this process may still take: up to the limit, else what the machine has free; None where nobody tells.
    """
    room = _room()
    return None if room is None else max(room, 0)


def _room() -> int | None:
    """The same, below zero where the process holds more than the limit already."""
    limit, now = _LIMIT.get(), held()
    free = [n for n in (_free_in_system(), _free_in_cgroup()) if n is not None]
    if limit is not None and now is not None:
        free.append(limit - now)
    return min(free) if free else None


def require(n_bytes: float, what: str, way_out: str) -> None:
    """
    Refuse what does not fit into memory, before it is allocated.

    Parameters
    ----------
    n_bytes : float
        Most that it will take at once [bytes]; below zero where that is held already.
    what, way_out : str
        Subject of the message, and what to do instead.

    Raises
    ------
    MemoryLimitError
        It is more than is left.
    """
    room = _room()
    if room is not None and n_bytes > room:
        limit, now = _LIMIT.get(), held()
        need = f"{what} needs about {shown_size(n_bytes)} of memory"
        if limit is not None and now is not None and now >= limit:
            more = f"this process holds {shown_size(now)} already and --memory-limit is {shown_size(limit)}"
            raise MemoryLimitError(f"{need}, but {more}; raise it to {shown_size(1.05 * (now + max(n_bytes, 0)))}")
        cause = "are free" if limit is None else f"are left of --memory-limit {shown_size(limit)}"
        raise MemoryLimitError(f"{need}, {shown_size(max(room, 0))} {cause}; {way_out}")


def held() -> int | None:
    """
    Memory that this process holds now [bytes]; None where the system does not tell.
    """
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


def peak() -> int | None:
    """
    Most memory that this process has held [bytes]; None where the system does not tell.
    """
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _free_in_system() -> int | None:
    """Memory that the machine has free or can free at once."""
    try:
        found = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
    except OSError:
        found = None
    if found:
        return int(found[1]) << 10
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError, AttributeError):
        return None


def _free_in_cgroup() -> int | None:
    """What a container's own limit leaves, where it has one (cgroup 2, then 1); cached files make room when asked."""
    for folder, limit, used, cached in (
        ("", "memory.max", "memory.current", "inactive_file"),
        ("memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        group = Path("/sys/fs/cgroup", folder)
        try:
            found = re.search(rf"^{cached} (\d+)$", (group / "memory.stat").read_text(), re.MULTILINE)
            reclaimable = int(found[1]) if found else 0
            return int((group / limit).read_text()) - int((group / used).read_text()) + reclaimable
        except (OSError, ValueError):  # 'max' is no limit
            continue
    return None


def release() -> None:
    """
    Give back what Dr.Jit keeps of arrays that are gone, between stages that need arrays of other sizes.
    """
    import drjit as dr  # which takes its time to load

    gc.collect()
    dr.flush_malloc_cache()
