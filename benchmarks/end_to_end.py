"""
Whole commands from the shell to the report: seconds, memory and likeness, beside Blender's where it is at hand.

    python benchmarks/end_to_end.py --assets ../shared/assets --judge ../shared/tools/judge.py
    python benchmarks/end_to_end.py ... --blender PYTHON_WITH_BPY --bake ../shared/tools/blender_bake.py
    python benchmarks/end_to_end.py --smallest ASSET   # two steps, nothing written, to see that all of this runs

Every row is one process after the other on one machine, so that their *ratios* mean something where their seconds do
not. The table goes into docs/performance.md.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "performance.md"
BEGIN, END = "<!-- figures: benchmarks/end_to_end.py -->", "<!-- end of whole commands -->"

#: Asset and triangles.
CASES = [
    ("skull/skull.obj", 3000),
    ("spot/spot.obj", 1000),
    ("bishop/bishop.glb", 1500),
    ("scorpion/scorpion.obj", 3000),
]

#: Name and options of the commands that are compared.
COMMANDS: dict[str, list[str]] = {"fast": ["--preset", "fast"], "default": []}

SMALLEST = [
    "initial.atlas_size=64", "optimizer.steps=2", "optimizer.resolution=32", "optimizer.batch=1", "reference.pool=4",
    "reference.refresh=1", "evaluation.views=1", "evaluation.resolution=32", "evaluation.spp=4",
]  # fmt: skip


@dataclass
class Row:
    """
    What one command took.

    Parameters
    ----------
    case, command : str
    seconds, cpu : float
        By the clock, and of all processors together.
    memory : float
        Peak of the process [MB].
    stages : dict
        Seconds of the stages, as ``metrics.json`` has them.
    steps : int
        Of the fit.
    judged : dict
        ``psnr``, ``flip``, ``silhouette_error`` by the outside judge, where there is one.
    """

    case: str
    command: str
    seconds: float
    cpu: float
    memory: float
    stages: dict[str, float] = field(default_factory=dict)
    steps: int = 0
    judged: dict[str, float] = field(default_factory=dict)


def measured(case: str, name: str, command: list[str]) -> Row:
    """
    Run a command to its end in a process of its own.
    """
    start = time.perf_counter()
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            errors.seek(0)
            sys.exit(f"{' '.join(command)} failed:\n{errors.read()}")
    return Row(case, name, seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def simplified(asset: Path, triangles: int, name: str, options: list[str], out: Path) -> Row:
    """
    One ``mi-simplify simplify``, with what it says of its stages.
    """
    case = f"{asset.stem}, {triangles:,}"
    command = [sys.executable, "-m", "mi_simplify", "simplify", str(asset), "-n", str(triangles), "-q", *options]
    row = measured(case, name, [*command, "-o", str(out)])
    row.stages = json.loads((out / "metrics.json").read_text())["run"]["seconds"]
    log = (out / "log.jsonl").read_text().splitlines() if (out / "log.jsonl").exists() else []
    row.steps = json.loads(log[-1])["step"] if log else 0
    return row


def judged(judge: Path, asset: Path, files: list[Path]) -> list[dict]:
    """
    What the outside judge says of files.
    """
    command = [sys.executable, str(judge), str(asset), *map(str, files)]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return [json.loads(line) for line in lines if line.startswith("{")]


def case_rows(asset: Path, triangles: int, options: argparse.Namespace, folder: Path) -> list[Row]:
    """
    All commands on one asset, Blender's first.
    """
    rows, files = [], []
    if options.blender is not None:
        file = folder / f"{asset.stem}.blender.glb"
        command = [str(options.blender), str(options.bake), str(asset), str(triangles), str(file)]
        rows.append(measured(f"{asset.stem}, {triangles:,}", "Blender", command))
        files.append(file)
    for name, more in COMMANDS.items():
        out = folder / f"{asset.stem}.{name}"
        rows.append(simplified(asset, triangles, name, more + options.more, out))
        files.append(out / "model.glb")
    if options.judge is not None:
        for row, figures in zip(rows, judged(options.judge, asset, files), strict=True):
            row.judged = {key: figures[key] for key in ("psnr", "flip", "silhouette_error")}
    return rows


def table(rows: list[Row]) -> list[str]:
    """
    Markdown lines: a row a command, its time beside Blender's of the same case.
    """
    lines = [
        "| case | command | s | over Blender's | CPU s | first guess | fit | steps | evaluation | memory | judged |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |",
    ]  # fmt: skip
    blender = {row.case: row.seconds for row in rows if row.command == "Blender"}
    for row in rows:
        ratio = f"{row.seconds / blender[row.case]:.1f}" if row.case in blender else ""
        stages = [f"{row.stages[k]:.1f}" if k in row.stages else "" for k in ("first guess", "fit", "evaluate")]
        share = f"{stages[2]} ({100 * row.stages['evaluate'] / row.seconds:.0f} %)" if row.stages else ""
        told = "{psnr:.2f} / {flip:.4f} / {silhouette_error:.4f}".format(**row.judged) if row.judged else ""
        lines.append(
            f"| {row.case} | {row.command} | {row.seconds:.1f} | {ratio} | {row.cpu:.1f} | {stages[0]} | {stages[1]} "
            f"| {row.steps or ''} | {share} | {row.memory:.0f} MB | {told} |"
        )
    return lines


def machine() -> str:
    """The processor, in a sentence."""
    cpuinfo = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    busy = f", {os.getloadavg()[0]:.1f} other processes at work" if hasattr(os, "getloadavg") else ""
    return f"Measured on: {(names or [platform.processor()])[0]}, {cores} cores{busy}."


def write(lines: list[str]) -> None:
    """
    Put the table between its marks in docs/performance.md.
    """
    before, _, rest = DOCUMENT.read_text().partition(BEGIN)
    DOCUMENT.write_text(before + "\n".join([BEGIN, "", *lines, "", END]) + rest.partition(END)[2])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, help="folder of the assets")
    parser.add_argument("--only", nargs="*", default=[], help="stems of the assets to run")
    parser.add_argument("--judge", type=Path, help="a program that judges files: JUDGE REFERENCE CANDIDATE...")
    parser.add_argument("--blender", type=Path, help="a Python that has the module bpy")
    parser.add_argument("--bake", type=Path, help="what it runs: BAKE ASSET TRIANGLES OUT.glb")
    parser.add_argument("--more", nargs="*", default=[], help="options for all of our commands")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    parser.add_argument("--smallest", type=Path, metavar="ASSET", help="two steps on this one, nothing written")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.smallest is not None:
            settings = [word for setting in SMALLEST for word in ("--set", setting)]
            rows = [simplified(options.smallest, 200, "smallest", settings, Path(folder, "out"))]
        else:
            if options.assets is None or (options.blender is None) != (options.bake is None):
                parser.error("--assets is needed, and --blender and --bake go together")
            rows = []
            for name, triangles in CASES:
                asset = options.assets / name
                if asset.stem in options.only or not options.only:
                    rows += case_rows(asset, triangles, options, Path(folder))
                    print("\n".join(table(rows)), file=sys.stderr)
        lines = [machine(), "", *table(rows)]
    print("\n".join(lines))
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    if options.smallest is None:
        write(lines)


if __name__ == "__main__":
    main()
