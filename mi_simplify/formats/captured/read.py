"""
Images and cameras from elsewhere: a folder with ``transforms.json`` in the convention of NeRF and Blender.

Cameras are ``camera-to-world`` matrices with +X right, +Y up and -Z forward on the image; intrinsics are
``camera_angle_x`` or ``fl_x fl_y cx cy w h``. Keys of our own, all optional: ``up`` (``z``, as in Blender, or ``y``),
``color_space`` (``linear`` or ``srgb``), ``alpha`` (``straight`` or ``premultiplied``), ``light`` (``unlit`` or
``environment``), and in a frame ``mask_path`` and ``light: {position, intensity}``.
"""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AssetError
from ...machine import memory
from ...model.color import srgb_to_linear
from ..images import check_image, decode_image

log = logging.getLogger("mi_simplify")

SUFFIXES = ("", ".png", ".exr", ".hdr", ".jpg", ".jpeg")
_CHOICES = {
    "up": ("z", "y"), "color_space": ("linear", "srgb"), "alpha": ("straight", "premultiplied"),
    "light": ("unlit", "environment"),
}  # fmt: skip

#: From a world with +Z up into ours.
_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class Captured:
    """
    N images with their cameras, and with a light each where these are known; +Y up, units of the file.

    Parameters
    ----------
    images : tuple of ndarray, each of shape (H, W, 4), float16
        Linear radiance on black (premultiplied by coverage), and coverage.
    to_world : ndarray, shape (N, 4, 4)
        Rigid transforms of the cameras, which look along -Z.
    focal, center : ndarray, shape (N, 2)
        Focal lengths and principal points [pixels], from the top left corner of the image.
    light_position, light_intensity : ndarray, shape (N, 3), or None
        Point lights, intensity in radiance times squared unit of length.
    light : {'point', 'unlit', 'environment'}
        What lit the images: these point lights; nothing, their colours are the base colours; something static.
    names : tuple of str
    source : str
    """

    images: tuple[np.ndarray, ...]
    to_world: np.ndarray
    focal: np.ndarray
    center: np.ndarray
    light_position: np.ndarray | None
    light_intensity: np.ndarray | None
    light: str
    names: tuple[str, ...]
    source: str

    def __len__(self) -> int:
        return len(self.images)


def read_captured(path: str | Path, *, may_be_empty: bool = False) -> Captured:
    """
    Read a ``transforms.json`` and all images that it names, and check that they fit together.

    Parameters
    ----------
    path : str or Path
    may_be_empty : bool
        Whether images may all be black or transparent.

    Raises
    ------
    AssetError
        The file or an image is missing or broken; sizes, matrices or intrinsics make no sense; nothing tells the
        object from its background, or nothing is to be seen.
    MemoryLimitError
        The images do not fit into memory.
    """
    path = Path(path)
    if not path.is_file():
        raise AssetError(f"the image set '{path}' does not exist")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise AssetError(f"{path.name}: it is no JSON file ({str(error).splitlines()[0]:.100})") from None
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(f, dict) for f in frames):
        raise AssetError(f"{path.name}: it has no 'frames', a list of images with their cameras")
    return FrameReader(path, document).read(frames, may_be_empty)


def read_image(path: Path, to_world: np.ndarray, yfov: float, aspect: float | None) -> Captured:
    """
    One image that a known camera took, see :func:`read_captured`; in the light that is not said.

    Parameters
    ----------
    to_world : ndarray, shape (4, 4)
        +Y up.
    yfov : float
        Vertical field of view [radians].
    aspect : float or None
        Width over height that the camera says it has.

    Raises
    ------
    AssetError
        As there, or the image has not the camera's shape.
    """
    width, height = check_image(path.read_bytes(), path.name, path.name)
    if aspect is not None and abs(width / height / aspect - 1) > 0.02:
        raise AssetError(
            f"{path.name}: it has {width} × {height} pixels, but the camera an aspect ratio of {aspect:.3g}; crop the "
            "image, or correct the camera"
        )
    document = {"up": "y", "fl_x": height / 2 / np.tan(yfov / 2)}
    frame = {"file_path": path.name, "transform_matrix": to_world.tolist()}
    return FrameReader(path, document).read([frame], False)


class FrameReader:
    """
    Frames of one file, one after the other.

    Parameters
    ----------
    path : Path
    document : dict
        What the file says of all frames.
    """

    needs_mask = True
    """Whether an image without alpha and mask is refused; else it covers all of its pixels."""

    def __init__(self, path: Path, document: dict[str, Any]):
        self.path, self.document = path, document
        for key, known in _CHOICES.items():
            if document.get(key) is not None and document[key] not in known:
                raise AssetError(f"{path.name}: '{key}' should be {' or '.join(known)}, got {document[key]!r:.40}")

    def read(self, frames: list[dict], may_be_empty: bool) -> Captured:
        """All of them."""
        turn = np.eye(4) if self.document.get("up") == "y" else _Y_UP
        files = [self.file(frame, "file_path") for frame in frames]
        n_pixels = sum(int(np.prod(check_image(file.read_bytes(), file.name, self.path.name))) for file in files)
        memory.require(n_pixels * 8 * 2, f"{self.path.name}: its {len(files)} images", "use fewer or smaller ones")
        images, to_world, focal, center = [], [], [], []
        for frame, file in zip(frames, files, strict=True):
            image = self.image(frame, file)
            f, c = self.intrinsics(frame, image, file.name)
            images.append(image)
            to_world.append(turn @ self._pose(frame, file.name))
            focal.append(f)
            center.append(c)
        if not may_be_empty and not any((image[..., 3] > 0.5).any() for image in images):
            raise AssetError(f"{self.path.name}: all images are transparent, there is nothing to fit")
        if not may_be_empty and not any(image[..., :3].any() for image in images):
            raise AssetError(f"{self.path.name}: all images are black, there is nothing to fit")
        lights = [self._light(frame, file.name) for frame, file in zip(frames, files, strict=True)]
        known = [light for light in lights if light is not None]
        if known and len(known) < len(frames):
            k = next(k for k, light in enumerate(lights) if light is None)
            raise AssetError(f"{self.path.name}: frame '{files[k].name}' has no 'light', others have; give all or none")
        position = intensity = None
        if known:
            position = np.array([turn[:3, :3] @ p for p, _ in known])
            intensity = np.array([i for _, i in known])
        light = "point" if known else self.document.get("light") or "environment"
        return Captured(
            tuple(images), np.array(to_world), np.array(focal), np.array(center), position, intensity, light,
            tuple(file.name for file in files), str(self.path),
        )  # fmt: skip

    def file(self, frame: dict, key: str) -> Path:
        """The file that a frame names under a key."""
        name = frame.get(key)
        if not isinstance(name, str) or not name:
            raise AssetError(f"{self.path.name}: a frame has no '{key}'")
        for suffix in SUFFIXES:
            file = self.path.parent / (name + suffix)
            if file.is_file():
                return file
        raise AssetError(f"{self.path.name}: the image '{name}' does not exist; paths are relative to {self.path.name}")

    def pixels(self, file: Path) -> tuple[np.ndarray, bool]:
        """Values in [0, 1] or radiance, shape (H, W, C), and whether they came as floating point numbers."""
        raw = decode_image(file.read_bytes(), file.name, self.path.name)
        if raw.dtype.kind == "f":
            if not np.isfinite(raw).all():
                raise AssetError(f"{self.path.name}: '{file.name}' holds NaN or infinity")
            return raw.astype(np.float32), True
        return raw.astype(np.float32) / np.iinfo(raw.dtype).max, False

    def image(self, frame: dict, file: Path) -> np.ndarray:
        """Premultiplied linear radiance and coverage."""
        pixels, is_float = self.pixels(file)
        n = pixels.shape[2]
        color = np.broadcast_to(pixels[..., : 3 if n > 2 else 1], (*pixels.shape[:2], 3))
        space = self.document.get("color_space") or ("linear" if is_float else "srgb")
        premultiplied = (self.document.get("alpha") or ("premultiplied" if is_float else "straight")) == "premultiplied"
        if frame.get("mask_path") is not None:
            mask, _ = self.pixels(self.file(frame, "mask_path"))
            if mask.shape[:2] != pixels.shape[:2]:
                sizes = " but ".join(f"{x.shape[1]} × {x.shape[0]}" for x in (mask, pixels))
                raise AssetError(f"{self.path.name}: the mask of '{file.name}' has {sizes} pixels in the image")
            alpha, premultiplied = mask[..., :1] if mask.shape[2] in (1, 3) else mask[..., -1:], False
        elif n in (2, 4):
            alpha = pixels[..., -1:]
        elif not self.needs_mask:
            alpha = np.ones_like(pixels[..., :1])
        else:
            raise AssetError(
                f"{self.path.name}: '{file.name}' has no alpha channel and its frame no 'mask_path'; without either "
                "nothing tells the object from the background"
            )
        if space == "srgb":
            straight = color / np.maximum(alpha, 1e-6) if premultiplied else color
            color = srgb_to_linear(straight) * alpha
        elif not premultiplied:
            color = color * alpha
        alpha = np.clip(alpha, 0, 1)
        return np.concatenate([np.clip(color, 0, 6e4), alpha], axis=2).astype(np.float16)

    def intrinsics(self, frame: dict, image: np.ndarray, name: str) -> tuple[list[float], list[float]]:
        """Focal lengths and principal point [pixels]."""

        def get(key: str) -> Any:
            return frame.get(key, self.document.get(key))

        height, width = image.shape[:2]
        for key in ("k1", "k2", "k3", "k4", "p1", "p2"):
            if get(key):
                raise AssetError(f"{self.path.name}: '{name}' is distorted ({key}); undistort the images first")
        for key, size in (("w", width), ("h", height)):
            if get(key) is not None and get(key) != size:
                raise AssetError(
                    f"{self.path.name}: '{name}' has {width} × {height} pixels, but '{key}' is {get(key)}; scale the "
                    "images or the intrinsics"
                )
        try:
            if get("fl_x") is not None:
                fx = float(get("fl_x"))
                fy = float(get("fl_y") or fx)
            else:
                fx = fy = width / 2 / np.tan(float(get("camera_angle_x")) / 2)
            cx, cy = float(get("cx") or width / 2), float(get("cy") or height / 2)
        except (TypeError, ValueError):
            raise AssetError(
                f"{self.path.name}: '{name}' needs 'camera_angle_x' [radians] or 'fl_x' [pixels], as a number"
            ) from None
        if not (0 < fx < 1e6 and 0 < fy < 1e6 and 0 < cx < width and 0 < cy < height):
            raise AssetError(f"{self.path.name}: the field of view or principal point of '{name}' makes no sense")
        return [fx, fy], [cx, cy]

    def _pose(self, frame: dict, name: str) -> np.ndarray:
        """A rigid transform; a uniform scale in it is taken out."""
        try:
            pose = np.array(frame["transform_matrix"], np.float64)
        except (LookupError, TypeError, ValueError):
            pose = np.zeros(0)
        if pose.shape not in ((4, 4), (3, 4)) or not np.isfinite(pose).all():
            raise AssetError(f"{self.path.name}: 'transform_matrix' of '{name}' should be 4 × 4 numbers")
        out = np.eye(4)
        out[:3] = pose[:3]
        scale = np.cbrt(np.linalg.det(out[:3, :3]))
        if scale <= 0 or not np.allclose(out[:3, :3].T @ out[:3, :3], np.eye(3) * scale**2, atol=1e-3 * scale**2):
            raise AssetError(
                f"{self.path.name}: 'transform_matrix' of '{name}' is no rotation with a position: mirrored or skewed"
            )
        out[:3, :3] /= scale
        return out

    def _light(self, frame: dict, name: str) -> tuple[np.ndarray, np.ndarray] | None:
        light = frame.get("light")
        if light is None:
            return None
        try:
            position = np.array(light["position"], np.float64).reshape(3)
            intensity = np.broadcast_to(np.array(light["intensity"], np.float64), 3)
            if not (np.isfinite(position).all() and np.isfinite(intensity).all() and (intensity >= 0).all()):
                raise ValueError
        except (LookupError, TypeError, ValueError):
            raise AssetError(
                f"{self.path.name}: 'light' of '{name}' should be {{position: [x, y, z], intensity: number or r, g, b}}"
            ) from None
        return position, intensity
