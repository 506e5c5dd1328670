"""
Where things are looked at from, and lit from: B cameras and B point lights as one struct of arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import ViewsSettings
from ..errors import UserError
from ..machine.upload import upload

#: What the configuration has where nothing is said.
_DEFAULTS = ViewsSettings()


@dataclass
class Views:
    """
    B pinhole cameras, each with one point light; a PyTree of Dr.Jit arrays plus the film size.

    Parameters
    ----------
    origin : mi.Point3f, width B
        Camera positions [scene units].
    right, up, forward : mi.Vector3f, width B
        Orthonormal camera axes; ``right = forward x up`` as seen on the image.
    tan_x : mi.Float, width B
        Tangent of half the horizontal field of view.
    light_position : mi.Point3f, width B
    light_intensity : mi.Color3f, width B
        Radiant intensity [W/sr]; radiance of a white diffuse surface at distance d is intensity·cos/(π d²).
    width, height : int
        Film size [pixels].
    frame : mi.Float, width B
        Time of the animation frame; 0 for what does not move.
    ambient : mi.Float, optional
        Light besides the point lights, the same in all views, flat: (r, g, b) of an ambient term, see
        :mod:`..latent.ambient`. Only the latent renderer looks at it, and only :meth:`under` sets it.
    subdivisions : mi.Float, width B, optional
        How finely a displaced model that is fitted for several tessellations is shown; without it as finely as it can.
    """

    origin: mi.Point3f
    right: mi.Vector3f
    up: mi.Vector3f
    forward: mi.Vector3f
    tan_x: mi.Float
    light_position: mi.Point3f
    light_intensity: mi.Color3f
    frame: mi.Float
    width: int
    height: int
    ambient: mi.Float | None = None
    subdivisions: mi.Float | None = None

    def __len__(self) -> int:
        return dr.width(self.tan_x)

    @property
    def fov(self) -> np.ndarray:
        """Horizontal field of view [degrees], shape (B,)."""
        return np.degrees(2 * np.arctan(self.tan_x.numpy()))

    def arrays(self) -> dict[str, np.ndarray]:
        """
        The same in NumPy: ``origin right up forward light_position light_intensity`` (B, 3), ``tan_x frame`` (B,), and
        ``subdivisions`` (B,) where there are any.
        """
        names = ("origin", "right", "up", "forward", "light_position", "light_intensity")
        out = {name: getattr(self, name).numpy().T for name in names}
        out |= {"tan_x": self.tan_x.numpy(), "frame": self.frame.numpy()}
        return out if self.subdivisions is None else out | {"subdivisions": self.subdivisions.numpy()}

    @staticmethod
    def from_arrays(arrays: dict[str, np.ndarray], width: int, height: int) -> Views:
        """
        Inverse of :meth:`arrays`.
        """
        vec = lambda name, kind: upload(kind, arrays[name])  # noqa: E731
        return Views(
            origin=vec("origin", mi.Point3f),
            right=vec("right", mi.Vector3f),
            up=vec("up", mi.Vector3f),
            forward=vec("forward", mi.Vector3f),
            tan_x=upload(mi.Float, arrays["tan_x"]),
            light_position=vec("light_position", mi.Point3f),
            light_intensity=vec("light_intensity", mi.Color3f),
            frame=upload(mi.Float, arrays["frame"]),
            width=width,
            height=height,
            subdivisions=upload(mi.Float, arrays["subdivisions"]) if "subdivisions" in arrays else None,
        )

    def take(self, index: np.ndarray) -> Views:
        """
        The views of these indices, shape (b,).
        """
        return Views.from_arrays({k: v[index] for k, v in self.arrays().items()}, self.width, self.height)

    def by_shape(self) -> list[tuple[np.ndarray, Views]]:
        """
        Indices, and the views themselves, of each frame of the animation and each tessellation in turn.
        """
        states = np.column_stack([x.numpy() for x in (self.frame, self.subdivisions) if x is not None])
        if len(self) == 0 or (states == states[0]).all():
            return [(np.arange(len(self)), self)]
        groups = [np.flatnonzero((states == state).all(1)) for state in np.unique(states, axis=0)]
        return [(group, self.take(group)) for group in groups]

    def under(self, ambient: mi.Float | None) -> Views:
        """
        The same views with an ambient light; differentiable in it.
        """
        return replace(self, ambient=ambient)

    def lit_by(self, factor: float) -> Views:
        """
        The same views with their lights this many times as bright.
        """
        arrays = self.arrays()
        arrays["light_intensity"] = arrays["light_intensity"] * np.float32(factor)
        return Views.from_arrays(arrays, self.width, self.height)

    def lit_from(self, position, target, irradiance: float) -> Views:
        """
        The same cameras under a light at one place, shape (3,), that sends ``irradiance`` to ``target``, shape (3,).
        """
        position, target = np.asarray(position, np.float64), np.asarray(target, np.float64)
        light = {
            "light_position": np.broadcast_to(position, (len(self), 3)),
            "light_intensity": np.full((len(self), 3), irradiance * np.sum((position - target) ** 2)),
        }
        return Views.from_arrays(self.arrays() | light, self.width, self.height)

    def lit_by_point(self, position, intensity) -> Views:
        """
        The same cameras under one light at a place, of a radiant intensity, each shape (3,).
        """
        n = len(self)
        light = {"light_position": np.tile(position, (n, 1)), "light_intensity": np.tile(intensity, (n, 1))}
        return Views.from_arrays(self.arrays() | light, self.width, self.height)

    def at(self, frame: float) -> Views:
        """
        The same views of another frame of the animation.
        """
        return Views.from_arrays(self.arrays() | {"frame": np.full(len(self), frame)}, self.width, self.height)

    def resized(self, width: int, height: int) -> Views:
        """
        The same cameras with another film size.
        """
        return Views.from_arrays(self.arrays(), width, height)

    @staticmethod
    def concatenate(parts: list[Views]) -> Views:
        """
        One after the other; all of one film size.
        """
        arrays = [p.arrays() for p in parts]
        joined = {k: np.concatenate([a[k] for a in arrays]) for k in arrays[0]}
        return Views.from_arrays(joined, parts[0].width, parts[0].height)


def look_at(
    origin,
    target,
    light,
    *,
    width,
    height,
    fov=_DEFAULTS.fov,
    irradiance=_DEFAULTS.light.irradiance,
    up=(0.0, 1.0, 0.0),
    frame=0.0,
) -> Views:
    """
    Views from camera, target and light positions.

    Parameters
    ----------
    origin, target, light : array_like, shape (B, 3) or (3,)
    fov : float
        Horizontal field of view [degrees].
    irradiance : float
        What the light sends onto a surface facing it at the target; π gives a white diffuse surface radiance 1.
    up : array_like, shape (B, 3) or (3,)
        Which way is up on the image; where it is parallel to the view direction another axis is taken.

    Raises
    ------
    UserError
        A camera stands at its target.
    """
    vectors = [np.atleast_2d(np.asarray(a, np.float64)) for a in (origin, target, light, up)]
    origin, target, light, up = np.broadcast_arrays(*vectors)
    forward = target - origin
    distance = np.linalg.norm(forward, axis=1, keepdims=True)
    if np.any(distance == 0):
        raise UserError("camera and target are the same point, so there is no direction to look in")
    forward = forward / distance
    right = np.cross(forward, up)
    length = np.linalg.norm(right, axis=1, keepdims=True)
    across = np.eye(3)[np.argmin(np.abs(forward), axis=1)]
    right = np.where(length > 1e-4, right, np.cross(forward, across))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    distance2 = np.sum((light - target) ** 2, axis=1, keepdims=True)
    n = len(origin)
    return Views.from_arrays(
        dict(
            origin=origin,
            right=right,
            up=np.cross(right, forward),
            forward=forward,
            tan_x=np.broadcast_to(np.tan(np.radians(np.asarray(fov)) / 2), n),
            light_position=light,
            light_intensity=np.broadcast_to(irradiance * distance2, (n, 3)),
            frame=np.broadcast_to(frame, n),
        ),
        width,
        height,
    )


def _unit(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _cosine_lobe(rng: np.random.Generator, axis: np.ndarray, exponent: float) -> np.ndarray:
    """
    Directions around each axis with density ~ cos^exponent; shape (B, 3).
    """
    n = len(axis)
    cos = rng.random(n) ** (1 / (exponent + 1))
    side = np.cross(axis, _unit(rng, n))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return axis * cos[:, None] + side * np.sqrt(np.maximum(1 - cos**2, 0))[:, None]


def goniometer(
    n: int,
    rng: np.random.Generator,
    *,
    width: int,
    height: int,
    center=(0.0, 0.0, 0.0),
    distance: float = _DEFAULTS.distance,
    jitter: float = _DEFAULTS.jitter,
    fov: float = _DEFAULTS.fov,
    light_exponent: float = _DEFAULTS.light.exponent,
    irradiance: float = _DEFAULTS.light.irradiance,
    light_position=None,
) -> Views:
    """
    Random views of the virtual photo-goniometer (Hasselgren et al. 2021, Sect. 3).

    Camera directions are uniform over the sphere, turned about the view axis at random, the target
    jittered; the light stands at the same distance in a cosine lobe around the camera.

    Parameters
    ----------
    n : int
        How many views B.
    rng : numpy.random.Generator
    distance : float
        From ``center`` to cameras and lights; 3.5 for a model in a box of side 2.
    jitter : float
        Half side of the box that the target is drawn from.
    light_exponent : float
        Of the cosine lobe; 0 is uniform over the hemisphere.
    light_position : array_like, shape (3,), optional
        Where the light of all views stands instead; its irradiance is that at ``center``.
    """
    if n < 1:
        raise UserError(f"a batch needs at least one view, got {n}")
    center = np.asarray(center, np.float64)
    direction = _unit(rng, n)
    target = center + rng.uniform(-jitter, jitter, (n, 3))
    light = center + distance * _cosine_lobe(rng, direction, light_exponent)
    views = look_at(
        center + distance * direction, target, light,
        width=width, height=height, fov=fov, irradiance=irradiance, up=_unit(rng, n),
    )  # fmt: skip
    return views if light_position is None else views.lit_from(light_position, center, irradiance)


def held_out_views(
    bounds: np.ndarray, n: int = 8, resolution: int = 256, seed: int = 0, *, irradiance: float = 2.0
) -> Views:
    """
    Views for judging that no fit draws: a turned Fibonacci sphere, every other light 30–75° off the camera.

    Parameters
    ----------
    bounds : ndarray, shape (2, 3)
        Box of what is looked at; cameras stand at 2.6 times its half diagonal, lights at 3 times.
    """
    rng = np.random.default_rng(seed)
    k = np.arange(n) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / n), np.pi * (1 + 5**0.5) * k + rng.uniform(0, 2 * np.pi)
    d = np.stack([np.cos(azimuth) * np.sin(polar), np.cos(polar) * 0.8, np.sin(azimuth) * np.sin(polar)], axis=1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    side = np.cross(d, _unit(rng, n))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    low, high = np.where(np.arange(n) % 2, 5, 30), np.where(np.arange(n) % 2, 30, 75)
    angle = np.radians(rng.uniform(low, high))[:, None]
    center, radius = bounds.mean(0), np.linalg.norm(bounds[1] - bounds[0]) / 2
    light = center + 3 * radius * (d * np.cos(angle) + side * np.sin(angle))
    return look_at(center + 2.6 * radius * d, center, light, width=resolution, height=resolution, irradiance=irradiance)
