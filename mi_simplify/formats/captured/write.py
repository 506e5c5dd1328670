"""
Images with their cameras and lights, as a folder that other programs read: ``transforms.json`` and PNG or EXR files.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...machine.files import make_folder, write_atomic
from ...model.color import linear_to_srgb
from ..textures import png, to_8bit

TRANSFORMS = "transforms.json"


def write_captured(
    folder: str | Path,
    arrays: dict[str, np.ndarray],
    images: np.ndarray,
    *,
    format: str = "png",
    light: str = "point",
    frames: Sequence[dict] = (),
    document: dict | None = None,
    with_images: bool = True,
) -> Path:
    """
    Write rendered views in the convention of NeRF and Blender, see :mod:`.read`.

    Parameters
    ----------
    folder : str or Path
        Made where it is missing.
    arrays : dict of str to ndarray
        ``Views.arrays()``.
    images : ndarray, shape (B, H, W, 4)
        Linear radiance on black (premultiplied by coverage), and coverage.
    format : {'png', 'exr'}
        8-bit sRGB with straight alpha, clipped to 1; or linear floating point, premultiplied.
    light : {'point', 'unlit', 'environment'}
        'point' writes each view's own light.
    frames : sequence of dict
        More to say of each frame.
    document : dict, optional
        More to say of all.
    with_images : bool
        Off: the files are named, but not written; ``images`` says nothing but their size.

    Returns
    -------
    Path
        Of ``transforms.json``; +Y is up in it.
    """
    folder = make_folder(folder)
    make_folder(folder / "images")
    n, height, width = images.shape[:3]
    rows: list[dict] = []
    for k in range(n):
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = arrays["right"][k], arrays["up"][k], -arrays["forward"][k]
        matrix[:3, 3] = arrays["origin"][k]
        name = f"images/{k:04d}.{format}"
        frame = {
            "file_path": name,
            "transform_matrix": matrix.tolist(),
            "fl_x": float(width / 2 / arrays["tan_x"][k]),
        }
        if light == "point":
            frame["light"] = {key: arrays[f"light_{key}"][k].tolist() for key in ("position", "intensity")}
        if with_images:
            _write_image(folder / name, images[k], format)
        rows.append(frame | (frames[k] if len(frames) else {}))
    head = {"up": "y", "w": width, "h": height, "color_space": "srgb" if format == "png" else "linear"}
    if light != "point":
        head["light"] = light
    return write_atomic(folder / TRANSFORMS, json.dumps({**head, **(document or {}), "frames": rows}, indent=1))


def _write_image(path: Path, image: np.ndarray, format: str) -> None:
    if format == "png":
        straight = image[..., :3] / np.maximum(image[..., 3:], 1e-4)
        pixels = np.concatenate([linear_to_srgb(straight), np.clip(image[..., 3:], 0, 1)], axis=2)
        write_atomic(path, png(to_8bit(pixels)))
        return
    import mitsuba as mi  # which needs its variant by now, not on import

    bitmap = mi.Bitmap(np.ascontiguousarray(image, np.float32))
    write_atomic(path, lambda temporary: bitmap.write(str(temporary)))
