"""
An implicit surface: a signed distance function with a material, checked and bounded before anyone traces it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from ...errors import AssetError
from ...machine.upload import upload
from ...machine.user_code import code_named

log = logging.getLogger("mi_simplify")

#: Steeper functions are no distances in any sense that could be traced in reasonable time.
STEEPEST = 8.0

_UNNAMED = "implicit surface"

#: Largest coordinate that is searched for a surface without bounds of its own.
_FARTHEST = 2.0**20


@dataclass
class Surfel:
    """
    The material at some points of an implicit surface, what ``Implicit.material`` returns: a linear colour and two
    ``mi.Float`` or numbers.
    """

    base_color: mi.Color3f
    roughness: Any = 0.5
    metallic: Any = 0.0


def grey(p) -> Surfel:
    """
    The material of what has none.
    """
    return Surfel(mi.Color3f(0.5) + dr.zeros(mi.Float, dr.width(p)))


@dataclass(frozen=True)
class Implicit:
    """
    A surface where a function is zero.

    Parameters
    ----------
    distance : callable
        ``distance(p: mi.Point3f) -> mi.Float``, negative inside, in Dr.Jit operations alone, see :mod:`.sdf`. It may
        overestimate distances by a factor of at most ``STEEPEST``: how much it does is measured, and steps are
        shortened by it.
    material : callable
        ``material(p: mi.Point3f) -> Surfel``.
    bounds : array_like, shape (2, 3), optional
        A box around the surface; by default it is searched for.
    ambient : (3,)
        Radiance that comes from everywhere: ``ambient · base_color`` is added to what lights do.
    name : str
    """

    distance: Callable[[mi.Point3f], mi.Float]
    material: Callable[[mi.Point3f], Surfel] = grey
    bounds: Any = None
    ambient: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = _UNNAMED

    def at(self, points: np.ndarray) -> np.ndarray:
        """
        Distances of points, shape (N, 3).

        Raises
        ------
        AssetError
            The function fails, or does not return one finite number a point.
        """
        p = upload(mi.Point3f, np.asarray(points, np.float32).reshape(-1, 3))
        d = self._checked(lambda: self.distance(p))
        out = d.numpy()
        if out.size == 1:
            out = np.repeat(out, len(points))
        if out.shape != (len(points),):
            raise AssetError(f"{self.name}: the distance function returned {out.size} numbers for {len(points)} points")
        if not np.isfinite(out).all():
            raise AssetError(f"{self.name}: the distance function returns NaN or infinity")
        return out

    def surfel(self, p: mi.Point3f) -> Surfel:
        """
        The material at some points, its numbers in their ranges; nothing is evaluated here.
        """
        found = self._checked(lambda: self.material(p), "material")
        if not isinstance(found, Surfel):
            raise AssetError(f"{self.name}: the material function returned {type(found).__name__}, expected a Surfel")
        unit = [dr.clip(mi.Float(x), 0, 1) for x in (found.roughness, found.metallic)]
        return Surfel(dr.clip(mi.Color3f(found.base_color), 0, 1), *unit)

    def _checked(self, call: Callable, what: str = "distance") -> Any:
        """What a user's function returns; whatever it raises is told in a line."""
        try:
            out = call()
        except AssetError:
            raise
        except Exception as error:
            text = str(error).strip().splitlines()
            raise AssetError(
                f"{self.name}: the {what} function failed: {type(error).__name__}: {text[0] if text else ''}"
            ) from error
        if what == "distance" and not isinstance(out, mi.Float):
            raise AssetError(
                f"{self.name}: the distance function returned {type(out).__name__}, expected mi.Float, one number a "
                "point; it gets an mi.Point3f and has to use Dr.Jit's functions (drjit.sqrt, drjit.maximum, ...)"
            )
        return out

    @cached_property
    def box(self) -> np.ndarray:
        """
        A box around the surface, shape (2, 3), a little larger than it.

        Raises
        ------
        AssetError
            There is no surface, or it does not end.
        """
        if self.bounds is not None:
            box = np.asarray(self.bounds, np.float64)
            if box.shape != (2, 3) or not (box[1] > box[0]).all():
                raise AssetError(f"{self.name}: bounds should be two corners, the lower and the upper one")
        else:
            radius = self._radius()
            box = np.array([[-radius] * 3, [radius] * 3])
        for _ in range(1 if self.bounds is not None else 3):
            box = self._shrunk(box)
        return box

    def _radius(self) -> float:
        """Half the side of a cube that holds everything, found from outside."""
        d = _directions(np.random.default_rng(0), 512)
        radius = 1.0
        while radius <= _FARTHEST:
            # A surface that ends is some way from a sphere of twice its size, and farther from one of four times.
            near, far = self.at(d * radius), self.at(2 * radius * d)
            if near.min() > 0.02 * radius and (far > 1.1 * near).all():
                return radius
            radius *= 2
        raise AssetError(
            f"{self.name}: the surface has no end, or the function is no distance: it does not grow far away; cut it "
            "with a box (sdf.intersect), or give its bounds"
        )

    def _shrunk(self, box: np.ndarray, n: int = 48) -> np.ndarray:
        """The box around the cells of a lattice that the surface may pass through."""
        axes = np.stack([np.linspace(a, b, n) for a, b in box.T])
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        distance = self.at(points)
        cell = (box[1] - box[0]) / (n - 1)
        inside = distance < 0
        if self.bounds is not None and not inside.any():
            raise AssetError(f"{self.name}: nowhere within its bounds is the function negative: nothing is inside")
        found = points[inside | (distance < np.linalg.norm(cell))]
        if not len(found):
            raise AssetError(f"{self.name}: nowhere is the function negative: nothing is inside the surface")
        return np.clip(np.stack([found.min(0) - cell, found.max(0) + cell]), box[0], box[1])

    @cached_property
    def excess(self) -> float:
        """
        By how much the function may overestimate distances to the surface from outside, at least 1.

        Raises
        ------
        AssetError
            It is no distance: it jumps, is flat where it should grow, or nothing is inside.
        """
        rng = np.random.default_rng(0)
        box = self.box
        size = float((box[1] - box[0]).max())
        points = rng.uniform(box[0], box[1], (_SAMPLES, 3))
        here = self.at(points)
        close = points[np.argsort(np.abs(here))[: _SAMPLES // 8]]
        close = close + 0.01 * size * rng.normal(size=close.shape)  # thin parts fall between the points
        points, here = np.concatenate([points, close]), np.concatenate([here, self.at(close)])
        inside = points[here < 0]
        if not len(inside):
            raise AssetError(f"{self.name}: nowhere is the function negative: nothing is inside the surface")
        near = np.abs(here) < 0.02 * size
        step = 1e-3 * size * _directions(rng, int(np.count_nonzero(near)))
        slope = np.abs(here[near] - self.at(points[near] + step)) / (1e-3 * size) if near.any() else np.zeros(1)
        if np.quantile(slope, 0.9) < 0.02:
            raise AssetError(
                f"{self.name}: the function does not grow away from the surface, as a distance does; is it a density "
                "or an inside test?"
            )
        outside = here > 0
        reach, _ = cKDTree(inside).query(points[outside])
        ratio = here[outside] / np.maximum(reach, 1e-3 * size)
        excess = float(max(np.quantile(ratio, 0.9995) if len(ratio) else 0, np.quantile(slope, 0.995)))
        if excess > STEEPEST:
            raise AssetError(
                f"{self.name}: the function is up to {excess:.3g} times the distance to the surface; divide it by "
                "that, or mend the jump in it"
            )
        if excess > 1.05:
            log.info("%s: overestimates distances by %.2f; steps are that much shorter", self.name, excess)
        return max(1.0, 1.02 * excess)

    def gradient(self, p: mi.Point3f) -> mi.Vector3f:
        """
        Gradient of the distance by automatic differentiation; by differences where that has none. Evaluated here.
        """
        p = mi.Point3f(dr.detach(p))
        dr.enable_grad(p)
        dr.backward(dr.sum(self.distance(p)))
        g, p = mi.Vector3f(dr.grad(p)), dr.detach(p)
        size = float((self.box[1] - self.box[0]).max())
        broken = ~dr.isfinite(dr.squared_norm(g))
        dr.eval(g, p, broken)
        lost = dr.compress(broken)  # such as the square root of zero inside a box
        if dr.width(lost):
            there, h = dr.gather(mi.Point3f, p, lost), 1e-3 * size
            ends = [[self.distance(there + mi.Vector3f(*(s * h * (i == k) for i in range(3)))) for s in (1, -1)]
                    for k in range(3)]  # fmt: skip
            dr.scatter(g, mi.Vector3f(*((a - b) * (0.5 / h) for a, b in ends)), lost)
            dr.eval(g)
        return g


#: Points at which a function is tried out.
_SAMPLES = 100_000


def _directions(rng: np.random.Generator, n: int) -> np.ndarray:
    """Unit vectors, shape (n, 3)."""
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def implicit_named(text: str, **settings: Any) -> Implicit:
    """
    The surface that ``module:name`` stands for: an :class:`Implicit`, or a distance function.

    Parameters
    ----------
    text : str
    settings
        Fields of :class:`Implicit` that replace its own; None leaves them. ``material`` may be a name, too.
    """
    found = code_named(text, "implicit surface")
    if not isinstance(found, Implicit):
        if not callable(found):
            raise AssetError(f"'{text}' is no function and no Implicit, but {type(found).__name__}")
        found = Implicit(found)
    if isinstance(settings.get("material"), str):
        settings["material"] = code_named(settings["material"], "material")
    given = {name: value for name, value in settings.items() if value is not None}
    if found.name == _UNNAMED:
        given["name"] = text.rpartition(":")[2]
    return replace(found, **given)
