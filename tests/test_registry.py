"""Registries: a name is taken once, and who asks for another hears which there are."""

import pytest

from mi_simplify.errors import AssetError, ConfigError
from mi_simplify.machine.user_code import run_extensions
from mi_simplify.registry import Registry


def test_names_are_taken_once_and_the_latest_comes_first():
    registry: Registry[int] = Registry("number")
    registry.register("one", 1)
    registry.register("two", 2)
    with pytest.raises(ValueError, match="the number 'one' is there already; pass replace=True"):
        registry.register("one", 3)
    registry.register("one", 3, replace=True)
    assert registry["one"] == 3 and list(registry) == ["one", "two"]
    assert [name for name, _ in registry.latest_first()] == ["two", "one"]
    with pytest.raises(ConfigError, match="unknown number 'oen', did you mean 'one'\\?; one of one, two"):
        registry["oen"]


def test_extensions_run_once_and_fail_in_one_line(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("import pathlib\nwith open(pathlib.Path(__file__).with_name('ran'), 'a') as f: f.write('x')\n")
    run_extensions([str(file)])
    run_extensions([str(file)])
    assert (tmp_path / "ran").read_text() == "x"
    (tmp_path / "broken.py").write_text("1 / 0")
    with pytest.raises(AssetError, match="the extension .*broken.py': .*ZeroDivisionError: division by zero"):
        run_extensions([str(tmp_path / "broken.py")])
    with pytest.raises(AssetError, match="the file .*none.py' does not exist"):
        run_extensions([str(tmp_path / "none.py")])
