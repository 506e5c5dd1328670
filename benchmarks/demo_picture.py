"""
The picture of README.md: asset and result of `make demo` side by side, surface and mesh.

    .venv/bin/python benchmarks/demo_picture.py out/demo
"""

import argparse
from pathlib import Path

import numpy as np
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

    config = ms.load_config(folder / "config.yaml")
    asset, model = ms.open_asset(config.asset), ms.load_asset(folder / "model.glb")
    views = portrait_view(asset.bounds, resolution=SIDE + 2 * MARGIN, azimuth=25.0)
    settings = {"transport": "baked", "spp": spp, "max_depth": 6, "sky": 0.15}
    images = [ms.make_reference(a, **settings).render(views) for a in (asset, model)]
    panels = [Image.fromarray(displayed(image)[0]) for image in images]
    panels.append(wireframe(model, views.arrays(), panels[1]))
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


def wireframe(asset, view: dict, background: Image.Image) -> Image.Image:
    """The edges of faces that face the camera, over a dimmed picture."""
    out = Image.blend(background, Image.new("RGB", background.size), 0.75)
    draw = ImageDraw.Draw(out)
    origin, right, up, forward = (view[name][0] for name in ("origin", "right", "up", "forward"))
    for part in asset.placed():
        d = part.vertices - origin
        x, y = d @ right, d @ up
        half = background.width / 2
        scale = half / (d @ forward * view["tan_x"][0])
        points = np.stack([half + x * scale, half - y * scale], 1)
        corners = part.vertices[part.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        seen = np.einsum("fc,fc->f", normal, origin - corners[:, 0]) > 0
        for face in part.faces[seen]:
            draw.line([tuple(points[k]) for k in (*face, face[0])], (120, 200, 220))
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path, default=ROOT / "docs" / "images" / "demo.png")
    parser.add_argument("--spp", type=int, default=256)
    args = parser.parse_args()
    main(args.folder, args.picture, args.spp)
