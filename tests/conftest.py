"""Fixtures: a variant for every test, and the optional folder of real models."""

from pathlib import Path

import pytest

from mi_simplify import runtime


@pytest.fixture(scope="session", autouse=True)
def variant() -> str:
    """The variant that all tests run in."""
    return runtime.ensure_variant()


@pytest.fixture
def shared_assets() -> Path:
    """Real models beside the checkout; tests that want them skip where they are not."""
    path = Path(__file__).resolve().parents[2] / "shared" / "assets"
    if not path.is_dir():
        pytest.skip("shared/assets is not beside this checkout")
    return path
