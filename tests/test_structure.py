"""Imports run one way along the stages, and only the command line prints."""

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "mi_simplify"

#: What may be imported by what comes after it.
STAGES = (
    "errors", "progress", "machine", "config", "scenes", "frame", "initial", "latent", "bsdfs", "integrators",
    "fitting", "export", "report", "record", "subjects", "jobs", "display", "cli",
)  # fmt: skip

#: Plain NumPy, or the look of a surface alone: for every stage.
EVERYWHERE = {
    "bsdfs", "latent.harmonics", "latent.mips", "latent.model", "latent.tangents", "latent.tessellation",
    "latent.topology",
}  # fmt: skip


def imports(path: Path) -> Iterator[tuple[str, int]]:
    """Modules of the package that a module imports, as seen from the package, and the lines."""
    package = ("mi_simplify", *path.relative_to(PACKAGE).parts[:-1])
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1] + tuple(
                (node.module or "").split(".") if node.module else ()
            )
            names = [base] if len(base) > 1 else [(*base, alias.name) for alias in node.names]
            yield from ((".".join(name[1:]), node.lineno) for name in names)


def test_imports_run_one_way_along_the_stages():
    wrong, n = [], 0
    for path in PACKAGE.rglob("*.py"):
        stage = path.relative_to(PACKAGE).with_suffix("").parts[0]
        for name, line in imports(path):
            target = name.split(".")[0]
            n += 1
            if stage in STAGES and target in STAGES and STAGES.index(target) > STAGES.index(stage):
                if ".".join(name.split(".")[:2]) not in EVERYWHERE:
                    wrong.append(f"{path.relative_to(PACKAGE)}:{line} imports {name}")
    assert n > 500 and not wrong, "\n".join(wrong)


def test_every_module_is_in_a_stage():
    known = {*STAGES, "__init__", "__main__"}
    assert {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()} <= known
