"""The notebooks of docs/tutorials are valid, small, listed, and run."""

import importlib.util
import json
import os
import subprocess
import sys
from types import ModuleType

import pytest
import yaml
from support.paths import ROOT

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))

every_tutorial = pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)


def module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


@every_tutorial
def test_a_notebook_is_complete_and_small(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    ids = [cell["id"] for cell in notebook["cells"]]
    assert len(set(ids)) == len(ids)
    assert "".join(notebook["cells"][0]["source"]).startswith("# ")
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1)), "run it: docs/run_tutorials.py"
    assert any("image/png" in output.get("data", {}) for cell in code for output in cell["outputs"])
    assert path.stat().st_size < 300_000


@every_tutorial
def test_a_notebook_is_listed(path):
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    (pages,) = [page["Tutorials"] for page in nav if "Tutorials" in page]
    assert f"tutorials/{path.stem}.md" in [file for page in pages if isinstance(page, dict) for file in page.values()]
    assert f"]({path.name})" in (ROOT / "docs" / "tutorials" / "index.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.timeout(900)
@every_tutorial
def test_a_notebook_runs(path):
    command = [sys.executable, ROOT / "docs" / "run_tutorials.py", path.stem, "--check"]
    before = path.read_bytes()
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr[-3000:]
    assert path.read_bytes() == before


def test_cells_run_in_one_namespace_and_show_their_last_expression():
    outputs_of, namespace = module("run_tutorials").outputs_of, {}
    assert outputs_of("x = 2\nprint('hello')", namespace, 1) == [
        {"name": "stdout", "output_type": "stream", "text": ["hello\n"]}
    ]
    (shown,) = outputs_of("x + 1", namespace, 2)
    assert shown["data"] == {"text/plain": ["3"]} and shown["execution_count"] == 2
    (picture,) = outputs_of("from PIL import Image\nImage.new('L', (2, 2))", namespace, 3)
    assert picture["data"]["image/png"].startswith("iVBORw0KGgo")
    assert outputs_of("None", namespace, 4) == []
    with pytest.raises(ZeroDivisionError):
        outputs_of("1 / 0", namespace, 5)


def test_notebooks_become_pages():
    pytest.importorskip("mkdocs")
    pages = module("notebook_pages")
    cells = [
        {"cell_type": "markdown", "source": ["# Title\n", "text"]},
        {
            "cell_type": "code",
            "source": ["1 + 1"],
            "outputs": [
                {"text": ["printed\n"]},
                {"data": {"text/plain": ["2"]}},
                {"data": {"image/png": "AAAA", "text/plain": [""]}},
            ],
        },
    ]
    text = pages.markdown(json.dumps({"cells": cells}))
    assert text.split("\n\n") == [
        "# Title\ntext", "```python\n1 + 1\n```", "```text\nprinted\n```", "```text\n2\n```",
        '<img alt="output of the code above" src="data:image/png;base64,AAAA">',
    ]  # fmt: skip
    assert pages.on_page_markdown("[a](own_loss.ipynb)") == "[a](own_loss.md)"
    assert pages.on_page_markdown("[This page as a notebook](a.ipynb)") == "[This page as a notebook](a.ipynb)"
