"""A real browser for the pages that the program writes."""

import shutil
from collections.abc import Iterator

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="session")
def browser() -> Iterator:
    """Headless Chromium with WebGL on the CPU, or a skip that says what is missing; see `make browser`."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="no playwright: run `make browser`")
    executable = next(filter(None, map(shutil.which, NAMES)), None)
    if executable is None:
        pytest.skip(f"no {' or '.join(NAMES[:3])}: run `make browser` as root, or install Debian's chromium")
    arguments = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=arguments)
        yield browser
        browser.close()
