"""
Environment map and roughness together (Takimoto et al. 2022, supplement, Sect. 2.1): fixed views of a known shape and
base colour, a grey map and a roughness of 0.5 to begin with, one for the whole surface or a texture (`--texels`).

    .venv/bin/python benchmarks/dressi_light.py --sky ../shared/assets/envmap/StinsonBeach.hdr --spot ../shared/assets/spot/spot.obj
    .venv/bin/python benchmarks/dressi_light.py --shapes torus --roughness .2 --transport path

Targets are rendered by Mitsuba: its BSDF is sampled at every sample of a pixel and the map looked up there, at eight
times its resolution, without shadows as in the fit; `--transport path` has shadows and light from surface to surface.
Figures: mean and mean absolute error of roughness over the surface, PSNR of the map (its largest value is 1), and that
of the grey start.
"""  # noqa: E501

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mi_simplify as ms  # before the others, for its LLVM

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image

from mi_simplify.formats.gltf.write import write_glb
from mi_simplify.integrators.camera import Cameras
from mi_simplify.latent.file_model import file_model
from mi_simplify.machine.runtime import ensure_variant
from mi_simplify.model.asset import Asset, Instance, Material, Part
from mi_simplify.model.color import linear_to_srgb
from mi_simplify.model.light.environment_map import environment_map, resized
from mi_simplify.scenes.samples.parametric import surface
from mi_simplify.scenes.shapes import asset_shapes
from mi_simplify.scenes.views import Views, look_at

GOLD = (0.9, 0.7, 0.45)


def torus(material: Material) -> Part:
    """A ring with a round cross-section."""

    def position(u, v):
        a, b = 2 * np.pi * u, 2 * np.pi * v
        r = 0.7 + 0.3 * np.cos(b)
        return np.stack([r * np.cos(a), 0.3 * np.sin(b), r * np.sin(a)], -1)

    return surface("torus", position, (96, 48), material, closed=(True, True))


def knot(material: Material) -> Part:
    """A trefoil: genus 1, much of it in front of itself."""

    def centre(t):
        return np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], -1) / 3

    def position(u, v):
        a, b = 2 * np.pi * u, -2 * np.pi * v
        along = centre(a + 1e-3) - centre(a - 1e-3)
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        out = centre(a) * [1, 1, 0]
        side = out - along * (out * along).sum(-1, keepdims=True)
        side /= np.linalg.norm(side, axis=-1, keepdims=True)
        across = np.cross(along, side)
        return centre(a) + 0.22 * (side * np.cos(b)[..., None] + across * np.sin(b)[..., None])

    return surface("knot", position, (192, 24), material, closed=(True, True))


def windows(rows: int) -> np.ndarray:
    """A room at daylight: dark walls, three windows, a pale ceiling lamp, a brown floor; shape (rows, 2·rows, 3)."""
    v, u = np.meshgrid(
        (np.arange(8 * rows) + 0.5) / (8 * rows), (np.arange(16 * rows) + 0.5) / (16 * rows), indexing="ij"
    )
    sky = np.zeros((*u.shape, 3)) + [0.12, 0.11, 0.1]
    sky[v > 0.65] = [0.16, 0.1, 0.06]
    for left, width in ((0.1, 0.12), (0.32, 0.16), (0.7, 0.1)):
        sky[(abs(v - 0.42) < 0.12) & (u > left) & (u < left + width)] = [0.75, 0.9, 1.0]
        sky[(abs(v - 0.42) < 0.12) & (abs(u - left - width / 2) < 0.006)] = 0.1
    sky[(v < 0.12) & (abs(u - 0.6) < 0.2)] = [1.0, 0.85, 0.6]
    return resized(sky, rows)


def beach(path: Path, rows: int) -> np.ndarray:
    """A panorama from a file, twice as bright and clamped at 1."""
    ensure_variant(None)
    bitmap = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    return resized(np.minimum(2 * np.array(bitmap), 1), rows)


def enlarged(sky: np.ndarray, factor: int = 8) -> np.ndarray:
    """Bilinear between texel centres, for Mitsuba, whose first and last rows are the poles."""
    height, width = sky.shape[:2]
    y = np.linspace(0, height, factor * height) - 0.5
    x = (np.arange(factor * width) + 0.5) / factor - 0.5
    row, column = np.floor(y).astype(int), np.floor(x).astype(int)
    fy, fx = (y - row)[:, None, None], (x - column)[None, :, None]
    above, below = (sky[np.clip(r, 0, height - 1)] for r in (row, row + 1))
    rows = above * (1 - fy) + below * fy
    return (rows[:, column % width] * (1 - fx) + rows[:, (column + 1) % width] * fx).astype(np.float32)


def target(asset: Asset, sky: np.ndarray, transport: str, spp: int) -> Callable[[Views], np.ndarray]:
    """What renders views of an asset under a map, by Mitsuba."""
    scene = mi.load_dict({"type": "scene", **dict(asset_shapes(asset)), "sky": _envmap(sky)})
    (emitter,) = scene.emitters()
    path = mi.load_dict({"type": "path", "max_depth": 6, "hide_emitters": True})

    def render(views: Views) -> np.ndarray:
        cameras, n_pixels = Cameras.of(views), views.width * views.height
        out = []
        for k in range(len(views)):
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(k, n_pixels * spp)
            pixel = dr.arange(mi.UInt32, n_pixels * spp) // spp
            offset = sampler.next_2d()
            x, y = mi.Float(pixel % views.width) + offset.x, mi.Float(pixel // views.width) + offset.y
            origin, direction = cameras.ray(mi.UInt32(k), x, y)
            ray = mi.RayDifferential3f(origin, direction)
            si = scene.ray_intersect(ray)
            if transport == "path":
                radiance = path.sample(scene, sampler, ray)[0]
            else:
                sample, weight = si.bsdf().sample(
                    mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), si.is_valid()
                )
                away = dr.zeros(mi.SurfaceInteraction3f, dr.width(x))
                away.wi = -si.to_world(sample.wo)
                radiance = weight * emitter.eval(away)
            radiance = dr.select(si.is_valid(), mi.Color3f(radiance), 0)
            value = np.stack(
                [*(np.array(c) for c in radiance), np.array(mi.Float(dr.select(si.is_valid(), 1.0, 0.0)))], 1
            )
            out.append(value.reshape(views.height, views.width, spp, 4).mean(2))
        return np.stack(out).astype(np.float32)

    return render


def _envmap(sky: np.ndarray) -> dict:
    return {"type": "envmap", "bitmap": mi.Bitmap(enlarged(sky))}


def around(n: int, side: int) -> Views:
    """Cameras on a sphere, evenly spread; no light but the map."""
    k = np.arange(n) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / n), np.pi * (1 + 5**0.5) * k
    d = np.stack([np.cos(azimuth) * np.sin(polar), np.cos(polar), np.sin(azimuth) * np.sin(polar)], axis=1)
    return look_at(3.2 * d, (0, 0, 0), 3.2 * d, width=side, height=side, fov=45, irradiance=0)


def material(roughness: float, metallic: float) -> Material:
    color = np.float32([[[*GOLD, 1]]])
    return Material(base_color=color, specular=np.float32([[[0, roughness, metallic]]]), name="surface")


def on_surface(part: Part, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of an image at the middles of the faces, and their areas."""
    corners = part.vertices[part.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert part.uvs is not None
    uv = part.uvs[part.faces].mean(1) % 1
    height, width = image.shape[:2]
    return image[(uv[:, 1] * height).astype(int), (uv[:, 0] * width).astype(int)], area


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Of maps up to 1, every direction alike [dB]."""
    weight = np.sin(np.pi * (np.arange(len(a)) + 0.5) / len(a))[:, None, None]
    return float(-10 * np.log10((np.square(a - b) * weight).sum() / (weight.sum() * a.shape[1] * 3)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", default="torus,knot", help="of torus, knot")
    parser.add_argument("--spot", type=Path, help="a model file with texture coordinates, as a further shape")
    parser.add_argument("--sky", type=Path, help="an HDR image, besides the room with windows")
    parser.add_argument("--materials", default="metal,dielectric")
    parser.add_argument("--roughness", default="0.1,0.3")
    parser.add_argument("--transport", choices=("direct", "path"), default="direct")
    parser.add_argument("--rows", type=int, default=32)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--side", type=int, default=96)
    parser.add_argument("--texels", type=int, default=1, help="side of the roughness texture")
    parser.add_argument("--spp", type=int, default=64, help="of the targets")
    parser.add_argument("--rates", default="0.03,0.03", help="of the map and of roughness")
    parser.add_argument("--out", type=Path, default=Path("out/dressi_light"))
    parser.add_argument("--set", nargs="*", default=[], dest="overrides")
    options = parser.parse_args()
    ensure_variant(None)
    options.out.mkdir(parents=True, exist_ok=True)
    skies = {"windows": windows(options.rows)}
    if options.sky:
        skies["beach"] = beach(options.sky, options.rows)
    makers: dict[str, Callable[[Material], Part]] = {"torus": torus, "knot": knot}
    shapes = {name: makers[name] for name in options.shapes.split(",") if name}
    if options.spot:
        (found,) = ms.load_asset(options.spot).placed()
        shapes["spot"] = lambda m: replace(found, material=m)
    print("| shape | material | sky | roughness | found, mean | mean error | map [dB] | grey [dB] |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for kind in options.materials.split(","):
        for name, shape in shapes.items():
            for title, sky in skies.items():
                for roughness in map(float, options.roughness.split(",")):
                    case = f"{name}-{kind}-{title}-{roughness:g}"
                    row = fitted(shape, kind == "metal", sky, roughness, case, options)
                    print(f"| {name} | {kind} | {title} | {roughness:g} | {row} |", flush=True)


def fitted(shape, is_metal: bool, sky: np.ndarray, roughness: float, case: str, options) -> str:
    """One case: its figures as cells of a table, with maps and images in the folder."""
    parts = {r: shape(material(r, float(is_metal))) for r in (roughness, 0.5)}
    true, start = (Asset((part,), (Instance(0, name="shape"),), name="shape") for part in parts.values())
    file = options.out / f"{case}.glb"
    write_glb(file_model(start, ["roughness"], texture_size=options.texels).model, file)
    views = around(options.views, options.side)
    settings = [
        "latent.ambient.kind=environment", f"latent.ambient.rows={options.rows}", "loss.image=l2",
        "evaluation.views=4", "latent.min_roughness=0.03", "optimizer.shade=sample", *options.overrides,
    ]  # fmt: skip
    opt = ms.Optimization(
        file, targets=target(true, sky, options.transport, options.spp), views=views, steps=options.steps,
        resolution=options.side, batch=min(4, options.views), texture_size=options.texels, overrides=settings,
    )  # fmt: skip
    rates = [float(rate) for rate in options.rates.split(",")]
    opt.requires_grad(environment=rates[0], roughness=rates[1])
    for _ in range(options.steps):
        opt.step()
    model = opt.model()
    assert model.ambient is not None
    found = environment_map(model.ambient)
    opt.save_environment(options.out / f"{case}.exr")
    values, area = on_surface(ms.load_asset(file).placed()[0], model.specular[..., 1])
    error = np.average(np.abs(values - roughness), weights=area)
    _pictures(options.out / f"{case}.png", sky, found)
    grey = np.full_like(sky, 1) * sky.mean((0, 1))
    mean = np.average(values, weights=area)
    return f"{mean:.3f} | {error:.3f} | {psnr(sky, found):.1f} | {psnr(sky, grey):.1f}"


def _pictures(path: Path, *maps: np.ndarray) -> None:
    """Maps one below the other, four times as large."""
    shown = [np.kron(linear_to_srgb(np.clip(image, 0, 1)), np.ones((4, 4, 1))) for image in maps]
    Image.fromarray((np.concatenate(shown) * 255 + 0.5).astype(np.uint8)).save(path)


if __name__ == "__main__":
    main()
