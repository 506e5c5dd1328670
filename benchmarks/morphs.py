"""
Morph targets on a small mesh: a face of blend shapes, judged over random weights beside plain quadrics.

    .venv/bin/python benchmarks/morphs.py ../shared/assets/face/ict_face.npz --triangles 2000

Every candidate is written as a GLB file with its targets and those weights as defaults, and read back: what is judged
is what viewers show. Weights are uniform in [0, 1] for a few targets at a time, 0 for the others.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace

import numpy as np

import mi_simplify as ms
from mi_simplify.fitting.loop import fit
from mi_simplify.initial.closest import ClosestPoints
from mi_simplify.initial.quadrics import quadrics_only
from mi_simplify.judging.evaluate import Judging, compare_assets
from mi_simplify.model.asset import Asset, Instance, Morph, Part
from mi_simplify.model.model import Model, Morphs
from mi_simplify.subjects.model_file import ModelFile


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "face", help="npz file with neutral (V, 3), quads (Q, 4), expression (E, V, 3), expression_names"
    )
    parser.add_argument("--triangles", type=int, default=2000)
    parser.add_argument("--targets", type=int, default=20)
    parser.add_argument("--poses", type=int, default=6)
    parser.add_argument("--views", type=int, default=4, help="of each pose")
    parser.add_argument("--set", nargs="*", default=[], help="configuration keys")
    args = parser.parse_args()
    asset = face(args.face, args.targets)
    config = ms.load_config(None, ["asset=face.glb", f"initial.triangles={args.triangles}", *args.set])
    ms.ensure_variant(config.variant)
    subject = ModelFile(config, asset)
    guess, _ = subject.guess()
    models = {
        "quadrics, targets carried over": with_targets(quadrics_only(asset, guess.n_triangles)[0], asset),
        "first guess": subject.frame.restored(guess),
    }
    if subject.config.optimizer.steps:
        fitted = fit(guess, subject.reference(), subject.config).model
        models["fitted at rest"] = subject.frame.restored(fitted)
    rng = np.random.default_rng(0)
    rows: dict[str, list] = {name: [] for name in models}
    judged = subject.config.evaluation
    for pose in range(args.poses):
        weights = rng.random(args.targets) * (rng.random(args.targets) < 0.25)
        shown = {name: posed_file(model, weights) for name, model in models.items()}
        settings = Judging(args.views, judged.resolution, judged.spp, seed=pose)
        found = compare_assets(posed(asset, weights), shown, settings).figures["candidates"]
        for name, row in found.items():
            rows[name].append([row["psnr"], row["flip"], row["silhouette_error"]])
    print("| candidate | triangles | PSNR | FLIP | silhouette error | worst pose |\n|---|---|---|---|---|---|")
    for name, values in rows.items():
        psnr, flip, outline = np.mean(values, axis=0)
        worst = np.min(values, axis=0)[0]
        print(f"| {name} | {models[name].n_triangles} | {psnr:.2f} | {flip:.4f} | {outline:.4f} | {worst:.2f} |")


def face(path: str, n_targets: int) -> Asset:
    """The head with the expressions that move most of it."""
    with np.load(path) as data:
        neutral, quads, shapes = (np.array(data[key]) for key in ("neutral", "quads", "expression"))
        names = [str(name) for name in data["expression_names"]]
    shapes = shapes.astype(np.float64)
    most = np.argsort(-np.abs(shapes).sum((1, 2)), kind="stable")[:n_targets]
    morphs = tuple(Morph(names[k], shapes[k]) for k in most)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int64)
    part = Part(neutral.astype(np.float64), faces, morphs=morphs, name="face")
    return Asset((part,), (Instance(0),), name="face")


def with_targets(model: Model, asset: Asset) -> Model:
    """A model with the asset's targets as scripts carry them over: those of the closest points."""
    (part,), mesh = asset.parts, model.mesh
    found = ClosestPoints(part.vertices, part.faces).query(mesh.positions)
    corners = part.faces[found.face]
    offsets = [np.einsum("nc,nci->ni", found.barycentric, morph.offsets[corners]) for morph in part.morphs]
    names = tuple(morph.name for morph in part.morphs)
    return replace(model, morphs=Morphs(names, (0.0,) * len(names), np.array(offsets)))


def posed(asset: Asset, weights: np.ndarray) -> Asset:
    """The asset with its targets at some weights."""
    (part,) = asset.parts
    moved = part.vertices + sum(w * morph.offsets for w, morph in zip(weights, part.morphs, strict=True))
    return replace(asset, parts=(replace(part, vertices=moved, morphs=()),))


def posed_file(model: Model, weights: np.ndarray) -> Asset:
    """A model at some weights, as a reader sees its file."""
    morphs = model.morphs
    assert morphs is not None and not any(morphs.weights)
    positions = model.mesh.positions + np.tensordot(weights, morphs.offsets, axes=1)
    moved = replace(model, mesh=replace(model.mesh, positions=positions))
    moved = replace(moved, morphs=replace(morphs, weights=tuple(weights.tolist())))
    with tempfile.TemporaryDirectory() as folder:
        return ms.load_asset(ms.export_model(moved, folder, formats=["glb"])["glb"])


if __name__ == "__main__":
    main()
