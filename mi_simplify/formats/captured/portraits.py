"""
Portraits: images of one head with intrinsics and landmarks, with or without depth, from cameras that nobody knows.

A JSON file as of :mod:`.read` without ``transform_matrix`` and lights, in whose frames are ``landmarks``, a list of
[x, y] from the top left corner [pixels], and ``depth_path``: an image of one channel, distance along the view axis, 0
or NaN where it is not known. Whole numbers of a PNG are multiples of ``depth_scale``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AssetError
from ..images import decode_image
from .read import FrameReader


@dataclass(frozen=True)
class Portraits:
    """
    Parameters
    ----------
    images : tuple of ndarray, each of shape (H, W, 4), float16
        Linear radiance on black (premultiplied by coverage), and coverage; 1 everywhere where none is known.
    depths : tuple of ndarray, each of shape (H, W), float32, or None
        Distance along the view axis, NaN where it is not known.
    landmarks : ndarray, shape (N, L, 2)
        [pixels]
    focal, center : ndarray, shape (N, 2)
        As of :class:`.read.Captured`.
    names : tuple of str
    source : str
    """

    images: tuple[np.ndarray, ...]
    depths: tuple[np.ndarray, ...] | None
    landmarks: np.ndarray
    focal: np.ndarray
    center: np.ndarray
    names: tuple[str, ...]
    source: str

    def __len__(self) -> int:
        return len(self.images)

    @property
    def masked(self) -> bool:
        """Whether all images tell the head from what is behind it."""
        return all((image[..., 3] < 0.5).any() for image in self.images)


def read_portraits(path: str | Path, *, depth: bool = True) -> Portraits:
    """
    Read the file and all images that it names, and check that they fit together.

    Parameters
    ----------
    path : str or Path
    depth : bool
        Whether depth is looked at where there is any.

    Raises
    ------
    AssetError
        The file or an image is missing or broken; sizes or intrinsics do not fit; landmarks are missing, more in one
        image than in another, or outside of theirs; some images have a depth and others none.
    """
    path = Path(path)
    if not path.is_file():
        raise AssetError(f"the portraits '{path}' do not exist")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise AssetError(f"{path.name}: it is no JSON file ({str(error).splitlines()[0]:.100})") from None
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(f, dict) for f in frames):
        raise AssetError(f"{path.name}: it has no 'frames', a list of images with their landmarks")
    return _PortraitReader(path, document).portraits(frames, depth)


class _PortraitReader(FrameReader):
    """Frames of one file, one after the other."""

    needs_mask = False

    def portraits(self, frames: list[dict], depth: bool) -> Portraits:
        """All of them."""
        files = [self.file(frame, "file_path") for frame in frames]
        images, focal, center, landmarks = [], [], [], []
        for frame, file in zip(frames, files, strict=True):
            image = self.image(frame, file)
            f, c = self.intrinsics(frame, image, file.name)
            images.append(image)
            focal.append(f)
            center.append(c)
            landmarks.append(self._landmarks(frame, image, file.name))
        if len({len(marks) for marks in landmarks}) > 1:
            counts = ", ".join(str(len(marks)) for marks in landmarks)
            raise AssetError(f"{self.path.name}: every frame needs the same landmarks, got {counts} of them")
        depths = self._depths(frames, files, images) if depth else None
        return Portraits(
            tuple(images), depths, np.array(landmarks), np.array(focal), np.array(center),
            tuple(file.name for file in files), str(self.path),
        )  # fmt: skip

    def _landmarks(self, frame: dict, image: np.ndarray, name: str) -> np.ndarray:
        try:
            marks = np.array(frame["landmarks"], np.float64)
        except (LookupError, TypeError, ValueError):
            marks = np.zeros(0)
        if marks.ndim != 2 or marks.shape[1] != 2 or not np.isfinite(marks).all():
            raise AssetError(f"{self.path.name}: 'landmarks' of '{name}' should be a list of [x, y] in pixels")
        height, width = image.shape[:2]
        outside = ((marks < 0) | (marks > [width, height])).any(1)
        if outside.any():
            k = int(np.argmax(outside))
            x, y = marks[k]
            raise AssetError(
                f"{self.path.name}: landmark {k} of '{name}' is at ({x:.1f}, {y:.1f}), outside of its "
                f"{width} × {height} pixels; leave the image out, or correct the landmark"
            )
        return marks

    def _depths(self, frames: list[dict], files: list[Path], images: list[np.ndarray]) -> tuple[np.ndarray, ...] | None:
        has = [frame.get("depth_path") is not None for frame in frames]
        if not any(has):
            return None
        if not all(has):
            name = files[has.index(False)].name
            raise AssetError(f"{self.path.name}: frame '{name}' has no 'depth_path', others have; give all or none")
        return tuple(self._depth(*of) for of in zip(frames, files, images, strict=True))

    def _depth(self, frame: dict, file: Path, image: np.ndarray) -> np.ndarray:
        path = self.file(frame, "depth_path")
        values = decode_image(path.read_bytes(), path.name, self.path.name)
        if values.shape[:2] != image.shape[:2]:
            sizes = " but ".join(f"{x.shape[1]} × {x.shape[0]}" for x in (values, image))
            raise AssetError(f"{self.path.name}: the depth of '{file.name}' has {sizes} pixels in the image")
        scale: Any = frame.get("depth_scale", self.document.get("depth_scale"))
        is_float = values.dtype.kind == "f"
        if not is_float and not (isinstance(scale, int | float) and scale > 0):
            raise AssetError(
                f"{self.path.name}: the depth of '{file.name}' is in whole numbers; 'depth_scale' should say what one "
                "stands for"
            )
        depth = values[..., 0].astype(np.float32) * np.float32(1 if is_float else scale)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float32)
