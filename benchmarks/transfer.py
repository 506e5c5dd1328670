"""
Figures of precomputed transfer, one table a command:

    .venv/bin/python benchmarks/transfer.py projection           closed forms, quadrature, a path tracer
    .venv/bin/python benchmarks/transfer.py casting              rays a second, beside Mitsuba's own `ray_intersect`
    .venv/bin/python benchmarks/transfer.py images SOURCE...     folds, stretch and distance of geometry images
    .venv/bin/python benchmarks/transfer.py network FOLDER...    of `mi-simplify transfer run`: errors, bytes, times
    .venv/bin/python benchmarks/transfer.py blend                between two shapes that have little in common
    .venv/bin/python benchmarks/transfer.py expression FACE      one expression of a face left out of the training

`blend` and `expression` train a network of their own, minutes. Times are processor times of all threads unless they
are called wall-clock times; the processor's do not depend on what else runs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import mi_simplify as ms

UP = np.array([0.0, 1.0, 0.0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    for run, add in COMMANDS.values():
        command = commands.add_parser(run.__name__, help=run.__doc__)
        add(command)
        command.set_defaults(run=run)
    args = vars(parser.parse_args())
    ms.ensure_variant()
    args.pop("run")(**args)


def projection(spp: int) -> None:
    """Errors of the coefficients, and a picture against a path tracer."""
    import trimesh

    from mi_simplify.model.topology import vertex_normals
    from mi_simplify.transfer.cast import Caster, unshadowed

    ball = trimesh.creation.icosphere(4)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    square, square_faces = plane(64)
    print("| case | largest error | root mean square |\n|---|---|---|")
    for name, (v, f) in {"plane": (square, square_faces), "ball": (vertices, faces)}.items():
        normals = vertex_normals(v, f)
        wanted = np.stack([quadrature(n, lambda d: np.ones(d.shape[:-1]), 200) for n in normals[::97]])
        table_row(f"{name}, against the integral", Caster(v, f)(v, normals)[::97] - wanted)
    center = np.array([0, 0.7, 0])
    scene = np.concatenate([square, 0.4 * vertices + center]), np.concatenate([square_faces, faces + len(square)])
    normals = np.concatenate([np.tile(UP, (len(square), 1)), vertices])
    some = np.arange(0, len(square), 389)
    wanted = np.stack([quadrature(UP, misses(center - square[k], 0.4), 500) for k in some])
    for n in (256, 2048):
        out = Caster(*scene, n_directions=n)(scene[0], normals)[some]
        table_row(f"ball over a plane, {n} rays, against quadrature", out - wanted)
    table_row("the same without shadows", unshadowed(UP) - wanted)
    print(f"\npicture of ball and plane, {spp} samples a pixel: {picture(*scene, normals, spp):.1f} dB")


def casting(side: int, directions: int) -> None:
    """Rays a second."""
    import drjit as dr
    import mitsuba as mi

    from mi_simplify.model.topology import vertex_normals
    from mi_simplify.transfer.cast import OFFSET, Caster, direction
    from mi_simplify.transfer.sequences.cloth import cloth

    sequence = cloth(2, side)
    positions = sequence.frames[-1]
    normals = vertex_normals(positions, sequence.faces)
    caster = Caster(positions, sequence.faces, n_directions=directions)
    start = mi.Point3f(np.ascontiguousarray((positions + OFFSET * normals).T, np.float32))
    frame = mi.Frame3f(mi.Normal3f(np.ascontiguousarray(normals.T, np.float32)))
    ways = (frame, caster._turn, caster._shift, mi.UInt32(directions))
    dr.eval(start, ways)

    def bare() -> float:
        """Rays made before; nothing but Mitsuba's own intersection is measured."""
        spent = 0.0
        for k in range(directions):
            ray = mi.Ray3f(start, direction(ways, dr.opaque(mi.UInt32, k)))
            dr.eval(ray)
            spent += clocked(lambda: dr.eval(caster._mesh.scene.ray_intersect(ray)))[0]  # noqa: B023
        return spent

    n_rays = len(positions) * directions
    times: dict[str, list[float]] = {"cast": [], "bare": []}
    for _ in range(4):  # the first one compiles
        times["cast"].append(clocked(lambda: caster(positions, normals))[0])
        times["bare"].append(bare())
    wall = min(clocked(lambda: caster(positions, normals))[1] for _ in range(3))
    cast, own = (float(np.median(times[k][1:])) for k in ("cast", "bare"))
    print(f"{len(positions)} vertices x {directions} directions, {2 * (side - 1) ** 2} triangles")
    print(f"casting {cast:.2f} s, {n_rays / cast / 1e6:.1f} million rays a second and core, {wall:.2f} s wall clock")
    print(f"ray_intersect of the same rays {own:.2f} s, {n_rays / own / 1e6:.1f} million a second and core")
    print(f"casting reaches {100 * own / cast:.0f} % of it")


def images(sources: list[str], sizes: list[int], vertices: int | None) -> None:
    """Geometry images."""
    from mi_simplify.transfer.sequences.opening import open_sequence
    from mi_simplify.transfer.surfaces.image import geometry_image

    print("| surface | size | folds | stretch | mean distance | largest [diagonals] |\n|---|---|---|---|---|---|")
    for source in sources:
        sequence = open_sequence(source, 10, n_vertices=vertices)
        for size in sizes:
            f = geometry_image(sequence.rest, sequence.faces, size, close_holes=True, what=sequence.name).figures
            numbers = f"{f['flipped']:.0f} | {f['stretch']:.3g} | {f['distance']:.2g} | {f['worst_distance']:.2g}"
            print(f"| {Path(source).name} | {size}² | {numbers} |", flush=True)


def network(folders: list[Path]) -> None:
    """Trained networks."""
    from mi_simplify.transfer.cast import Caster
    from mi_simplify.transfer.dataset import load_dataset
    from mi_simplify.transfer.linear import fit_linear
    from mi_simplify.transfer.network import Network
    from mi_simplify.transfer.run import DATA, NETWORK, measured

    print("| data | model | L1 | PSNR [dB] | bytes | share of the coefficients |\n|---|---|---|---|---|---|")
    for folder in folders:
        data, model = load_dataset(folder / DATA), Network(folder / NETWORK)
        figures = measured(data, model, fit_linear(data))
        coefficients = 4 * figures["numbers"]["coefficients"]
        size = {"network": (folder / NETWORK).stat().st_size, "linear": 4 * figures["numbers"]["linear"]}
        for name, own in figures["models"].items():
            sizes = f"{size[name]:,} | {size[name] / coefficients:.4f}" if name in size else "0 | 0"
            print(f"| {folder.name} | {name} | {own['l1']:.5f} | {own['psnr']:.2f} | {sizes} |", flush=True)
        k = data.held_out[0]
        caster = Caster(data.positions[k], data.faces)
        caster(data.positions[k], data.normals[k])
        rays = min(clocked(lambda: caster(data.positions[k], data.normals[k]))[1] for _ in range(5))  # noqa: B023
        inference = f"{figures['milliseconds']:.1f} ms wall clock by onnxruntime"
        print(f"\n{folder.name}: a frame takes {inference}, {1e3 * rays:.0f} ms by 256 rays a vertex\n")


def blend(size: int, frames: int, minutes: float, epochs: int) -> None:
    """From a bowl to a tent with folds; frames lie in random order along the way."""
    from mi_simplify.transfer.dataset import bake
    from mi_simplify.transfer.sequences.sequence import Sequence
    from mi_simplify.transfer.surfaces.image import grid_faces

    x, z = np.meshgrid(np.linspace(-1, 1, size), np.linspace(1, -1, size))
    r = np.hypot(x, z)
    bowl = np.stack([x * (0.6 + 0.25 * r), 0.9 * r**2, z * (0.6 + 0.25 * r)], 2)
    tent = np.stack([0.8 * x, 0.35 * np.cos(7 * x + 2 * z) - 0.7 * r, 0.8 * z], 2)
    t = np.random.default_rng(0).permutation(np.linspace(0, 1, frames))
    poses = (1 - t)[:, None, None, None] * bowl + t[:, None, None, None] * tent
    poses = poses.reshape(frames, -1, 3).astype(np.float32)
    data = bake(Sequence("blend", grid_faces(size), poses, poses[0]), size)
    model, linear = trained(data, minutes, epochs)
    held = data.held_out[np.argsort(t[data.held_out])]
    rows = {name: errors(data, m, held) for name, m in (("network", model), ("linear", linear))}
    print("| blend | network L1 | linear L1 | no shadows |\n|---|---|---|---|")
    nothing = errors(data, shadowless(data), held)
    for part in np.array_split(np.arange(len(held)), min(10, len(held))):
        cells = [f"{row[part].mean():.5f}" for row in (rows["network"], rows["linear"], nothing)]
        print(f"| {t[held[part]].mean():.2f} | " + " | ".join(cells) + " |")


def expression(face: Path, name: str, size: int, frames: int, minutes: float, epochs: int) -> None:
    """A face that never made one expression in training, and makes it more and more."""
    from mi_simplify.transfer.dataset import bake
    from mi_simplify.transfer.sequences.face import face as face_sequence

    sequence = face_sequence(face, frames)
    with np.load(face, allow_pickle=False) as arrays:
        names = [str(n) for n in arrays["expression_names"]]
        offset = np.asarray(arrays["expression"][names.index(name)], np.float64)[: len(sequence.rest)]
    assert sequence.parameters is not None
    flat = offset.ravel() / (offset**2).sum()
    # What the frames hold of this expression's displacement goes, whichever expression brought it.
    moved = (sequence.frames - sequence.rest).reshape(frames, -1)
    without = sequence.frames - ((moved @ flat)[:, None] * offset.ravel()).reshape(frames, -1, 3)
    weights = np.linspace(0, 1, 6)
    tests = sequence.rest + weights[:, None, None] * offset
    poses = np.concatenate([without, tests]).astype(np.float32)
    whole = bake(replace(sequence, frames=poses, parameters=None), size, close_holes=True)
    data = replace(whole, **{k: getattr(whole, k)[:frames] for k in ("positions", "normals", "transfer")})
    model, linear = trained(data, minutes, epochs)
    print(f"| weight of {name} | network L1 | linear L1 | no shadows |\n|---|---|---|---|")
    at = np.arange(frames, frames + len(weights))
    columns = [errors(whole, m, at) for m in (model, linear, shadowless(whole))]
    for k, w in enumerate(weights):
        print(f"| {w:.1f} | " + " | ".join(f"{c[k]:.5f}" for c in columns) + " |")


def trained(data, minutes: float, epochs: int):
    """A network and the linear model."""
    from mi_simplify.transfer.linear import fit_linear
    from mi_simplify.transfer.network import Network, Training, train

    with TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        done = train(data, path, Training(epochs=epochs, minutes=minutes))
        print(f"{done['epochs']} epochs in {done['seconds']:.0f} s\n")
        return Network(path), fit_linear(data)


def shadowless(data) -> Callable:
    from mi_simplify.transfer.cast import unshadowed

    return lambda positions, normals: unshadowed(normals, round(data.transfer.shape[2] ** 0.5) - 1, data.albedo)


def errors(data, model: Callable, frames: np.ndarray) -> np.ndarray:
    """Mean absolute error of each frame."""
    guess = model(data.positions[frames], data.normals[frames])
    return np.abs(guess - data.transfer[frames]).mean((1, 2))


def clocked(call: Callable) -> tuple[float, float]:
    """Processor and wall-clock time of a call [s]."""
    import drjit as dr

    dr.sync_thread()
    start = time.process_time(), time.perf_counter()
    call()
    dr.sync_thread()
    return time.process_time() - start[0], time.perf_counter() - start[1]


def table_row(name: str, error: np.ndarray) -> None:
    print(f"| {name} | {np.abs(error).max():.2g} | {np.sqrt((error**2).mean()):.2g} |", flush=True)


def plane(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A square in y = 0 that faces up."""
    from mi_simplify.transfer.surfaces.image import grid_faces

    x, z = np.meshgrid(np.linspace(-1, 1, n), np.linspace(1, -1, n))
    vertices, faces = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], 1), grid_faces(n)
    a, b, c = vertices[faces[0]]
    return vertices, faces if np.cross(b - a, c - a)[1] > 0 else faces[:, ::-1]


def misses(center: np.ndarray, radius: float) -> Callable:
    """Which directions from the origin a ball does not stop."""

    def test(d: np.ndarray) -> np.ndarray:
        along = d @ center
        return ~((along > 0) & (center @ center - along**2 < radius**2))

    return test


def quadrature(normal: np.ndarray, visible: Callable, n: int) -> np.ndarray:
    """The definition itself: a sum over a grid of directions, n rows."""
    from mi_simplify.model.light.harmonics import harmonics

    theta, phi = np.meshgrid((np.arange(n) + 0.5) / n * np.pi, (np.arange(2 * n) + 0.5) / n * np.pi, indexing="ij")
    d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    t = 0.8 / np.pi * np.maximum(0, d @ normal) * visible(d) * np.sin(theta) * (np.pi / n) ** 2
    return np.array([(t * b).sum() for b in np.broadcast_arrays(*harmonics(3, d[..., 0], d[..., 1], d[..., 2]))])


def picture(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, spp: int) -> float:
    """PSNR of a picture from coefficients against Mitsuba's path tracer, the same light."""
    import mitsuba as mi

    from mi_simplify.judging.metrics import psnr
    from mi_simplify.machine.meshes import make_mesh
    from mi_simplify.transfer.cast import Caster
    from mi_simplify.transfer.light import environment
    from mi_simplify.transfer.picture import Camera, seen

    light = np.zeros((16, 3), np.float32)  # positive everywhere, so that the picture of it clips nothing
    light[0], light[1], light[2], light[3], light[7] = 1.4, [0.5, 0.4, 0.3], [0.2, 0.1, 0], [0.1, 0.2, 0.4], 0.1
    origin, target = np.array([1.5, 1.8, 2.4]), np.array([0, 0.3, 0])
    transfer = Caster(vertices, faces, n_directions=512)(vertices, normals)
    fine = seen(vertices, faces, Camera(origin, target), 256).shaded(transfer, light)
    diffuse = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}})
    scene = mi.load_dict({
        "type": "scene", "object": make_mesh("object", vertices, faces, normals=normals, bsdf=diffuse),
        "light": {"type": "envmap", "bitmap": mi.Bitmap(environment(light, 256))},
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "sensor": {
            "type": "perspective", "fov": 35.0,
            "to_world": mi.ScalarTransform4f().look_at(origin.tolist(), target.tolist(), [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}},
        },
    })  # fmt: skip
    theirs = np.array(mi.render(scene, spp=spp, seed=1))[None, ..., :3]
    return float(psnr(theirs, fine.reshape(64, 4, 64, 4, 4).mean((1, 3))[None, ..., :3])[0])


def _training(command: argparse.ArgumentParser) -> None:
    command.add_argument("--size", type=int, default=32)
    command.add_argument("--frames", type=int, default=300)
    command.add_argument("--minutes", type=float, default=5.0)
    command.add_argument("--epochs", type=int, default=400)


def _casting(command: argparse.ArgumentParser) -> None:
    command.add_argument("--side", type=int, default=256, help="Vertices a side.")
    command.add_argument("--directions", type=int, default=256)


def _images(command: argparse.ArgumentParser) -> None:
    command.add_argument("sources", nargs="+")
    command.add_argument("--sizes", type=int, nargs="+", default=[64, 128])
    command.add_argument("--vertices", type=int, help="First vertices of a face's file to keep.")


def _expression(command: argparse.ArgumentParser) -> None:
    command.add_argument("face", type=Path)
    command.add_argument("--name", default="jawOpen")
    _training(command)


COMMANDS: dict[str, tuple[Callable, Callable[[argparse.ArgumentParser], object]]] = {
    "projection": (projection, lambda command: command.add_argument("--spp", type=int, default=1024)),
    "casting": (casting, _casting),
    "images": (images, _images),
    "network": (network, lambda command: command.add_argument("folders", type=Path, nargs="+")),
    "blend": (blend, _training),
    "expression": (expression, _expression),
}


if __name__ == "__main__":
    main()
