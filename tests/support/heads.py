"""A tiny morphable head, and portraits of it, as files."""

import json
from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from mi_simplify.config.commands.face import FaceSettings
from mi_simplify.integrators.camera import Cameras
from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.jobs.faces.morphable import open_morphable
from mi_simplify.latent.environment import looked_up
from mi_simplify.latent.latent import Latent
from mi_simplify.model.light.harmonics import constant_environment
from mi_simplify.scenes.views import Views

SIZE, FOCAL = (48, 64), 90.0

#: Weights of the two modes of identity and the expression.
WEIGHTS = np.array([0.8, -0.6, 0.5])


def morphable(path: Path) -> Path:
    """A ball of radius 10 that becomes broad, long, and makes a beak; landmarks are on its front."""
    rows, columns = 12, 16
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.arange(columns) / columns, indexing="ij")
    polar, around = 0.05 + (np.pi - 0.1) * v, 2 * np.pi * u
    p = np.stack([np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], -1).reshape(-1, 3)
    index = np.arange(rows)[:, None] * columns + np.arange(columns)
    right = np.arange(rows)[:, None] * columns + (np.arange(columns) + 1) % columns
    quads = np.stack([index, index + columns, right + columns, right], -1).reshape(-1, 4)
    beak = np.exp(-np.square(p - [0, 0, 1]).sum(1) / 0.1)[:, None] * [0, 0, 4.0]
    offsets = np.stack([p * [2.0, 0, 0], p * [0, 3.0, 0], beak])
    front = np.flatnonzero(p[:, 2] > 0.3)
    uvs = np.stack([u.ravel(), 1 - v.ravel()], 1)
    np.savez(
        path, neutral=10 * p, quads=quads, uvs=uvs, uv_quads=quads, identity=offsets[:2], expression=offsets[2:],
        expression_names=np.array(["beak"]), landmarks=front[::2],
    )  # fmt: skip
    return path


def portraits(folder: Path, depth: bool = True) -> Path:
    """``face.yaml`` in a folder with the head and three images of it that know where it is seen from."""
    model = str(morphable(folder / "head.npz"))
    whole, marks, _ = open_morphable(FaceSettings(model=model, portraits="x", texture_size=32))
    head = whole.moved_to(WEIGHTS)
    rng = np.random.default_rng(0)
    base = np.ones((32, 32, 4), np.float32)
    base[..., :3] = np.kron(rng.uniform(0.3, 0.7, (8, 8, 3)), np.ones((4, 4, 1)))
    turns = Rotation.from_euler("yx", [[0, 0], [30, 5], [-30, -5]], degrees=True).as_matrix()
    rotations, translation = np.diag([1.0, -1, -1]) @ turns, np.array([0.5, -0.3, 45.0])
    arrays = {
        "right": rotations[:, 0], "up": -rotations[:, 1], "forward": rotations[:, 2],
        "origin": -np.einsum("bij,i->bj", rotations, translation), "frame": np.zeros(3),
        "tan_x": np.full(3, SIZE[0] / 2 / FOCAL), "light_position": np.zeros((3, 3)),
        "light_intensity": np.zeros((3, 3)),
    }  # fmt: skip
    views = Views.from_arrays(arrays, *SIZE)
    images, depths = _seen(Latent(replace(head, base_color=base)), views)
    frames = []
    for k in range(3):
        local = head.mesh.positions[marks] @ rotations[k].T + translation
        at = FOCAL * local[:, :2] / local[:, 2:] + np.array(SIZE) / 2
        mi.Bitmap(images[k]).write(str(folder / f"{k}.exr"))
        frame = {"file_path": f"{k}.exr", "landmarks": at.tolist()}
        if depth:
            mi.Bitmap(depths[k][..., None]).write(str(folder / f"{k}-depth.exr"))
            frame["depth_path"] = f"{k}-depth.exr"
        frames.append(frame)
    document = {"fl_x": FOCAL, "w": SIZE[0], "h": SIZE[1], "frames": frames}
    (folder / "portraits.json").write_text(json.dumps(document))
    (folder / "face.yaml").write_text(
        "model: head.npz\nportraits: portraits.json\nsteps: 40\nresolution: 64\ntexture_size: 32\n"
        "rates: {base_color: 0.05}\n"
    )
    return folder / "face.yaml"


def _seen(latent: Latent, views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Images under a grey environment, and depth."""
    renderer = DeferredRenderer(latent.topology)
    positions = mi.Float(latent.operation.base.positions.astype(np.float32).ravel())
    renderer.move(positions)
    with dr.suspend_grad():
        lit = views.under(looked_up(constant_environment((0.8, 0.8, 0.8))))
        surface = latent.evaluate(positions)
        images = renderer.render(surface, latent.textures, lit, spp=16, seed=dr.opaque(mi.UInt32, 3)).images()
    cameras, n = Cameras.of(views), views.width * views.height
    pixel = dr.arange(mi.UInt32, 3 * n)
    view, place = pixel // n, pixel % n
    x, y = mi.Float(place % views.width) + 0.5, mi.Float(place // views.width) + 0.5
    origin, direction = cameras.ray(view, x, y)
    hit = renderer.tracer.scene.ray_intersect_preliminary(mi.Ray3f(origin, direction))
    z = dr.select(hit.is_valid(), hit.t * dr.dot(direction, cameras.fetch(view, 3).xyz), 0)
    return images, z.numpy().reshape(3, views.height, views.width)
