"""
The files that a model names: found, read, and images decoded once each.
"""

from __future__ import annotations

import urllib.parse
from pathlib import Path, PureWindowsPath

import numpy as np

from ..errors import AssetError
from .images import decode_image


def read_bytes(path: Path, what: str) -> bytes:
    """
    A file's content; ``what`` names it in the message.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise AssetError(f"{what} '{path}' cannot be read: {error.strerror or error}") from error


class Resources:
    """
    What one model file refers to by relative path.

    Parameters
    ----------
    model : Path
        The model file; names are relative to its folder.
    notes : list of str
        Grows by a line for every name that had to be bent to be found.
    """

    def __init__(self, model: Path, notes: list[str]):
        self.model = model
        self.notes = notes
        self._images: dict[object, np.ndarray] = {}

    def find(self, uri: str, what: str) -> Path:
        """
        The file that a name in the model means; every reader resolves names here (USD's go through its own resolver).

        Parameters
        ----------
        uri : str
            Relative or absolute path with either kind of slash.
        what : str
            'texture', 'buffer', …, for the message.

        Raises
        ------
        AssetError
            There is no such file.
        """
        folder = self.model.parent
        path = folder / uri
        if _is_file(path):
            return path
        # Paths of the author's own machine, 'C:\work\x.png', are common in MTL files; the file itself lies beside it.
        slashed = folder / uri.replace("\\", "/")
        beside = folder / PureWindowsPath(uri).name
        for candidate in (slashed, beside):
            if _is_file(candidate):
                if candidate == beside != slashed:
                    self.note(f"{what} '{uri}' was taken from '{candidate.name}' beside the model")
                return candidate
        raise AssetError(f"{self.model.name}: {what} '{uri}' does not exist; put it into {folder}")

    def find_url(self, uri: str, what: str) -> Path:
        """
        As :meth:`find` for a percent-encoded relative reference (glTF).
        """
        if len(uri.partition(":")[0]) > 1 and "://" in uri:
            raise AssetError(f"{self.model.name}: {what} '{uri[:80]}' is not a file; download it beside the model")
        if _is_file(self.model.parent / uri):
            return self.model.parent / uri
        return self.find(urllib.parse.unquote(uri), what)

    def image(self, uri: str) -> np.ndarray:
        """
        A texture file, decoded; shape (H, W, C), see :func:`decode_image`.
        """
        path = self.find(uri, "texture")
        return self.embedded_image(path, lambda: read_bytes(path, f"{self.model.name}: texture"), path.name)

    def embedded_image(self, key: object, data, name: str) -> np.ndarray:
        """
        Decode the image that ``data()`` returns as bytes, once for each ``key``.
        """
        if key not in self._images:
            self._images[key] = decode_image(data(), name, self.model.name)
        return self._images[key]

    def note(self, line: str) -> None:
        """
        Add a line to the notes, once.
        """
        if line not in self.notes:
            self.notes.append(line)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # names too long, or with null characters
        return False
