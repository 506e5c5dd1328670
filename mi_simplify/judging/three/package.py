"""
Where three.js is: a folder that npm has made; nothing of it comes with this program.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from ...errors import RuntimeUnavailable

VARIABLE = "MI_SIMPLIFY_THREE"
"""Environment variable that names the folder of the npm package."""

#: Has what the page imports: ``three/addons``, KTX2 and meshopt.
_LEAST = (0, 152)


def three_folder() -> Path:
    """
    The folder of the npm package ``three``: that of ``MI_SIMPLIFY_THREE``, or ``node_modules/three`` of the working
    folder or one above it.

    Raises
    ------
    RuntimeUnavailable
        There is none, or it is too old.
    """
    named, here = os.environ.get(VARIABLE), Path.cwd()
    places = [Path(named)] if named else [folder / "node_modules" / "three" for folder in (here, *here.parents)]
    found = next((place for place in places if (place / "package.json").is_file()), None)
    if found is None:
        raise RuntimeUnavailable(
            f"--renderer three needs three.js, which is not in {named or 'node_modules here or above'}: "
            f"run `npm install three` here, or name the package's folder in {VARIABLE}"
        )
    version = three_version(found)
    if tuple(int(x) for x in version.split(".")[:2]) < _LEAST:
        raise RuntimeUnavailable(f"--renderer three needs three.js 0.152 or newer, {found} is {version}: update it")
    return found


def three_version(folder: Path) -> str:
    """
    Of a folder of :func:`three_folder`: "0.170.0".
    """
    try:
        return str(json.loads((folder / "package.json").read_text(encoding="utf-8"))["version"])
    except (OSError, ValueError, LookupError, TypeError):
        raise RuntimeUnavailable(f"{folder} is no whole copy of three.js: run `npm install three` again") from None
