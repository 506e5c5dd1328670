"""
A morphable face from portraits (Takimoto et al. 2022, supplement, Sect. 2.3), with and without depth maps.

    .venv/bin/python benchmarks/dressi_face.py ../shared/assets/face/ict_face.npz
    .venv/bin/python benchmarks/dressi_face.py ../shared/assets/face/ict_face.npz --subjects 1 --set steps=100

Synthetic subjects have random weights of identity and expression and random textures, and are path traced under a
point light and a dim sky, from four cameras that the fit does not know, landmarks off by a pixel.
Figures: mean distance of vertices after rigid alignment, by the head's height [%], of the mean face and of landmarks
alone (both at the best scale, which they cannot know), of landmarks with their depth, of the fit without depth (at the
best scale) and with it; PSNR of both fits on a fifth view.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import mi_simplify as ms  # before the others, for its LLVM

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from mi_simplify.config.commands.face import FaceSettings
from mi_simplify.config.problems import validated
from mi_simplify.fitting.face.landmarks import aligned, fit_landmarks
from mi_simplify.formats.textures import png, to_8bit
from mi_simplify.integrators.camera import Cameras
from mi_simplify.jobs.faces.job import FaceFound, find_face
from mi_simplify.jobs.faces.morphable import open_morphable
from mi_simplify.judging.metrics import psnr
from mi_simplify.judging.pictures import displayed
from mi_simplify.latent.morphing import MorphedModel
from mi_simplify.model.color import linear_to_srgb
from mi_simplify.scenes.shapes import asset_shapes
from mi_simplify.scenes.views import Views

KINDS = ("mean face", "landmarks", "landmarks with depth", "fit", "fit with depth")

#: Focal length by the image's height, and turns of the head [degrees]: four that are seen, and a fifth.
FOCAL = 900 / 640
TURNS = [[0, 0, 0], [0, 35, 0], [0, -35, 0], [20, 0, 0], [8, 15, 0]]


def poses(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (5, 3, 3) and translations (5, 3) into the frames of the cameras."""
    angles = np.radians(np.array(TURNS) + rng.normal(size=(5, 3)) * 4)
    rotations = Rotation.from_euler("zyx", angles[:, ::-1]).as_matrix()
    return np.diag([1.0, -1.0, -1.0]) @ rotations, np.array([0, 0, 65]) + rng.normal(size=(5, 3)) * [1, 1, 3]


def cameras(rotations: np.ndarray, translations: np.ndarray, size: tuple[int, int]) -> Views:
    """The same as views without a light."""
    n, (width, height) = len(rotations), size
    arrays = {
        "right": rotations[:, 0], "up": -rotations[:, 1], "forward": rotations[:, 2],
        "origin": -np.einsum("bij,bi->bj", rotations, translations), "frame": np.zeros(n),
        "tan_x": np.full(n, width / 2 / (FOCAL * height)), "light_position": np.zeros((n, 3)),
        "light_intensity": np.zeros((n, 3)),
    }  # fmt: skip
    return Views.from_arrays({name: np.float32(value) for name, value in arrays.items()}, width, height)


def textured(model: MorphedModel, rng: np.random.Generator) -> MorphedModel:
    """The model with skin that nobody has: tone, blotches, freckles, gloss."""
    height, width = model.base_color.shape[:2]

    def smooth(sigma: float) -> np.ndarray:
        noise = gaussian_filter(rng.normal(size=(height, width)), sigma * height, mode="wrap")
        return noise / max(float(np.abs(noise).max()), 1e-9)

    tone = rng.uniform([0.45, 0.25, 0.18], [0.65, 0.45, 0.35])
    color = tone * (1 + 0.2 * smooth(0.08)[..., None] + 0.15 * np.stack([smooth(0.02) for _ in range(3)], 2))
    color *= 1 - 0.5 * (smooth(0.006) > 0.6)[..., None]
    specular = np.zeros((height, width, 3))
    specular[..., 1] = 0.5 + 0.12 * smooth(0.05)
    textures = {
        "base_color": np.concatenate([np.clip(color, 0, 1), np.ones((height, width, 1))], 2).astype(np.float32),
        "specular": specular.astype(np.float32),
    }
    return MorphedModel(model.mesh, normal=model.normal, name="subject", morphs=model.morphs, **textures)


def photographed(model: MorphedModel, views: Views, spp: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Path traced images (B, H, W, 4) under a light that nobody knows, and depth (B, H, W), NaN beside the head."""
    light = [*(rng.uniform([-40, 10, 40], [40, 60, 70])), 1]
    scene = mi.load_dict({
        "type": "scene", **dict(asset_shapes(model.as_asset())), "sky": {"type": "constant", "radiance": 0.5},
        "lamp": {"type": "point", "position": light[:3], "intensity": {"type": "rgb", "value": [3000, 2800, 2500]}},
    })  # fmt: skip
    path = mi.load_dict({"type": "path", "max_depth": 5, "hide_emitters": True})
    seen, n_pixels = Cameras.of(views), views.width * views.height
    images, depths = [], []
    for k in range(len(views)):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(k, n_pixels * spp)
        pixel, offset = dr.arange(mi.UInt32, n_pixels * spp) // spp, sampler.next_2d()
        column, row = mi.Float(pixel % views.width), mi.Float(pixel // views.width)
        ray = mi.RayDifferential3f(*seen.ray(mi.UInt32(k), column + offset.x, row + offset.y))
        radiance = mi.Color3f(path.sample(scene, sampler, ray)[0])
        hit = scene.ray_intersect_preliminary(ray).is_valid()
        value = [np.array(c) for c in dr.select(hit, radiance, 0)] + [np.array(mi.Float(dr.select(hit, 1.0, 0.0)))]
        images.append(np.stack(value, 1).reshape(views.height, views.width, spp, 4).mean(2))
        pixel = dr.arange(mi.UInt32, n_pixels)
        x, y = mi.Float(pixel % views.width) + 0.5, mi.Float(pixel // views.width) + 0.5
        origin, direction = seen.ray(mi.UInt32(k), x, y)
        found = scene.ray_intersect_preliminary(mi.Ray3f(origin, direction))
        z = found.t * dr.dot(direction, seen.fetch(mi.UInt32(k), 3).xyz)
        depths.append(np.array(dr.select(found.is_valid(), z, dr.nan)).reshape(views.height, views.width))
    return np.float32(images), np.float32(depths)


def written(folder: Path, images: np.ndarray, depths: np.ndarray, marks: np.ndarray) -> Path:
    """Portraits as files: 8-bit PNG with alpha, depth as EXR."""
    folder.mkdir(parents=True, exist_ok=True)
    height, width = images.shape[1:3]
    frames = []
    for k, (image, depth) in enumerate(zip(images, depths, strict=True)):
        straight = image[..., :3] / np.maximum(image[..., 3:], 1e-4)
        rgba = np.concatenate([linear_to_srgb(np.clip(straight, 0, 1)), image[..., 3:]], 2)
        (folder / f"{k}.png").write_bytes(png(to_8bit(rgba)))
        mi.Bitmap(np.nan_to_num(depth)[..., None]).write(str(folder / f"{k}.exr"))
        frames.append({"file_path": f"{k}.png", "depth_path": f"{k}.exr", "landmarks": marks[k].tolist()})
    head = {"fl_x": FOCAL * height, "w": width, "h": height, "frames": frames}
    (folder / "portraits.json").write_text(json.dumps(head))
    return folder / "portraits.json"


def fifth(found: FaceFound, true: np.ndarray, pose: tuple[np.ndarray, np.ndarray], size, with_scale: bool):
    """What the fit shows to a true camera: that is moved as the fitted vertices are away from the true ones."""
    own = found.model.mesh.positions
    moved = aligned(own, true, with_scale=with_scale)
    matrix = np.linalg.lstsq(np.column_stack([own, np.ones(len(own))]), moved, rcond=None)[0].T  # (3, 4)
    # Camera coordinates are R (A p + b) + t, divided by the scale of A and by the unit of the fit's frame.
    scale = np.cbrt(np.linalg.det(matrix[:, :3]))
    rotation = pose[0] @ matrix[:, :3] / scale
    translation = (pose[0] @ matrix[:, 3] + pose[1]) / scale + rotation @ found.center
    return found.fit.render(cameras(rotation[None], translation[None] / found.unit, size), 64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("face", type=Path, help="ict_face.npz")
    parser.add_argument("--subjects", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--height", type=int, default=640, help="of the images, which are 3/4 as wide [pixels]")
    parser.add_argument("--noise", type=float, default=1.0, help="of landmarks [pixels]")
    parser.add_argument("--spp", type=int, default=32, help="of the path tracer")
    parser.add_argument("--depths", default="01", help="of the fits without (0) and with (1) depth maps")
    parser.add_argument("--out", type=Path, default=Path("out/dressi_face"))
    parser.add_argument("--set", nargs="*", default=[], dest="overrides", metavar="KEY=VALUE")
    options = parser.parse_args()
    ms.ensure_variant()
    given: dict = {}
    for text in options.overrides:
        *sections, key = text.partition("=")[0].split(".")
        target = given.setdefault(sections[0], {}) if sections else given
        target[key] = json.loads(text.partition("=")[2])
    size, rows = (options.height * 3 // 4, options.height), []
    for seed in range(options.first, options.first + options.subjects):
        rng = np.random.default_rng(seed)
        wanted = {"model": str(options.face), "portraits": str(options.out / f"{seed}" / "portraits.json"), **given}
        settings = validated(FaceSettings, wanted)
        whole, marks, _ = open_morphable(settings.model_copy(update={"identity": 100_000, "texture_size": 256}))
        assert whole.morphs is not None
        names, offsets = whole.morphs.names, whole.morphs.offsets
        who = np.array([name.startswith("identity ") for name in names])
        mild = rng.uniform(0, 0.6, len(names)) * (rng.random(len(names)) < 0.1)
        subject = textured(whole.moved_to(np.where(who, rng.normal(size=len(names)), mild)), rng)
        true, neutral = subject.mesh.positions, whole.mesh.positions
        rotations, translations = poses(rng)
        images, depths = photographed(subject, cameras(rotations, translations, size), options.spp, rng)
        local = np.einsum("bij,lj->bli", rotations, true[marks]) + translations[:, None]
        seen = FOCAL * size[1] * local[..., :2] / local[..., 2:] + np.array(size) / 2
        seen = np.clip(seen + options.noise * rng.normal(size=seen.shape), 0, size)
        written(options.out / f"{seed}", images[:4], depths[:4], seen[:4])

        height, fitted = np.ptp(neutral[:, 1]), offsets[:30]
        fitted = np.concatenate([offsets[who][:30], offsets[~who]])
        shapes = [(neutral, True)]
        for known in (None, local[:4, :, 2]):
            at = fit_landmarks(neutral[marks], fitted[:, marks], seen[:4], FOCAL * size[1], size, depth=known)
            shapes.append((at.scale * (neutral + np.tensordot(at.weights, fitted, axes=1)), known is None))
        quality, pictures = {}, [images[4:]]
        for depth in (False, True):
            if str(int(depth)) not in options.depths:
                shapes.append((neutral, True))
                continue
            found = find_face(settings.model_copy(update={"depth": depth}))
            shapes.append((found.model.mesh.positions, not depth))
            pictures.append(fifth(found, true, (rotations[4], translations[4]), size, not depth))
            quality[KINDS[3 + depth]] = psnr(pictures[0], pictures[-1])[0]
        errors = [
            100 * np.linalg.norm(aligned(x, true, with_scale=s) - true, axis=1).mean() / height for x, s in shapes
        ]
        rows.append([*errors, *quality.values()])
        shown = np.concatenate([displayed(x)[0] for x in pictures], axis=1)
        Image.fromarray(shown).save(options.out / f"{seed}.png")
        print(f"subject {seed}: " + _line(rows[-1], quality), flush=True)
    print(f"mean of {len(rows)}: " + _line(np.mean(rows, 0), quality))


def _line(row, quality: dict) -> str:
    errors = ", ".join(f"{name} {x:.2f} %" for name, x in zip(KINDS, row, strict=False))
    return errors + "".join(f"; {name} {x:.1f} dB" for name, x in zip(quality, row[len(KINDS) :], strict=True))


if __name__ == "__main__":
    main()
