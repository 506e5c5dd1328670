"""
A Chromium without a window, found on this machine and driven by Playwright.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...errors import RuntimeUnavailable

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

#: WebGL on the CPU, the same on every machine.
_ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"]


@contextmanager
def chromium(purpose: str) -> Iterator[Any]:
    """
    A running browser, Playwright's ``Browser``, closed afterwards.

    Parameters
    ----------
    purpose : str
        What needs it, for the error.

    Raises
    ------
    RuntimeUnavailable
        There is no Playwright, or no Chromium on PATH or among Playwright's own.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise RuntimeUnavailable(
            f"{purpose} needs Playwright: pip install 'mi-simplify[browser]', and a Chromium ({error})"
        ) from error
    with sync_playwright() as playwright:
        own = playwright.chromium.executable_path
        program = next(filter(None, map(shutil.which, NAMES)), own if Path(own).is_file() else None)
        if program is None:
            raise RuntimeUnavailable(
                f"{purpose} needs a Chromium: install Debian's package chromium, or run `playwright install chromium`"
            )
        browser = playwright.chromium.launch(executable_path=program, args=_ARGUMENTS)
        try:
            yield browser
        finally:
            browser.close()
