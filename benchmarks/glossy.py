"""
Complex materials (the paper's Fig. 5): an asset made glossy and partly metal, ray-cast bake against fit.

    .venv/bin/python benchmarks/glossy.py --asset ../shared/assets/bishop/bishop.glb --triangles 1500
    .venv/bin/python benchmarks/glossy.py --asset sample:relic --triangles 3000

Roughness is squeezed into [0.2, 0.6], and what is darker than the middle of the base colour becomes metal. Both are
judged by path tracing under light that no fit saw; the picture shows reference, bake and fit.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

import mi_simplify as ms
from mi_simplify.judging.evaluate import Judging, compare_assets
from mi_simplify.judging.pictures import displayed
from mi_simplify.model.asset import Asset, Material

ROOT = Path(__file__).resolve().parents[1]


def glossy(asset: Asset) -> Asset:
    """
    The asset with roughness between 0.2 and 0.6 and metal where its base colour is dark.
    """
    middle = np.median(np.concatenate([_luminance(p.material).ravel()[::97] for p in asset.parts]))

    def changed(material: Material) -> Material:
        size = np.maximum(material.base_color.shape[:2], material.specular.shape[:2])
        color, specular = (_enlarged(x, size) for x in (material.base_color, material.specular))
        dark = gaussian_filter((color[..., :3].mean(2) < middle).astype(np.float32), max(size) / 300)
        metal = np.clip(4 * dark - 1.5, 0, 1)
        images = [specular[..., 0], 0.2 + 0.4 * specular[..., 1], metal]
        bright = color * np.array([1, 1, 1, 1], np.float32)
        bright[..., :3] += metal[..., None] * (0.5 - bright[..., :3]) * 0.8  # black metal shows nothing
        return replace(material, base_color=bright, specular=np.stack(images, axis=2).astype(np.float32))

    return replace(asset, parts=tuple(replace(p, material=changed(p.material)) for p in asset.parts))


def _luminance(material: Material) -> np.ndarray:
    return material.base_color[..., :3].mean(2)


def _enlarged(image: np.ndarray, size: np.ndarray) -> np.ndarray:
    rows, columns = (np.arange(n) * m // n for n, m in zip(size, image.shape[:2], strict=True))
    return image[rows][:, columns].astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asset", required=True)
    parser.add_argument("--triangles", type=int, required=True)
    parser.add_argument("--picture", type=Path, default=None, help="JPEG, by default docs/images/glossy-ASSET.jpg")
    parser.add_argument("--views", type=int, default=16, help="held-out views")
    parser.add_argument("--spp", type=int, default=128, help="of the verdict")
    parser.add_argument("--set", nargs="*", default=[], help="settings, as on the command line")
    args = parser.parse_args()
    ms.ensure_variant()
    asset = glossy(ms.open_asset(args.asset))
    frame = ms.Frame.around(asset.bounds)
    target = frame.normalised(asset)
    overrides = [f"asset={args.asset}", f"initial.triangles={args.triangles}", *args.set]
    config = ms.load_config(overrides=overrides)
    guess, _ = ms.first_guess(target, config.initial)
    fitted = ms.fit(guess, ms.make_reference(target, transport="direct", spp=config.reference.spp), config)
    candidates = {"bake": guess.as_asset(), "fit": fitted.model.as_asset()}
    judging = Judging(args.views, config.evaluation.resolution, args.spp)
    comparison = compare_assets(target, candidates, judging)
    print("| model | PSNR [dB] | FLIP | silhouette error |\n|---|---|---|---|")
    for name, row in comparison.figures["candidates"].items():
        print(f"| {name} | {row['psnr']:.2f} | {row['flip']:.4f} | {row['silhouette_error']:.4f} |")
    rows = [comparison.reference, *comparison.candidates.values()]
    sheet = np.concatenate([np.concatenate(list(displayed(images[:4])), axis=1) for images in rows])
    name = args.asset.removeprefix("sample:").rpartition("/")[2].partition(".")[0]
    Image.fromarray(sheet).save(args.picture or ROOT / "docs" / "images" / f"glossy-{name}.jpg", quality=80)


if __name__ == "__main__":
    main()
