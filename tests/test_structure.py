"""The plan of the house: imports run one way between packages, between folders and between files; only cli/ prints."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from support.paths import ROOT

PACKAGE = ROOT / "mi_simplify"

#: From the ground floor up; a package imports from those before it and from itself.
FLOORS = (
    "errors", "registry", "progress", "config", "model", "machine", "bsdfs", "formats", "scenes", "initial", "latent",
    "integrators", "plugins", "fitting", "export", "judging", "report", "record", "subjects", "transfer",
    "jobs", "display", "cli",
)  # fmt: skip

#: Modules that a folder holds at most.
MOST_MODULES = 16


def modules() -> dict[str, Path]:
    """Every module by its dotted name below the package; a package is its ``__init__``."""
    out = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return out


MODULES = modules()


def imports(name: str) -> Iterator[tuple[str, int]]:
    """Modules of the package that a module imports anywhere in it, for types too, and the lines."""
    path = MODULES[name]
    package = path.relative_to(PACKAGE).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = (*package[: len(package) - node.level + 1], *(node.module.split(".") if node.module else ()))
            for alias in node.names:
                whole = ".".join((*base, alias.name))
                yield whole if whole in MODULES else ".".join(base), node.lineno


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Some circle of a graph, or nothing."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_imports_run_up_the_floors():
    wrong, n = [], 0
    for name in MODULES:
        floor = name.split(".")[0]
        for target, line in imports(name):
            n += 1
            above = target.split(".")[0]
            if floor in FLOORS and above in FLOORS and FLOORS.index(above) > FLOORS.index(floor):
                wrong.append(f"{name}:{line} imports {target}")
    assert n > 500 and not wrong, "\n".join(wrong)


def test_no_two_files_import_each_other():
    graph = {name: {target for target, _ in imports(name)} - {name, ""} for name in MODULES}
    assert not circle(graph), " imports ".join(circle(graph))


def test_no_two_folders_import_each_other():
    """Beside each other in the same folder, at every depth; a file counts with the folder that it is in."""
    depth = max(name.count(".") for name in MODULES)
    for k in range(depth + 1):
        graph: dict[str, set[str]] = {}
        for name in MODULES:
            for target, _ in imports(name):
                a, b = name.split("."), target.split(".")
                if a[:k] == b[:k] and len(a) > k and len(b) > k and a[k] != b[k]:
                    graph.setdefault(".".join(a[: k + 1]), set()).add(".".join(b[: k + 1]))
        assert not circle(graph), " imports ".join(circle(graph))


def test_every_module_is_on_a_floor_and_no_folder_is_crowded():
    assert {name.split(".")[0] for name in MODULES} <= {*FLOORS, "", "__main__"}
    for folder in {path.parent for path in MODULES.values()}:
        n = len(list(folder.glob("*.py")))
        assert n <= MOST_MODULES, f"{folder.relative_to(ROOT)} holds {n} modules; make a room of some of them"
