"""
What the geometry of a result costs in a file, and how its atlas is used, before anything is fitted.

    .venv/bin/python benchmarks/files.py ../shared/assets/skull/skull.obj:1000 sample:relic:3000 --out out/files

vertices / positions: how often seams and creases split a position. Fill: share of the texture that charts cover. Gap:
least number of empty texels between two charts, measured on texel centres. L2 stretch: Sander et al. 2001, 1 is an
isometry. Overlap: texels of a four times finer texture that two triangles claim. OUT gets a picture of every atlas.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import mi_simplify as ms
from mi_simplify.config import InitialSettings
from mi_simplify.initial.creases import hard_edges
from mi_simplify.initial.guess import unwrapped
from mi_simplify.initial.reduce.reduced import reduced
from mi_simplify.initial.unwrap.atlas import texel_counts
from mi_simplify.initial.unwrap.charting import charts
from mi_simplify.model.mesh import Mesh
from mi_simplify.model.topology import area_vectors

HEADS = (
    "asset", "triangles", "positions", "vertices", "ratio", "the asset's own ratio", "charts", "triangles a chart",
    "fill", "gap", "L2 stretch", "overlap", "unwrap [s of CPU]",
)  # fmt: skip
FARTHEST = 8
"""Gaps are measured up to here [texels]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("assets", nargs="+", help="each with its budget: FILE:TRIANGLES")
    parser.add_argument("--size", type=int, default=1024, help="side of the atlas [texels]")
    parser.add_argument("--crease-angle", type=float, default=InitialSettings().crease_angle)
    parser.add_argument("--creases", choices=("all", "asset"), default=InitialSettings().creases)
    parser.add_argument("--split", type=float, default=InitialSettings().vertices_per_position)
    parser.add_argument("--out", type=Path, default=Path("out") / "files")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    print("| " + " | ".join(HEADS) + " |\n" + "|---" * len(HEADS) + "|")
    for named in args.assets:
        name, triangles = named.rsplit(":", 1)
        print("| " + " | ".join(row(name, int(triangles), args)) + " |", flush=True)


def row(name: str, triangles: int, args: argparse.Namespace) -> list[str]:
    """Cells of one asset; its atlas is drawn."""
    asset = ms.open_asset(name)
    settings = InitialSettings(
        triangles=triangles, atlas_size=args.size, crease_angle=args.crease_angle, creases=args.creases,
        vertices_per_position=args.split,
    )  # fmt: skip
    positions, faces, _ = reduced(asset, triangles)
    hard = hard_edges(asset, positions, faces) if args.creases == "asset" else None
    start = time.process_time()
    mesh, _ = unwrapped(positions, faces, settings, hard)
    seconds = time.process_time() - start
    chart, n_charts = charts(mesh)
    draw(mesh, chart, args.size).save(args.out / f"{Path(name.replace(':', '_')).stem}.png")
    parts = [asset.parts[k] for k in {i.part for i in asset.instances}]
    own = sum(len(p.vertices) for p in parts) / sum(len(np.unique(p.vertices, axis=0)) for p in parts)
    fill = np.abs(areas(mesh)).sum()
    overlap = int((texel_counts(mesh, 4 * args.size) > 1).sum())
    return [
        Path(name).name, f"{len(faces)}", f"{len(positions)}", f"{len(mesh.uvs)}",
        f"{len(mesh.uvs) / len(positions):.2f}", f"{own:.2f}", f"{n_charts}", f"{len(faces) / n_charts:.1f}",
        f"{fill:.3f}", gap(mesh, chart, n_charts, args.size), f"{stretch(mesh):.3f}", f"{overlap}", f"{seconds:.1f}",
    ]  # fmt: skip


def areas(mesh: Mesh) -> np.ndarray:
    """Signed area of every triangle in the texture, shape (F,)."""
    q = mesh.uvs[mesh.faces].astype(np.float64)
    a, b = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def gap(mesh: Mesh, chart: np.ndarray, n_charts: int, size: int) -> str:
    """Least number of empty texels between two charts."""
    label = np.full((size, size), -1)
    for k in range(n_charts):
        label[texel_counts(replace(mesh, faces=mesh.faces[chart == k]), size) > 0] = k
    steps = [(x, y) for x in range(-FARTHEST, FARTHEST + 1) for y in range(FARTHEST + 1) if (y, x) > (0, 0)]
    for x, y in sorted(steps, key=lambda step: np.hypot(*step)):
        a, b = label[y:, max(x, 0) : size + min(x, 0)], label[: size - y, max(-x, 0) : size - max(x, 0)]
        if ((a != b) & (a >= 0) & (b >= 0)).any():
            return f"{np.hypot(x, y) - 1:.1f}"
    return f"over {FARTHEST - 1}"


def stretch(mesh: Mesh) -> float:
    """L2 stretch of the whole layout; triangles without area are left out."""
    p, q = mesh.positions[mesh.position_faces], mesh.uvs[mesh.faces].astype(np.float64)
    d, e = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    flat = areas(mesh) * 2
    area = np.linalg.norm(area_vectors(p), axis=1) / 2
    kept = (np.abs(flat) > 1e-9) & (area > 1e-7 * area.sum())
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    det = np.where(kept, flat, 1)[:, None]
    along = ((a * e[:, 1:] - b * d[:, 1:]) / det, (b * d[:, :1] - a * e[:, :1]) / det)  # ∂p/∂u, ∂p/∂v
    square = sum((x**2).sum(1) for x in along) / 2
    total = area[kept].sum()
    return float(np.sqrt((area * square)[kept].sum() / total * (np.abs(flat[kept]).sum() / 2) / total))


def draw(mesh: Mesh, chart: np.ndarray, size: int) -> Image.Image:
    """Charts in colours, with their triangles."""
    image = Image.new("RGB", (size, size), (30, 30, 30))
    pen = ImageDraw.Draw(image)
    colors = np.random.default_rng(0).integers(80, 255, (int(chart.max()) + 1, 3))
    for corners, k in zip(mesh.uvs[mesh.faces] * size, chart, strict=True):
        pen.polygon([tuple(x) for x in corners.tolist()], fill=tuple(colors[k].tolist()), outline=(0, 0, 0))
    return image


if __name__ == "__main__":
    main()
