"""
The page in which three.js runs, and what it is given: nothing comes from a network.
"""

from __future__ import annotations

import base64
import mimetypes
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from ...errors import AssetError
from .package import three_folder

#: Everything that the page asks for stands below; the name exists nowhere.
_ORIGIN = "http://three.invalid"

_KINDS = {".js": "text/javascript", ".wasm": "application/wasm"}


class ThreePage:
    """
    ``page.html`` in a browser, with one model at a time.

    Parameters
    ----------
    browser : playwright.sync_api.Browser
        Of :func:`.chromium.chromium`.

    Raises
    ------
    RuntimeUnavailable
        There is no three.js.
    """

    def __init__(self, browser: Any):
        self.shown: object = None
        """What the page shows, as whoever loaded it calls it."""
        self._folders = {"three": three_folder()}
        self._models: list[bytes] = []
        self._page = browser.new_page()
        self._page.route("**/*", self._answer)
        self._page.goto(f"{_ORIGIN}/")
        self._page.wait_for_function("window.ready === true")

    def load(self, model: Path | list[bytes], sky: float, name: str) -> None:
        """
        Show another model: a glTF file with what stands beside it, or GLB files of its parts.

        Parameters
        ----------
        sky : float
            Its radiance.
        name : str
            Of the model, for errors.

        Raises
        ------
        AssetError
            three.js cannot read it.
        """
        from playwright.sync_api import Error

        if isinstance(model, Path):
            self._folders["own"] = model.parent
            urls = [f"{_ORIGIN}/own/{model.name}"]
        else:
            self._models = model
            urls = [f"{_ORIGIN}/written/{k}.glb" for k in range(len(model))]
        try:
            self._page.evaluate("([urls, sky]) => window.load(urls, sky)", [urls, sky])
        except Error as error:
            what = str(error).splitlines()[0].removeprefix("Page.evaluate: ")
            raise AssetError(f"three.js cannot read {name}: {what}") from None

    def shot(self, view: dict) -> np.ndarray:
        """
        An image of the model, linear RGBA from the top row on, flat, as ``page.html`` describes it.
        """
        return np.frombuffer(base64.b64decode(self._page.evaluate("window.shot", view)), np.float32)

    def _answer(self, route: Any) -> None:
        """Give the page itself, three.js and the model, and nothing else."""
        url = urlsplit(route.request.url)
        kind, _, rest = unquote(url.path).removeprefix("/").partition("/")
        folder = self._folders.get(kind)
        if f"{url.scheme}://{url.netloc}" != _ORIGIN:
            route.abort()
        elif not kind:
            page = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
            route.fulfill(body=page, content_type="text/html")
        elif kind == "written":
            route.fulfill(body=self._models[int(Path(rest).stem)], content_type="model/gltf-binary")
        elif folder is None or not _is_inside(folder / rest, folder):
            route.fulfill(status=404)
        else:
            path = folder / rest
            known = _KINDS.get(path.suffix) or mimetypes.guess_type(path.name)[0] or "application/octet-stream"
            route.fulfill(body=path.read_bytes(), content_type=known)


def _is_inside(path: Path, folder: Path) -> bool:
    return path.is_file() and path.resolve().is_relative_to(folder.resolve())
