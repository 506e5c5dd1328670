"""
Python code of the user's own, by its name.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..config.section import CODE_NAME
from ..errors import AssetError


def run_extensions(names: Iterable[str]) -> None:
    """
    Import modules or files of the user's own, which register what they add; a second time nothing happens.

    Raises
    ------
    AssetError
        There is no such module or file, or its code fails.
    """
    for name in names:
        if name not in _RUN:
            _loaded(name, f"extension '{name}'")
            _RUN.add(name)


#: Extensions that have run in this process.
_RUN: set[str] = set()


def code_named(text: str, purpose: str) -> Any:
    """
    What ``package.module:name`` or ``file.py:name`` stands for: this runs the user's own Python code.

    Modules are looked for beside the working directory, too.

    Raises
    ------
    AssetError
        There is no such module or name, or its code fails.
    """
    match = CODE_NAME.match(text)
    if match is None:
        raise AssetError(f"the {purpose} '{text}' should read package.module:name or file.py:name")
    module, name = match["module"], match["name"]
    loaded = _loaded(module, f"{purpose} '{text}'")
    if not hasattr(loaded, name):
        raise AssetError(f"the {purpose} '{text}': {module} has no '{name}'")
    return getattr(loaded, name)


def _loaded(module: str, what: str) -> Any:
    """A module by its name or file, imported."""
    try:
        return _module_of_file(Path(module)) if module.endswith(".py") else _module_named(module)
    except AssetError:
        raise
    except Exception as error:
        line = (str(error).splitlines() or [""])[0]
        raise AssetError(f"the {what}: {module} fails: {type(error).__name__}: {line}") from error


def _module_named(name: str) -> Any:
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # as `python -m` does, and the installed command does not
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and not name.startswith(error.name):
            raise
        raise AssetError(f"there is no module '{name}', in {Path.cwd()} or among what is installed") from None


def _module_of_file(path: Path) -> Any:
    if not path.is_file():
        raise AssetError(f"the file '{path}' does not exist")
    spec = importlib.util.spec_from_file_location(f"mi_simplify_user_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
