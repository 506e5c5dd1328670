"""
The job of the command ``face``: a morphable face fitted to portraits, as a GLB file with the cameras that saw it.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...config.commands.face import FaceSettings
from ...errors import AssetError
from ...fitting.face.fit import FaceFit, FaceTargets
from ...fitting.face.landmarks import LandmarkFit, fit_landmarks
from ...formats.captured.portraits import Portraits, read_portraits
from ...formats.gltf.write import write_glb
from ...formats.load import load_asset
from ...judging.comparison import Comparison, save_comparison
from ...judging.evaluate import costs
from ...judging.metrics import compare
from ...latent.morphing import MorphedModel
from ...machine.files import write_atomic
from ...machine.runtime import ensure_variant
from ...model.frame import Frame
from ...model.light.harmonics import constant_environment
from ...model.model import Model, Morphs
from ...progress import Progress, ProgressCallback, silent
from ...record.output import RunFolder
from ...report import report_folder
from ...scenes.references.images import squared
from .morphable import open_morphable

RESULT, CAMERAS = "model.glb", "transforms.json"

#: Radiance of the grey environment that the fit begins with.
_LIGHT = 0.8


@dataclass(frozen=True)
class FaceFound:
    """
    Parameters
    ----------
    model : Model
        In the units of the depth maps, or of the model's file where there are none; of its morph targets those of
        expression are left, what makes the person is in the mesh.
    weights : ndarray, shape (K,)
    scale : float
        Units of the result by units of the model's file.
    rotations, origins : ndarray, shape (B, 3, 3) and (B, 3)
        Of the cameras: rows are right, down and ahead; places in the units of the result.
    landmarks : LandmarkFit
        What landmarks alone said, in the normalised frame.
    targets, before, after : ndarray, shape (B, S, S, 4)
        Images on the film, of landmarks alone, and of the result.
    terms : dict of str to float
        Of the loss at the last step, without their weights.
    fit : FaceFit
        Itself; the units of the result are those of its frame times ``unit`` plus ``center``.
    unit : float
    center : ndarray, shape (3,)
    """

    model: Model
    weights: np.ndarray
    scale: float
    rotations: np.ndarray
    origins: np.ndarray
    landmarks: LandmarkFit
    targets: np.ndarray
    before: np.ndarray
    after: np.ndarray
    terms: dict[str, float]
    fit: FaceFit
    unit: float
    center: np.ndarray


def find_face(settings: FaceSettings, progress: ProgressCallback = silent) -> FaceFound:
    """
    Poses, scale and weights from landmarks, then these and textures and light from the images.

    Raises
    ------
    UserError
        Model or portraits cannot be used, or do not fit together.
    """
    ensure_variant(None)
    portraits = read_portraits(settings.portraits, depth=settings.depth)
    own, landmarks, n_identity = open_morphable(settings)
    if portraits.landmarks.shape[1] != len(landmarks):
        raise AssetError(
            f"{Path(portraits.source).name}: it has {portraits.landmarks.shape[1]} landmarks in an image, the model "
            f"{len(landmarks)}; they should be the same ones"
        )
    assert own.morphs is not None
    positions = own.mesh.positions
    frame = Frame.around(np.array([positions.min(0), positions.max(0)]))
    model = own.transformed(frame.scale, -frame.scale * frame.center)
    assert isinstance(model, MorphedModel) and model.morphs is not None
    targets = on_film(portraits, settings.resolution)
    start = _from_landmarks(portraits, targets, model.mesh.positions[landmarks], model.morphs.offsets[:, landmarks])
    model = replace(model, base_color=_toned(model.base_color, targets), ambient=constant_environment((_LIGHT,) * 3))
    fit = FaceFit(model, landmarks, targets, start, settings)
    before, terms = fit.render(fit.poses.still()), {}
    for k in range(settings.steps):
        found = fit.step()
        if k % 10 == 0 or k == settings.steps - 1:
            terms = {name: float(value[0]) for name, value in found.items()}
            progress(Progress("fit", k + 1, settings.steps, terms["color"], None, figures=terms))
    views = fit.poses.still()
    after, arrays = fit.render(views), views.arrays()
    unit = fit.poses.value_of_scale() if targets.depth is not None else 1 / frame.scale
    scale = unit * frame.scale
    center = scale * frame.center
    whole = fit.model()
    assert whole.morphs is not None
    weights = np.array(whole.morphs.weights)
    result = replace(whole, morphs=_expressions(whole.morphs, n_identity)).transformed(unit, center)
    return FaceFound(
        result, weights, scale, np.stack([arrays["right"], -arrays["up"], arrays["forward"]], 1),
        arrays["origin"] * unit + center, start, np.nan_to_num(targets.images), before, after, terms, fit, unit, center,
    )  # fmt: skip


def on_film(portraits: Portraits, resolution: int) -> FaceTargets:
    """
    Portraits on a square film around the optical axis that holds all of them.
    """
    sizes = np.array([image.shape[1::-1] for image in portraits.images])
    tan = float((np.maximum(portraits.center, sizes - portraits.center) / portraits.focal).max())
    of = list(zip(portraits.images, portraits.focal, portraits.center, strict=True))
    images = np.stack([squared(image, f, c, tan, resolution) for image, f, c in of])
    marks = (portraits.landmarks - portraits.center[:, None]) / portraits.focal[:, None] / tan
    depth = None
    if portraits.depths is not None:
        at = zip(portraits.depths, portraits.focal, portraits.center, strict=True)
        depth = np.stack([_nearest(d, f, c, tan, resolution) for d, f, c in at])
    return FaceTargets(images, (marks + 1) / 2 * resolution, depth, tan, portraits.masked)


def _nearest(depth: np.ndarray, focal: np.ndarray, center: np.ndarray, tan: float, resolution: int) -> np.ndarray:
    """A depth map at the centres of the film's pixels, from the nearest of its own; NaN beyond it."""
    x = (2 * (np.arange(resolution) + 0.5) / resolution - 1) * tan
    column, row = (np.floor(center[k] + x * focal[k]).astype(int) for k in range(2))
    inside = [(at >= 0) & (at < size) for at, size in ((column, depth.shape[1]), (row, depth.shape[0]))]
    out = depth[np.clip(row, 0, depth.shape[0] - 1)][:, np.clip(column, 0, depth.shape[1] - 1)]
    return np.where(inside[1][:, None] & inside[0][None], out, np.nan)


def _from_landmarks(portraits: Portraits, targets: FaceTargets, points: np.ndarray, offsets: np.ndarray) -> LandmarkFit:
    """
    Poses and weights from landmarks, and the scale that most of their depths agree on: those of landmarks behind
    something say nothing of them.
    """
    side = max(max(image.shape[:2]) for image in portraits.images)  # so that errors are in pixels of the images
    seen = targets.landmarks * (side / targets.images.shape[1])
    found = fit_landmarks(points, offsets, seen, side / 2 / targets.tan, (side, side))
    if portraits.depths is None:
        return found
    moved = points + np.tensordot(found.weights, offsets, axes=1)
    z = np.einsum("bj,lj->bl", found.rotations[:, 2], moved) + found.translations[:, 2:]
    ratios = []
    for depth, marks, of in zip(portraits.depths, portraits.landmarks, z, strict=True):
        column, row = np.clip(marks.astype(int), 0, np.array(depth.shape[::-1]) - 1).T
        ratios.append(depth[row, column] / of)
    if not np.isfinite(ratios).any():
        raise AssetError(f"{Path(portraits.source).name}: no landmark has a depth; leave it out, or set depth: false")
    scale = float(np.nanmedian(ratios))
    return replace(found, scale=scale, translations=found.translations * scale)


def _toned(base_color: np.ndarray, targets: FaceTargets) -> np.ndarray:
    """A texture that has nothing to say yet, in the mean colour of what is between the landmarks."""
    if np.ptp(base_color, axis=(0, 1)).any():
        return base_color
    inside = []
    for image, marks in zip(targets.images, targets.landmarks, strict=True):
        (left, top), (right, bottom) = marks.min(0).astype(int), np.ceil(marks.max(0)).astype(int)
        pixels = image[max(top, 0) : bottom, max(left, 0) : right].reshape(-1, 4)
        inside.append(pixels[pixels[:, 3] > 0.99, :3])  # what is NaN is not
    seen = np.concatenate(inside)
    color = np.clip(seen.mean(0) / _LIGHT, 0.02, 0.9) if len(seen) else base_color[0, 0, :3]
    return np.concatenate([np.broadcast_to(color, base_color[..., :3].shape), base_color[..., 3:]], 2, dtype=np.float32)


def _expressions(morphs: Morphs, n_identity: int) -> Morphs | None:
    """The morph targets that come after those of identity."""
    kept = slice(n_identity, None)
    names = morphs.names[kept]
    return Morphs(names, morphs.weights[kept], morphs.offsets[kept]) if names else None


def face_job(
    settings: FaceSettings, out: str | Path, progress: ProgressCallback = silent, *, overwrite: bool = False
) -> dict[str, Any]:
    """
    Fit, and write ``model.glb``, ``transforms.json`` with the cameras, ``metrics.json`` and a report.

    Returns
    -------
    dict
        What ``metrics.json`` holds.

    Raises
    ------
    UserError
        Input or folder cannot be used; nothing is left behind.
    """
    folder, begin = RunFolder(out, overwrite=overwrite), time.perf_counter()
    found = find_face(settings, progress)
    seconds = time.perf_counter() - begin
    facts = {"generator": f"mi_simplify {__version__}"}
    with folder.opened():
        with folder.staged() as stage:
            write_glb(found.model, stage / RESULT, extras=facts)
            cameras = _cameras(settings, found, folder.path)
            write_atomic(stage / CAMERAS, json.dumps(cameras, indent=1))
        asset = load_asset(folder.path / RESULT)
        images = {"landmarks": found.before, "result": found.after}
        rows = {name: costs(asset) | compare(found.targets, image) for name, image in images.items()}
        seen = {"n_views": len(found.targets), "resolution": settings.resolution, "spp": settings.spp}
        figures = {
            "settings": seen | {"seed": settings.seed},
            "reference": {"name": Path(settings.portraits).parent.name or "portraits", "triangles": asset.n_triangles},
            "candidates": rows,
            "run": facts | {
                "seconds": {"fit": round(seconds, 1)}, "scale": found.scale, "weights": found.weights.tolist(),
                "terms": found.terms, "landmark_error": found.landmarks.error, "notes": [],
            },
        }  # fmt: skip
        with folder.staged() as stage:
            save_comparison(Comparison(found.targets, images, figures), stage)
        report_folder(folder.path, {"result": asset})
    return figures


def _cameras(settings: FaceSettings, found: FaceFound, folder: Path) -> dict[str, Any]:
    """The portraits with the poses that were found, as ``transforms.json`` has them."""
    source = Path(settings.portraits)
    document = json.loads(source.read_text(encoding="utf-8"))
    for frame, rows, origin in zip(document["frames"], found.rotations, found.origins, strict=True):
        matrix = np.eye(4)
        matrix[:3, :3] = (rows * [[1], [-1], [-1]]).T  # up and backwards
        matrix[:3, 3] = origin
        frame["transform_matrix"] = matrix.tolist()
        for key in ("file_path", "mask_path", "depth_path"):
            if frame.get(key) is not None:
                frame[key] = Path(os.path.relpath(source.parent / frame[key], folder)).as_posix()
    return document | {"up": "y", "light": "environment"}
