"""
Runs the notebooks of `docs/tutorials` and stores what they print and show.

    python docs/run_tutorials.py                      # all of them, each in a process and an empty folder of its own
    python docs/run_tutorials.py first_model --check  # one of them, whose file stays as it is

It needs no Jupyter: code cells run one after the other in one namespace, and the last expression of a cell is shown, as
a picture where it knows how (`_repr_png_`, as Pillow's images do). The first cell that fails ends it, with a traceback.
"""

from __future__ import annotations

import argparse
import ast
import base64
import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

TUTORIALS = Path(__file__).resolve().parent / "tutorials"


def outputs_of(source: str, namespace: dict, count: int) -> list[dict]:
    """Run the code of a cell; its outputs in the form of notebooks."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    value, printed = None, io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, f"cell {count}", "exec"), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"cell {count}", "eval"), namespace)
    out: list[dict] = []
    if printed.getvalue():
        out.append({"name": "stdout", "output_type": "stream", "text": printed.getvalue().splitlines(keepends=True)})
    if value is not None:
        data: dict = {"text/plain": repr(value).splitlines(keepends=True)}
        if hasattr(value, "_repr_png_"):
            data = {"image/png": base64.b64encode(value._repr_png_()).decode(), "text/plain": ["<picture>"]}
        out.append({"data": data, "execution_count": count, "metadata": {}, "output_type": "execute_result"})
    return out


def run(path: Path, check: bool) -> None:
    """Run a notebook in an empty folder; its outputs are stored unless it is only checked."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    namespace: dict = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for count, cell in enumerate((c for c in notebook["cells"] if c["cell_type"] == "code"), 1):
            cell["outputs"], cell["execution_count"] = outputs_of("".join(cell["source"]), namespace, count), count
    if not check:
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="notebooks, without their suffix; all if there is none")
    parser.add_argument("--check", action="store_true", help="leave the files as they are")
    options = parser.parse_args()
    names = options.names or sorted(path.stem for path in TUTORIALS.glob("*.ipynb"))
    if len(names) == 1:
        warnings.simplefilter("error")
        run(TUTORIALS / f"{names[0]}.ipynb", options.check)
    else:
        os.environ.setdefault("PYTHONUNBUFFERED", "1")
        flags = ["--check"] * options.check
        sys.exit(max(subprocess.run([sys.executable, __file__, name, *flags]).returncode for name in names))
