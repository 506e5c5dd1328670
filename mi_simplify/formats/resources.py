"""
The files that a model names: found, read, and images decoded once each.
"""

from __future__ import annotations

import os
import urllib.parse
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np

from ..errors import AssetError
from ..machine import memory
from .images import decode_image, require_pixels

#: Environment variable that names a folder, further up than the model's own, which a model's files may lie in.
ROOT = "MI_SIMPLIFY_ASSET_ROOT"


class MissingFile(AssetError):
    """
    A file that a model names does not exist.
    """


def read_bytes(path: Path, what: str) -> bytes:
    """
    A file's content; ``what`` names it in the message.

    Raises
    ------
    AssetError
        It cannot be read.
    MemoryLimitError
        It is larger than the memory that is left.
    """
    try:
        memory.require(path.stat().st_size, f"{what} '{path.name}'", "reduce the file first")
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

    def find(self, uri: str, what: str, beside: Path | None = None) -> Path:
        """
        The file that a name in the model means; every reader resolves names here (USD's go through its own resolver).

        Parameters
        ----------
        uri : str
            Relative or absolute path with either kind of slash.
        what : str
            'texture', 'buffer', …, for the message.
        beside : Path, optional
            The file that names it, whose folder is looked into before the model's.

        Raises
        ------
        MissingFile
            There is no such file.
        AssetError
            There is, but outside the model's folder: a model from elsewhere could show anything of this machine.
        """
        folder = self.model.parent
        folders = list(dict.fromkeys((folder if beside is None else beside.parent, folder)))
        # Paths of the author's own machine, 'C:\work\x.png', are common in MTL files; the file itself lies beside it.
        slashed, last = uri.replace("\\", "/"), PureWindowsPath(uri).name
        names = dict.fromkeys((uri, slashed, last))
        found = [(f, name) for name in names for f in folders if is_file(f / name)]
        for f, name in found:
            if self.holds(f / name):
                if name not in (uri, slashed):
                    self.note(f"{what} '{printable(uri)}' was taken from '{name}' beside the model")
                return f / name
        if found:
            raise self.outside(uri, what)
        for f in folders:
            for name in names:
                path = _whatever_case(f, name)
                if path is not None and self.holds(path):
                    self.note(f"{what} '{printable(uri)}' was taken from '{path.relative_to(f)}', spelt differently")
                    return path
        raise MissingFile(f"{self.model.name}: {what} '{printable(uri)}' does not exist; put it into {folder}")

    def holds(self, path: Path) -> bool:
        """
        Whether a file lies in the model's folder, links followed, or in the folder that the environment names.
        """
        root = Path(os.environ.get(ROOT) or self.model.parent).resolve()
        return path.resolve().is_relative_to(root)

    def outside(self, uri: str, what: str) -> AssetError:
        """
        The error for a file that lies outside the model's folder.
        """
        return AssetError(
            f"{self.model.name}: {what} '{printable(uri)}' lies outside the model's folder and is not read; put a copy "
            f"beside the model, or let the environment variable {ROOT} name a folder that holds both"
        )

    def find_url(self, uri: str, what: str) -> Path:
        """
        As :meth:`find` for a percent-encoded relative reference (glTF).
        """
        if len(uri.partition(":")[0]) > 1 and "://" in uri:
            raise AssetError(
                f"{self.model.name}: {what} '{printable(uri)}' is not a file; download it beside the model"
            )
        plain = self.model.parent / uri
        return plain if is_file(plain) and self.holds(plain) else self.find(urllib.parse.unquote(uri), what)

    def image(self, uri: str, beside: Path | None = None) -> np.ndarray:
        """
        A texture file, decoded; shape (H, W, C), see :func:`decode_image`; parameters as of :meth:`find`.
        """
        path = self.find(uri, "texture", beside)
        return self.embedded_image(path, lambda: read_bytes(path, f"{self.model.name}: texture"), path.name)

    def embedded_image(self, key: object, data, name: str) -> np.ndarray:
        """
        Decode the image that ``data()`` returns as bytes, once for each ``key``.

        Raises
        ------
        MemoryLimitError
            There is no room for what a material makes of it; each one makes its own.
        """
        if key not in self._images:
            self._images[key] = decode_image(data(), name, self.model.name)
        image = self._images[key]
        require_pixels(image.shape[0], image.shape[1], f"{self.model.name}: texture '{printable(name)}'")
        return image

    def note(self, line: str) -> None:
        """
        Add a line to the notes, once.
        """
        line = printable(line, 400)
        if line not in self.notes:
            self.notes.append(line)


def as_utf8(data: bytes) -> bytes:
    """
    Text of a file in UTF-8 without a byte order mark; UTF-16, with a mark or without, is converted.
    """
    if data.startswith(b"\xef\xbb\xbf"):
        return data[3:]
    head = data[:64]
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif len(head) > 3 and not any(head[1::2]) and all(head[::2]):
        encoding = "utf-16-le"
    elif len(head) > 3 and not any(head[::2]) and all(head[1::2]):
        encoding = "utf-16-be"
    else:
        return data
    return data.decode(encoding, "replace").encode()


def _whatever_case(folder: Path, name: str) -> Path | None:
    """A file below a folder whose name differs in upper and lower case alone, if there is just one."""
    path = folder
    try:
        for part in PurePosixPath(name).parts:
            if part in ("..", ".") or (path / part).exists():
                path = path / part
                continue
            found = [p for p in path.iterdir() if p.name.lower() == part.lower()]
            if len(found) != 1:
                return None
            path = found[0]
    except (OSError, ValueError):
        return None
    return path if is_file(path) else None


def printable(text: str, longest: int = 120) -> str:
    """
    What a file says, as a message shows it: of one line and not too long.
    """
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= longest else f"{text[:longest]}… ({len(text)} characters)"


def is_file(path: Path) -> bool:
    """
    As ``path.is_file()``, also for names that no file can have.
    """
    try:
        return path.is_file()
    except (OSError, ValueError):  # names too long, or with null characters
        return False
