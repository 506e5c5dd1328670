"""
What a Mitsuba scene may do on this machine: use Mitsuba's plugins and the files in its own folder, and nothing else.

Mitsuba itself loads a library ``plugins/NAME.so`` from beside the scene, and any file that a path leads to.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mitsuba as mi

from ...errors import AssetError
from ...machine import memory
from ..images import check_image, require_pixels
from ..resources import Resources, is_file, printable, read_bytes

#: Files that a scene may include, each counted as often as it is.
MAX_INCLUDES = 256

#: Plugins whose ``filename`` is an image.
_IMAGES = ("bitmap", "envmap")

#: Memory that any other file takes, over its own size.
_LOADED = 4


def check_text(path: Path) -> None:
    """
    Check the files that Mitsuba reads while it parses a scene: includes and spectra.

    Raises
    ------
    AssetError
        One lies outside the scene's folder, or there are too many.
    """
    resources = Resources(path, [])
    todo, n = [path], 0
    while todo:
        try:
            elements = list(ElementTree.fromstring(read_bytes(todo.pop(), "scene")).iter())
        except ElementTree.ParseError:
            continue  # Mitsuba says where
        for element in elements:
            name = element.get("filename")
            if name is None:
                continue
            if "$" in name:
                raise AssetError(f"{path.name}: the file name '{printable(name)}' holds a parameter; write it out")
            found = Path(str(mi.file_resolver().resolve(name)))
            if is_file(found) and not resources.holds(found):
                raise resources.outside(name, f"<{element.tag}>")
            if is_file(found) and element.tag == "include":
                todo.append(found)
                n += 1
        if n > MAX_INCLUDES:
            raise AssetError(f"{path.name}: it includes more than {MAX_INCLUDES} files; put them into one")


def check_plugins(path: Path, properties: Iterable[tuple[str, dict[str, Any]]]) -> None:
    """
    Check what a parsed scene is made of, before any of it is made.

    Parameters
    ----------
    path : Path
        The scene.
    properties : iterable of (str, dict)
        Name of each plugin, and its parameters.

    Raises
    ------
    AssetError
        A plugin is a library that is not Mitsuba's own, or a parameter names a file outside the scene's folder.
    MemoryLimitError
        An image is larger than the memory that is left.
    """
    resources = Resources(path, [])
    own = Path(mi.__file__).resolve().parent
    total = 0  # bytes of all that will be loaded
    for plugin, values in properties:
        for suffix in (".so", ".dylib", ".dll"):
            library = Path(str(mi.file_resolver().resolve(f"plugins/{plugin}{suffix}")))
            if library.exists() and library.resolve().parent != own / "plugins":
                raise AssetError(
                    f"{path.name}: plugin '{printable(plugin)}' would be loaded from {library}; only Mitsuba's own are"
                )
        if plugin in _IMAGES and "filename" not in values:  # which ends the process
            raise AssetError(f"{path.name}: a '{plugin}' names no image; give it a <string name=\"filename\">")
        for name, value in values.items():
            if not isinstance(value, str) or not value:
                continue
            found = Path(str(mi.file_resolver().resolve(value)))
            if not is_file(found) or found.resolve().is_relative_to(own):
                continue
            if not resources.holds(found):
                raise resources.outside(value, f"{name} of '{plugin}'")
            if name == "filename" and plugin in _IMAGES:
                width, height = check_image(read_bytes(found, f"{path.name}: texture"), value, path.name)
                total = require_pixels(height, width, f"{path.name}: texture '{printable(value)}'", total)
            elif name == "filename":
                total += _LOADED * found.stat().st_size
                memory.require(
                    total, f"{path.name}: '{printable(value)}' with what the scene names before it", "split it"
                )
