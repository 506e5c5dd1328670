"""Fixtures: a variant for every test, and the optional folder of real models."""

import subprocess
from pathlib import Path

import pytest
from support.paths import ROOT
from support.toy import files

from mi_simplify import cli
from mi_simplify.machine import runtime


@pytest.fixture(scope="session", autouse=True)
def variant() -> str:
    """The variant that all tests run in."""
    return runtime.ensure_variant()


@pytest.fixture
def shared_assets() -> Path:
    """Real models beside the checkout; tests that want them skip where they are not."""
    path = ROOT.parent / "shared" / "assets"
    if not path.is_dir():
        pytest.skip("shared/assets is not beside this checkout")
    return path


@pytest.fixture
def node_run():
    """Run a script in node with a package that it needs, or skip; see ``npm i gltf-validator mikktspace``."""

    def run(package: str, script: str, stdin: str | bytes) -> str:
        root = ROOT
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


@pytest.fixture
def rejected(tmp_path, monkeypatch, capsys):
    """Run a command line that must end with code 2 and one line, and leave no file behind; returns the line."""
    monkeypatch.chdir(tmp_path)

    def run(*argv: str) -> str:
        before = files(tmp_path)
        assert cli.main(list(argv)) == 2
        out, err = capsys.readouterr()
        assert err.count("\n") == 1, err
        assert err.startswith("error: ")
        assert "Traceback" not in out + err
        assert files(tmp_path) == before
        return err

    return run


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests last, so that a run that is stopped has done the others."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is not None)
