"""
A program of the user's own as a reference renderer: it is started with a JSON of views and answers with images.
"""

from __future__ import annotations

import shlex
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from ...errors import AssetError, UserError
from ...formats.captured.read import read_captured
from ...formats.captured.write import TRANSFORMS, write_captured
from ..views import Views

#: Seconds that a call may take.
LIMIT = 3600


class CommandReference:
    """
    ``COMMAND transforms.json`` as a :class:`.reference.Reference`.

    The file is in a folder of its own and names, for every view, camera, point light and the image that the program has
    to write, see :mod:`...formats.captured.read` for its convention (+Y up, units of the asset); besides, ``asset``,
    ``seed`` and of every frame its ``time`` in the animation. Images are linear EXR with premultiplied alpha; a program
    that writes others changes ``file_path`` (and ``color_space``, ``alpha``) in the file. One call renders many views.

    Parameters
    ----------
    command : str
        As in a shell, without its expansions.
    asset : str
        What it should render, told in the file.
    """

    def __init__(self, command: str, asset: str):
        self.command, self.asset = command, asset

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`.reference.Reference`.

        Raises
        ------
        UserError
            The program cannot be started, fails, or does not write what it was asked for.
        """
        arrays = views.arrays()
        shape = (len(views), views.height, views.width, 4)
        with tempfile.TemporaryDirectory(prefix="mi-simplify-") as folder:
            more = [{"time": float(time)} for time in arrays["frame"]]
            path = write_captured(
                folder, arrays, np.broadcast_to(np.float32(0), shape), format="exr", frames=more,
                document={"asset": self.asset, "seed": int(seed)}, with_images=False,
            )  # fmt: skip
            self._call(path)
            try:
                captured = read_captured(path, may_be_empty=True)
            except AssetError as error:
                raise UserError(f"reference.command: what '{self.command}' wrote cannot be used: {error}") from None
            images = captured.images
        wrong = next((image.shape for image in images if image.shape != shape[1:]), None)
        if wrong is not None or len(images) != len(views):
            got = f"{len(images)} images" if wrong is None else f"an image of {wrong[1]} × {wrong[0]} pixels"
            raise UserError(
                f"reference.command: '{self.command}' wrote {got}; asked for were {len(views)} of {views.width} × "
                f"{views.height}"
            )
        return np.stack(images).astype(np.float32)

    def _call(self, path: Path) -> None:
        try:
            words = shlex.split(self.command)
            done = subprocess.run([*words, str(path)], capture_output=True, text=True, timeout=LIMIT, errors="replace")
        except (ValueError, IndexError, OSError) as error:
            raise UserError(f"reference.command: '{self.command}' cannot be started: {error}") from None
        except subprocess.TimeoutExpired:
            raise UserError(f"reference.command: '{self.command}' took more than {LIMIT} s for {TRANSFORMS}") from None
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip() or "it said nothing").splitlines()[-1]
            raise UserError(f"reference.command: '{self.command}' ended with code {done.returncode}: {said:.300}")
