"""
The picture of README.md: asset and result of `make demo` side by side, surface and mesh.

    .venv/bin/python benchmarks/demo_picture.py out/demo
"""

import argparse
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

import mi_simplify as ms

ROOT = Path(__file__).resolve().parents[1]
SIDE, TOP = 400, 34
MARGIN = 45  # what the view has to spare around the asset


def main(folder: Path, target: Path, spp: int) -> None:
    """Render, draw, write."""
    ms.ensure_variant()
    from mi_simplify.judging.pictures import displayed
    from mi_simplify.report.portrait import portrait_view
    from mi_simplify.report.wireframe import wireframe

    config = ms.load_config(folder / "config.yaml")
    asset, model = ms.open_asset(config.asset), ms.load_asset(folder / "model.glb")
    views = portrait_view(asset.bounds, resolution=SIDE + 2 * MARGIN, azimuth=25.0)
    settings = {"transport": "baked", "spp": spp, "max_depth": 6, "sky": 0.15}
    images = [ms.make_reference(a, **settings).render(views) for a in (asset, model)]
    panels = [Image.fromarray(displayed(image)[0]) for image in images]
    panels.append(wireframe(model, views, panels[1]))
    panels = [panel.crop((MARGIN, MARGIN, MARGIN + SIDE, MARGIN + SIDE)) for panel in panels]
    names = [f"asset, {asset.n_triangles:,} triangles", f"result, {model.n_triangles:,} triangles", "its mesh"]
    sheet = Image.new("RGB", (SIDE * 3, SIDE + TOP))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(17)
    for k, (panel, name) in enumerate(zip(panels, names, strict=True)):
        sheet.paste(panel, (k * SIDE, TOP))
        draw.text((k * SIDE + 12, 9), name, (235, 235, 235), font)
    target.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(target, optimize=True)
    print(f"{target}: {target.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path, default=ROOT / "docs" / "images" / "demo.png")
    parser.add_argument("--spp", type=int, default=256)
    args = parser.parse_args()
    main(args.folder, args.picture, args.spp)
