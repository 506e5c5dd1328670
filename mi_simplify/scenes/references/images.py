"""
Captured images as a reference renderer: it can only be asked for the views that there are images of.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import UserError
from ...formats.captured.read import Captured
from ..views import Views


class ImageReference:
    """
    Captured images as a :class:`.reference.Reference`, seen from a frame, with views of its own to draw from.

    Images of any shape become square ones around the optical axis, which a view can have; what lies outside of the
    image is NaN there, which no loss counts.

    Parameters
    ----------
    captured : Captured
    scale : float
        Length of one unit of the images' world in the frame of the views.
    center : ndarray, shape (3,)
        Point of that world at the origin of the frame.
    fitted, held_out : sequence of int
        Images to draw from, and those to judge by.
    """

    def __init__(
        self, captured: Captured, scale: float, center: np.ndarray, fitted: Sequence[int], held_out: Sequence[int]
    ):
        self.captured = captured
        self._fitted, self._held_out = np.asarray(fitted), np.asarray(held_out)
        self._arrays = views_of(captured, scale, center)
        self._index = {key: k for k, key in enumerate(_keys(self._arrays))}
        self._square: dict[tuple[int, int], np.ndarray] = {}
        self._resolution = 0

    def draw(self, n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
        """
        ``n`` of the views to fit, all different as long as there are enough.
        """
        order = np.concatenate([rng.permutation(self._fitted) for _ in range(-(-n // len(self._fitted)))])
        return [self._views(order[:n], resolution)]

    def held_out(self, n: int, resolution: int) -> Views:
        """
        Up to ``n`` of the views that are never fitted, spread over all of them.
        """
        n = min(n, len(self._held_out))
        return self._views(self._held_out[np.arange(n) * len(self._held_out) // n], resolution)

    def _views(self, index: np.ndarray, resolution: int) -> Views:
        return Views.from_arrays({name: value[index] for name, value in self._arrays.items()}, resolution, resolution)

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`.reference.Reference`.

        Raises
        ------
        UserError
            There is no image of one of the views.
        """
        keys = _keys(views.arrays())
        if any(key not in self._index for key in keys) or views.width != views.height:
            raise UserError(f"{self.captured.source}: images show their own views only, and this is none of them")
        if views.width != self._resolution:  # a run goes from coarse to fine, and does not come back
            kept = {key: x for key, x in self._square.items() if key[1] == self._resolution}
            self._square, self._resolution = kept, views.width
        return np.stack([self._image(self._index[key], views.width) for key in keys]).astype(np.float32)

    def _image(self, k: int, resolution: int) -> np.ndarray:
        if (k, resolution) not in self._square:
            tan = self._arrays["tan_x"][k]
            image = squared(
                self.captured.images[k], self.captured.focal[k], self.captured.center[k], float(tan), resolution
            )
            self._square[k, resolution] = image.astype(np.float16)
        return self._square[k, resolution]


def _keys(arrays: dict[str, np.ndarray]) -> list[bytes]:
    """Something that tells views apart, to the bit."""
    rows = np.concatenate([arrays[name] for name in ("origin", "right", "forward")], axis=1)
    return [row.tobytes() for row in np.ascontiguousarray(rows, np.float32)]


def views_of(captured: Captured, scale: float, center: np.ndarray) -> dict[str, np.ndarray]:
    """
    The cameras in a frame, as ``Views.arrays`` has them, with a square film that holds the whole image; float32.
    """
    rotation, n = captured.to_world[:, :3, :3], len(captured)
    sizes = np.array([image.shape[1::-1] for image in captured.images], np.float64)
    reach = np.maximum(captured.center, sizes - captured.center) / captured.focal
    arrays = {
        "origin": (captured.to_world[:, :3, 3] - center) * scale,
        "right": rotation[:, :, 0],
        "up": rotation[:, :, 1],
        "forward": -rotation[:, :, 2],
        "tan_x": reach.max(1),
        "frame": np.zeros(n),
        "light_position": np.zeros((n, 3)),
        "light_intensity": np.zeros((n, 3)),
    }
    if captured.light_position is not None and captured.light_intensity is not None:
        arrays["light_position"] = (captured.light_position - center) * scale
        arrays["light_intensity"] = captured.light_intensity * scale**2
    return {name: np.ascontiguousarray(value, np.float32) for name, value in arrays.items()}


def squared(image: np.ndarray, focal: np.ndarray, center: np.ndarray, tan: float, resolution: int) -> np.ndarray:
    """
    An image on a square film around its optical axis, shape (resolution, resolution, C); NaN where it does not reach.

    Each new pixel is the mean of as many bilinear samples as old pixels fall into it; a film that has the pixels of the
    image keeps them.

    Parameters
    ----------
    image : ndarray, shape (H, W, C)
    focal, center : ndarray, shape (2,)
        [pixels]
    tan : float
        Tangent of half the field of view of the film.
    """
    height, width = image.shape[:2]
    n = max(1, int(np.ceil(2 * tan * focal.max() / resolution - 1e-3)))
    x = (2 * (np.arange(resolution * n) + 0.5) / (resolution * n) - 1) * tan
    column, row = center[0] + x * focal[0] - 0.5, center[1] + x * focal[1] - 0.5  # in units of pixel centres
    outside = [(c < -0.5 - 1e-3) | (c > size - 0.5 + 1e-3) for c, size in ((column, width), (row, height))]
    rows = _lerped(image.astype(np.float32), row, 0)
    rows[outside[1]] = np.nan
    rows = rows.reshape(resolution, n, width, -1).mean(1)
    columns = _lerped(rows, column, 1)
    columns[:, outside[0]] = np.nan
    return columns.reshape(resolution, resolution, n, -1).mean(2)


def _lerped(image: np.ndarray, at: np.ndarray, axis: int) -> np.ndarray:
    """Linear interpolation along an axis at fractional indices; the border repeats."""
    at = np.clip(at, 0, image.shape[axis] - 1)
    low = np.minimum(np.floor(at + 1e-4).astype(int), image.shape[axis] - 1)
    high = np.minimum(low + 1, image.shape[axis] - 1)
    weight = np.where(np.abs(at - low) < 1e-3, 0, at - low).astype(np.float32)
    weight = weight.reshape([-1 if k == axis else 1 for k in range(image.ndim)])
    return image.take(low, axis) * (1 - weight) + image.take(high, axis) * weight
