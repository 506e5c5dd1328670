"""
Rendered reference views held ready, renewed while the fit runs, so that no step waits for a path tracer.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from ..scenes.references.reference import Reference
from ..scenes.views import Views

log = logging.getLogger("mi_simplify")

_HALF_MAX = float(np.finfo(np.float16).max)


class ViewPool:
    """
    A ring of views with their reference images.

    Views of one *instant* share the frame of the animation, the tessellation and the film size, so that one surface and
    one kernel shows all of them; a batch is of one instant.

    Parameters
    ----------
    reference : Reference
    draw : callable
        ``draw(n, rng, resolution) -> list of Views``: ``n`` random views for images of this side, or of sides below it;
        each item is of one film size.
    capacity : int
        Views held at most.
    rng : numpy.random.Generator
        Of views and batches; its state is all that decides them.
    residual : Reference, optional
        Images to subtract: what the latent renderer does not compute (see ``residual.PathResidual``).
    fixed : bool
        Nothing is renewed, and all views are of one instant: every one is in one batch, always the same.
    """

    def __init__(
        self,
        reference: Reference,
        draw: Callable,
        capacity: int,
        rng: np.random.Generator,
        residual: Reference | None = None,
        fixed: bool = False,
    ):
        self.fixed, self._batches = fixed, dict[int, tuple[Views, mi.Vector4f]]()
        self.reference, self.draw, self.capacity, self.rng, self.residual = reference, draw, capacity, rng, residual
        self.n_rendered, self._warned = 0, False
        self._views: list[dict[str, np.ndarray]] = []
        self._images: list[np.ndarray] = []
        self.resolution = 0
        self._next = 0

    def __len__(self) -> int:
        return len(self._images)

    def grow(self, n: int, resolution: int) -> None:
        """
        Render ``n`` new views, in place of the oldest where the pool is full; empty it where the resolution changed.
        """
        if resolution != self.resolution:
            self.clear()
            self.resolution = resolution
        for views in self.draw(n, self.rng, resolution) if n else ():
            self._take_in(views)

    def _take_in(self, views: Views) -> None:
        n = len(views)
        seed = int(self.rng.integers(2**31))
        images = self.reference.render(views, seed)
        if self.residual is not None:
            images = np.concatenate([images, self.residual.render(views, seed)], axis=3)
        images = self._without_nan(images)
        # A point light in a mirror is brighter than half precision goes, and infinity would spread to everything.
        images = np.clip(images, -_HALF_MAX, _HALF_MAX).astype(np.float16)
        planes = np.moveaxis(images, 3, 1).reshape(n, images.shape[3], -1)
        size = {"width": np.full(n, views.width), "height": np.full(n, views.height)}
        arrays = views.arrays() | size
        for k in range(n):
            view, image = {key: value[k] for key, value in arrays.items()}, planes[k].copy()
            if len(self._images) < self.capacity:
                self._views.append(view)
                self._images.append(image)
            else:
                self._views[self._next], self._images[self._next] = view, image
            self._next = (self._next + 1) % self.capacity
        self.n_rendered += n

    def _without_nan(self, images: np.ndarray) -> np.ndarray:
        """Pixels that a path tracer could not compute become NaN as a whole, which no loss counts."""
        unknown = np.isnan(images).any(axis=3)
        if not unknown.any():
            return images
        if not self._warned:
            share = 100 * unknown.mean()
            log.warning("%.2g %% of the pixels of the reference are NaN and left out of the fit", share)
            self._warned = True
        images = np.where(unknown[..., None], 0, images)
        images[..., :4][unknown] = np.nan
        return images

    def state(self) -> dict:
        """
        What later batches depend on. The images are kept: a residual belongs to the model of its time, and a black box
        may not give the same image twice.
        """
        names = self._views[0] if self._views else ()
        views = {name: np.array([view[name] for view in self._views]) for name in names}
        return {
            "rng": self.rng.bit_generator.state, "resolution": self.resolution, "next": self._next,
            "n_rendered": self.n_rendered, "views": views, "channels": len(self._images[0]) if self._images else 0,
            "images": np.concatenate([np.zeros(0, np.float16), *map(np.ravel, self._images)]),
        }  # fmt: skip

    def restore(self, state: dict) -> None:
        """
        Inverse of :meth:`state`.
        """
        self.rng.bit_generator.state = state["rng"]
        self.resolution, self._next, self.n_rendered = (state[key] for key in ("resolution", "next", "n_rendered"))
        views = state.get("views", {})  # of a dict without entries nothing is left in a file
        n = len(next(iter(views.values()), ()))
        self._batches.clear()
        self._views = [{key: rows[k] for key, rows in views.items()} for k in range(n)]
        ends = np.cumsum([state["channels"] * int(v["width"] * v["height"]) for v in self._views], dtype=np.int64)
        images = np.split(state["images"], ends[:-1])[:n]
        self._images = [image.reshape(state["channels"], -1) for image in images]

    def clear(self) -> None:
        """
        Forget all views; the next :meth:`grow` begins anew.
        """
        self._views, self._images, self._next, self.resolution = [], [], 0, 0
        self._batches.clear()

    def fixed_batch(self, n: int) -> tuple[int, Views, mi.Vector4f]:
        """
        One of the batches of a fixed pool, at random: its number, views and images, the same objects every time.
        """
        n_batches = -(-len(self) // n)
        number = int(self.rng.integers(n_batches))
        if number not in self._batches:
            pick = np.arange(len(self)) * n_batches // len(self) == number
            index = np.flatnonzero(pick)
            arrays = {key: np.stack([self._views[i][key] for i in index]) for key in self._views[0]}
            views = Views.from_arrays(arrays, int(arrays["width"][0]), int(arrays["height"][0]))
            planes = np.stack([self._images[i][:4] for i in index], axis=1).reshape(4, -1)
            self._batches[number] = views, mi.Vector4f(upload(dr.float16_array_t(mi.Vector4f), planes.T))
        return number, *self._batches[number]

    def batch(self, n: int) -> tuple[Views, mi.Vector4f, mi.Vector4f]:
        """
        Different views of one instant (some twice if the pool holds fewer), their images and residuals, width
        ``n·H·W``: ``n`` of them, or, where they are smaller than the pool's resolution, as many as have no more pixels.
        Instants come up as often as there are pixels of them.
        """
        instants = [(v["width"], v["height"], v["frame"], v.get("subdivisions")) for v in self._views]
        pixels = np.cumsum([width * height for width, height, *_ in instants])
        instant = instants[np.searchsorted(pixels, self.rng.integers(pixels[-1]), side="right")]
        same = [k for k, other in enumerate(instants) if other == instant]
        n = max(n, int(n * self.resolution**2 / (instant[0] * instant[1])))
        pick = self.rng.choice(same, size=n, replace=len(same) < n)
        arrays = {key: np.stack([self._views[i][key] for i in pick]) for key in self._views[0]}
        views = Views.from_arrays(arrays, int(instant[0]), int(instant[1]))
        planes = np.stack([self._images[i] for i in pick], axis=1)  # (4 or 8, n, H·W)
        planes = planes.reshape(len(planes), -1)
        half = dr.float16_array_t(mi.Vector4f)  # kernels that read it convert
        residual = mi.Vector4f(0) if self.residual is None else mi.Vector4f(upload(half, planes[4:].T))
        return views, mi.Vector4f(upload(half, planes[:4].T)), residual
