"""
The layers that a USD file is composed of: all inside its folder, and opened once in a process of their own.

USD composes as it opens: ten lines that refer to each other twice make a thousand prims, forty fill any memory, and
what is parsed in C++ may end the process. So a worker goes first, under limits, and its fate is the message.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd, UsdUtils

from ...errors import AssetError, MemoryLimitError, UserError
from ...machine import memory
from ..resources import Resources

#: Characters of a message that are looked at: a damaged file of 16 KB makes 130 million.
LONGEST = 4000

#: Prims, instances counted each, beyond which a stage is refused.
MAX_PRIMS = 1_000_000

#: How the worker ends where the system does not end it.
_OPENED, _NO_MEMORY, _TOO_MANY, _REFUSED = 0, 3, 4, 5


def rehearse(path: Path) -> None:
    """
    Open a stage in another process.

    Raises
    ------
    MemoryLimitError
        It takes more memory than is left.
    AssetError
        It cannot be read, ends the process, takes minutes, or has more than ``MAX_PRIMS`` prims.
    """
    room = memory.left()
    time_limit = 60 + path.stat().st_size / 1e6
    command = [sys.executable, "-m", __name__, str(path.absolute()), str(room or 0)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=time_limit, check=False)
    except subprocess.TimeoutExpired:
        message = f"{path.name}: USD takes longer than {time_limit:.0f} s to open it; simplify the file"
        raise AssetError(message) from None
    code = done.returncode
    if code == _REFUSED:
        raise AssetError(done.stdout.decode(errors="replace").strip())
    if code == _NO_MEMORY:
        shown = "there is" if room is None else f"the {memory.shown_size(room)} that are left"
        raise MemoryLimitError(f"{path.name}: USD needs more memory than {shown} to open it; simplify the file")
    if code == _TOO_MANY:
        raise AssetError(f"{path.name}: it has more than {MAX_PRIMS:,} prims, instances counted; open a part of it")
    if code != _OPENED:  # it may also end so where an allocation fails
        raise AssetError(f"{path.name}: USD ends with code {code} when it opens the file; simplify or export it again")


def check_layers(path: Path, resources: Resources) -> None:
    """
    Raise where a layer, or a file that one names, lies outside the folder of the model.

    Parameters
    ----------
    path : Path
        The root layer; the others are opened one by one, as they are found to be inside.

    Raises
    ------
    AssetError
        A path leads out, or is an expression, which could; a layer cannot be read.
    """
    todo = [str(path)]
    seen: set[str] = set()
    while todo:
        name = todo.pop()
        try:
            layer = Sdf.Layer.FindOrOpen(name)
        except Tf.ErrorException as error:
            if not seen:
                raise
            reason = reason_of(error)
            raise AssetError(f"{path.name}: it refers to '{name}', which cannot be opened: {reason}") from error
        if not layer or layer.identifier in seen:
            continue
        seen.add(layer.identifier)
        composed = set(layer.GetCompositionAssetDependencies())
        named = [name for kind in UsdUtils.ExtractExternalReferences(layer.identifier) for name in kind]
        for name in sorted(composed.union(named) - {""}):
            if name.startswith("`"):
                raise AssetError(f"{path.name}: it refers to a file by the expression {name}; flatten the stage first")
            anchored = layer.ComputeAbsolutePath(name)
            found = str(Ar.GetResolver().Resolve(anchored))
            outer = Path(Ar.SplitPackageRelativePathOuter(found or anchored)[0])
            # Names with '#' are templates of many files.
            if (found or "#" in name) and not resources.holds(outer):
                raise resources.outside(name, "layer" if name in composed else "file")
            if found and name in composed and Sdf.FileFormat.FindByExtension(found):
                todo.append(found)


def reason_of(error: Tf.ErrorException) -> str:
    """
    What a message of the library says, as one line.
    """
    text = str(error)[:LONGEST]
    found = re.search(r"in file .*? : '(.+?)(?:'\s*(?:\n|$)|\Z)", text, re.DOTALL)
    return re.sub(r"pxrInternal\w*?__(::|_)|\s+", _space_of, found[1] if found else text)[:200]


def _space_of(found: re.Match) -> str:
    """Nothing for the library's internal namespaces, one blank for any white space."""
    return " " if found[0].isspace() else ""


def _work(path: str, room: int) -> tuple[int, str]:
    """
    The worker: how it ends says what opening costs; what is wrong with the file is said, since a damaged one may take
    gigabytes before that is found.
    """
    if room:
        try:
            import resource

            # Addresses, of which libraries and the stacks and heaps of threads reserve many that they never fill.
            reserved = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            limit = reserved + (os.cpu_count() or 1) * (128 << 20) + room
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        except (ImportError, ValueError, OSError):  # Windows and macOS have no such limits
            pass
    try:
        check_layers(Path(path), Resources(Path(path), []))
        stage = Usd.Stage.Open(path)
        for n, _ in enumerate(stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate))):
            if n > MAX_PRIMS:
                return _TOO_MANY, ""
    except MemoryError:
        return _NO_MEMORY, ""
    except UserError as error:
        return _REFUSED, str(error)
    except Tf.ErrorException as error:
        return _REFUSED, f"{Path(path).name}: USD cannot read it: {reason_of(error)}"
    except (RuntimeError, ValueError, LookupError, TypeError):  # the process that asks meets it again
        pass
    return _OPENED, ""


if __name__ == "__main__":
    _code, _said = _work(sys.argv[1], int(sys.argv[2]))
    sys.stdout.buffer.write(_said.encode(errors="replace"))
    sys.exit(_code)
