"""A real browser for the pages that the program writes."""

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from mi_simplify.errors import RuntimeUnavailable
from mi_simplify.judging.three.chromium import chromium


@pytest.fixture(scope="session")
def browser() -> Iterator:
    """Headless Chromium with WebGL on the CPU, or a skip that says what is missing; see `make browser`."""
    with ExitStack() as stack:
        try:
            opened = stack.enter_context(chromium("a test"))
        except RuntimeUnavailable as error:
            pytest.skip(f"{error}; or run `make browser`")
        yield opened
