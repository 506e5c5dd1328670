"""Fixtures: a variant for every test, and the optional folder of real models."""

import os
import subprocess
import sys
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


@pytest.fixture
def node_run():
    """Run a script in node with a package that it needs, or skip; see ``npm i gltf-validator mikktspace``."""

    def run(package: str, script: str, stdin: str | bytes) -> str:
        root = Path(__file__).resolve().parents[1]
        try:
            probe = subprocess.run(
                ["node", "-e", f"require.resolve('{package}')"], cwd=root, capture_output=True, timeout=60
            )
        except FileNotFoundError:
            pytest.skip("node is not installed")
        if probe.returncode:
            pytest.skip(f"node package missing: npm i --no-save {package}")
        done = subprocess.run(
            ["node", "-e", script],
            cwd=root,
            input=stdin.encode() if isinstance(stdin, str) else stdin,
            capture_output=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout.decode()

    return run


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Remember how the run ended, for the hook below."""
    session.config.stash[_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """
    Leave without tearing Dr.Jit down: after a whole run, all reports written, its teardown was seen to crash once.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    if _STATUS in config.stash:
        os._exit(config.stash[_STATUS])


_STATUS = pytest.StashKey[int]()
