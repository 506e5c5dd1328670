"""
Draws `docs/architecture.svg` from the imports of the package: every folder is a room, and a room stands one floor above
all that it imports.

    python docs/draw_architecture.py           # `make docs` calls it

An arrow goes from a room to what it imports. Imports that follow from two or more arrows are left out (the transitive
reduction), since nearly everything imports the ground floor. Positions are those of Sugiyama et al. 1981: floors by the
longest path, order within a floor by barycentres, arrows that pass a floor have a place of their own on it.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import sys
import textwrap
from collections import defaultdict
from collections.abc import Iterable
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

ROOM_WIDTH, ROOM_HEIGHT, FLOOR_HEIGHT = 196, 76, 116
GAP, LANE, MARGIN = 26, 26, 34
"""Between two rooms, for an arrow that passes a floor, and around the house [px]."""

PULL = 0.12
"""Weight of the middle of the house beside one arrow."""

Graph = dict[str, set[str]]


def modules(package: Path) -> dict[str, list[Path]]:
    """The files of each room: a folder, or a module beside the folders."""
    rooms = defaultdict(list)
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).with_suffix("").parts[0]
        if not name.startswith("__"):
            rooms[name].append(path)
    return dict(rooms)


def imported(path: Path, package: Path) -> set[str]:
    """Rooms that a module imports from, by statements or by a whole name in a string; its own is left out."""
    inside = (package.name, *path.relative_to(package).parts[:-1])
    names: set[tuple[str, ...]] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = (*inside[: len(inside) - node.level + 1], *(node.module or "").split("."))
            base = tuple(part for part in base if part)
            names |= {base} if len(base) > 1 else {(*base, alias.name) for alias in node.names}
        elif isinstance(node, ast.Constant) and str(node.value).startswith(f"{package.name}."):
            names.add(tuple(node.value.split(".")))
    own = path.relative_to(package).with_suffix("").parts[0]
    return {name[1] for name in names if not name[1].startswith("__")} - {own}


def graph_of(package: Path) -> Graph:
    """What every room imports."""
    rooms = modules(package)
    graph = {room: set().union(*(imported(path, package) for path in paths)) for room, paths in rooms.items()}
    return {room: targets & rooms.keys() for room, targets in graph.items()}


def sorted_rooms(graph: Graph) -> list[str]:
    """All rooms, each behind everything that it imports; ends the program where they go round in a circle."""
    order: list[str] = []
    left = {room: set(targets) for room, targets in graph.items()}
    while left:
        free = sorted(room for room, targets in left.items() if not targets & left.keys())
        if not free:
            sys.exit(f"error: these import each other, so that none is above the others: {', '.join(sorted(left))}")
        order += free
        left = {room: targets for room, targets in left.items() if room not in free}
    return order


def reduced(graph: Graph) -> Graph:
    """Without imports that follow from others."""
    reach: Graph = {}
    for room in sorted_rooms(graph):
        reach[room] = graph[room].union(*(reach[target] for target in graph[room]))
    return {
        room: {t for t in targets if not any(t in reach[other] for other in targets)} for room, targets in graph.items()
    }


def floors_of(graph: Graph) -> dict[str, int]:
    """The floor of each room: above all that it imports, and where its arrows are short."""
    order = sorted_rooms(graph)
    floor: dict[str, int] = {}
    for room in order:
        floor[room] = 1 + max((floor[target] for target in graph[room]), default=-1)
    users = {room: [user for user in graph if room in graph[user]] for room in graph}
    for room in reversed(order):  # from the top, so that what is above stands already
        if 0 < len(users[room]) >= len(graph[room]):
            floor[room] = max(floor[room], min(floor[user] for user in users[room]) - 1)
    lowest = sorted(set(floor.values()))
    return {room: lowest.index(k) for room, k in floor.items()}


def width(node: str) -> int:
    return LANE if ">" in node else ROOM_WIDTH


def layout(graph: Graph, floor: dict[str, int]) -> tuple[dict[str, float], list[list[str]]]:
    """
    The centre of every room and of every place where an arrow passes a floor, and the arrows as chains of them.
    """
    rows: list[list[str]] = [[] for _ in range(max(floor.values()) + 1)]
    for room in sorted(graph):
        rows[floor[room]].append(room)
    chains, beside = [], defaultdict(list)
    for room, target in sorted((user, target) for user in graph for target in graph[user]):
        between = [f"{room}>{target}>{k}" for k in range(floor[room] - 1, floor[target], -1)]
        for node, k in zip(between, range(floor[room] - 1, floor[target], -1), strict=True):
            rows[k].append(node)
        chains.append([room, *between, target])
        for a, b in itertools.pairwise(chains[-1]):
            beside[a].append(b)
            beside[b].append(a)

    def placed(order: list[list[str]]) -> dict[str, float]:
        return {node: k - (len(row) - 1) / 2 for row in order for k, node in enumerate(row)}

    def crossings(order: list[list[str]]) -> float:
        x, n = placed(order), 0.0
        for lower, upper in itertools.pairwise(order):
            lines = [(x[a], x[b]) for a in upper for b in beside[a] if b in set(lower)]
            n += sum((p[0] - q[0]) * (p[1] - q[1]) < 0 for p, q in itertools.combinations(lines, 2))
            n += 1e-3 * sum(abs(a - b) for a, b in lines)
        return n

    best = rows
    for sweep in range(40):
        x = placed(rows)
        for k in range(len(rows)) if sweep % 2 else reversed(range(len(rows))):
            near = set(rows[k - 1] if sweep % 2 and k else rows[k + 1] if k + 1 < len(rows) else [])
            weight = {n: [x[m] for m in beside[n] if not near or m in near] or [x[n]] for n in rows[k]}
            rows[k] = sorted(rows[k], key=lambda n: sum(weight[n]) / len(weight[n]))  # noqa: B023
            x |= placed([rows[k]])
        if crossings(rows) < crossings(best):
            best = [list(row) for row in rows]
    best = exchanged(best, crossings)

    # Centres: everything is drawn to the middle of its neighbours, a little to that of the house, and keeps its
    # distance.
    x = {node: 200.0 * place for node, place in placed(best).items()}
    for _ in range(300):
        for row in best:
            wanted = [sum(x[m] for m in beside[n]) / (len(beside[n]) + PULL) for n in row]
            x |= zip(row, spread(wanted, row), strict=True)
    return x, chains


def exchanged(rows: list[list[str]], cost) -> list[list[str]]:
    """Neighbours on a floor change places as long as fewer arrows cross."""
    best, improved = cost(rows), True
    while improved:
        improved = False
        for row in rows:
            for k in range(len(row) - 1):
                row[k], row[k + 1] = row[k + 1], row[k]
                if (now := cost(rows)) < best - 1e-9:
                    best, improved = now, True
                else:
                    row[k], row[k + 1] = row[k + 1], row[k]
    return rows


def spread(wanted: list[float], row: list[str]) -> list[float]:
    """Places closest to the wanted ones in the sense of least squares, in order and without overlap (pool adjacent)."""
    offsets = [0.0]
    for a, b in itertools.pairwise(row):
        offsets.append(offsets[-1] + (width(a) + width(b)) / 2 + GAP)
    blocks: list[list[float]] = []  # sum and count
    for place, offset in zip(wanted, offsets, strict=True):
        blocks.append([place - offset, 1])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] > blocks[-1][0] / blocks[-1][1]:
            total, n = blocks.pop()
            blocks[-1] = [blocks[-1][0] + total, blocks[-1][1] + n]
    means = [total / n for total, n in blocks for _ in range(int(n))]
    return [mean + offset for mean, offset in zip(means, offsets, strict=True)]


def summary(room: str, package: Path) -> str:
    """The first sentence of a room's docstring, as much as fits into it."""
    path = package / room / "__init__.py"
    text = ast.get_docstring(ast.parse((path if path.is_file() else package / f"{room}.py").read_text("utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


STYLE = """
.paper { fill: #fbfbf8 } .floor { fill: #f1f2ee } .line { stroke: #d9dbd3; stroke-width: 1 }
.room { fill: #ffffff; stroke: #8d97a8; stroke-width: 1.2 } .file { stroke-dasharray: 3 3 }
.name { font: 600 15px ui-monospace, "SF Mono", Menlo, Consolas, monospace; fill: #1f2a44 }
.text { font: 11px system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; fill: #5c6478 }
.arrow { fill: none; stroke: #6b83b8; stroke-width: 1.5 } .head { fill: #6b83b8 }
"""


def arrow(points: Iterable[tuple[float, float]]) -> str:
    """A smooth line through points from top to bottom."""
    points = list(points)
    path = f"M{points[0][0]:.1f},{points[0][1]:.1f}"
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        middle = (y0 + y1) / 2
        path += f" C{x0:.1f},{middle:.1f} {x1:.1f},{middle:.1f} {x1:.1f},{y1:.1f}"
    return path


def svg(package: Path) -> str:
    """The picture."""
    full = graph_of(package)
    graph = reduced(full)
    floor = floors_of(graph)
    x, chains = layout(graph, floor)
    left = min(place - width(node) / 2 for node, place in x.items()) - MARGIN
    total = max(place + width(node) / 2 for node, place in x.items()) + MARGIN - left
    n_floors = max(floor.values()) + 1
    height = n_floors * FLOOR_HEIGHT + 2 * MARGIN - (FLOOR_HEIGHT - ROOM_HEIGHT)
    top = {k: MARGIN + (n_floors - 1 - k) * FLOOR_HEIGHT for k in range(n_floors)}

    parts = [f'<rect class="paper" width="{total:.0f}" height="{height}" rx="12"/>']
    for k, y in top.items():
        pad = (FLOOR_HEIGHT - ROOM_HEIGHT) / 2
        if k % 2 == 0:
            parts.append(
                f'<rect class="floor" x="0" y="{max(0, y - pad):.0f}" width="{total:.0f}" '
                f'height="{min(y + ROOM_HEIGHT + pad, height) - max(0, y - pad):.0f}"/>'
            )
    # Arrows leave and reach a room side by side, in the order of where they come from and go to.
    ends: dict[tuple[str, str], list[int]] = defaultdict(list)
    for n, chain in enumerate(chains):
        ends[chain[0], "out"].append(n)
        ends[chain[-1], "in"].append(n)
    at: dict[tuple[int, str], float] = {}
    for (room, side), numbers in ends.items():
        numbers.sort(key=lambda n: x[chains[n][1] if side == "out" else chains[n][-2]])  # noqa: B023
        step = min(26.0, (ROOM_WIDTH - 40) / max(1, len(numbers) - 1))
        for k, n in enumerate(numbers):
            at[n, side] = x[room] - left + (k - (len(numbers) - 1) / 2) * step
    for n, chain in enumerate(chains):
        points = [(at[n, "out"], top[floor[chain[0]]] + ROOM_HEIGHT)]
        for node in chain[1:-1]:
            y = top[int(node.rsplit(">", 1)[1])]
            points += [(x[node] - left, y), (x[node] - left, y + ROOM_HEIGHT)]
        end = at[n, "in"], top[floor[chain[-1]]]
        points.append((end[0], end[1] - 6))
        parts.append(f'<path class="arrow" d="{arrow(points)}"><title>{chain[0]} imports {chain[-1]}</title></path>')
        parts.append(f'<path class="head" d="M{end[0]:.1f},{end[1] - 1} l-4.5,-8 h9 z"/>')
    for room, files in modules(package).items():
        x0, y0 = x[room] - left - ROOM_WIDTH / 2, top[floor[room]]
        is_file = " file" if len(files) == 1 and files[0].parent == package else ""
        imports = ", ".join(sorted(full[room])) or "nothing"
        parts.append(
            f'<g><title>{room} imports {imports}</title><rect class="room{is_file}" x="{x0:.1f}" y="{y0}" '
            f'width="{ROOM_WIDTH}" height="{ROOM_HEIGHT}" rx="9"/>'
            f'<text class="name" x="{x0 + 12:.1f}" y="{y0 + 22}">{room}</text>'
        )
        for k, line in enumerate(textwrap.wrap(summary(room, package), 30, max_lines=3, placeholder=" …")):
            parts.append(f'<text class="text" x="{x0 + 12:.1f}" y="{y0 + 38 + 14 * k}">{escape(line)}</text>')
        parts.append("</g>")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total:.0f} {height}" role="img" '
        f'aria-label="The folders of {package.name} and what they import">\n<style>{STYLE}</style>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--package", type=Path, default=ROOT / "mi_simplify")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "docs" / "architecture.svg")
    options = parser.parse_args()
    options.out.write_text(svg(options.package), encoding="utf-8")
